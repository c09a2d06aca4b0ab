"""Settings as functions of environment steps."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from renet.errors import RenetError
from renet.tasks.schedule import lowest, value_at


@pytest.mark.parametrize(
    ("steps", "value"),
    [(0, 3.0), (500, 3.0), (750, 2.5), (1_000, 2.0), (1_000_000, 1.0), (9e9, 1.0)],
)
def test_linear_between_points_and_constant_outside(steps, value):
    assert value_at("3@500,2@1k,1@1M", steps) == pytest.approx(value)
    assert [value_at("1@5M,0.5@5M", at) for at in (4e6, 6e6)] == [1.0, 0.5], "a step down"


@given(value=st.floats(-1e6, 1e6), steps=st.floats(0, 1e12))
def test_number_is_constant(value, steps):
    assert value_at(value, steps) == value_at(str(value), steps) == pytest.approx(value)


def test_lowest_is_of_all_times():
    assert lowest("3@500,-2@1k,1@1M") == -2.0
    assert lowest(0.5) == 0.5


def test_what_is_no_schedule_is_refused():
    for text in ("", "fast", "1@", "@3M", "1@3G", "1@-3M", "1@1M;2@2M", "inf", "nan"):
        with pytest.raises(RenetError, match="VALUE@STEPS"):
            value_at(text, 0)
    with pytest.raises(RenetError, match="must not fall"):
        value_at("1@3M,2@1M", 0)
