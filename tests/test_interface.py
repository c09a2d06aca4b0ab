"""Times and control steps."""

import pytest

from renet.interface import control_steps


@pytest.mark.parametrize(
    ("seconds", "steps"), [(0.0, 0), (0.02, 1), (0.29, 14), (0.57, 28), (1.0, 50), (60.0, 3000)]
)
def test_there_are_fifty_control_steps_in_a_second(seconds, steps):
    assert control_steps(seconds) == steps
