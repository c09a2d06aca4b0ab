"""Settings as functions of environment steps."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from renet.errors import RenetError
from renet.training.config import value_at


@pytest.mark.parametrize(
    ("steps", "value"),
    [(0, 3.0), (1_000_000, 3.0), (2_000_000, 2.0), (3_000_000, 1.0), (9e9, 1.0)],
)
def test_linear_between_points_and_constant_outside(steps, value):
    assert value_at("3@1M,1@3M", steps) == pytest.approx(value)


def test_units_of_steps():
    assert value_at("1@500,2@1k,3@1M", 500) == 1
    assert value_at("1@500,2@1k,3@1M", 1_000) == 2
    assert value_at("1@500,2@1k,3@1M", 1_000_000) == 3


@given(value=st.floats(-1e6, 1e6), steps=st.floats(0, 1e12))
def test_a_number_is_the_same_at_all_times(value, steps):
    assert value_at(value, steps) == value_at(str(value), steps) == pytest.approx(value)


@pytest.mark.parametrize("text", ["", "fast", "1@", "@3M", "1@3G", "1@-3M", "1@1M;2@2M"])
def test_what_is_no_schedule_is_refused(text):
    with pytest.raises(RenetError, match=r"write a number, or VALUE@STEPS points"):
        value_at(text, 0)


def test_steps_that_fall_are_refused():
    with pytest.raises(RenetError, match="must not fall"):
        value_at("1@3M,2@1M", 0)
