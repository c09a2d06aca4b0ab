"""Joints that follow their targets, lag behind them, tremble, or stay where they are."""

import numpy as np
import pytest

from renet.deploy.watch.blocking import WINDOW, Blocking

from ..fakes import STANDING, state, time_of


def watch(joint: int, share: float, swing: float = 0.5, steps: int = 3 * WINDOW) -> tuple[str, int]:
    """What is said of a robot one joint of which travels a share of its target's way, and when."""
    blocking = Blocking()
    shares = np.ones(12)
    shares[joint] = share
    for step in range(steps):
        way = swing * np.sin(0.3 * step + np.arange(12))
        told = blocking.warning(state(time_of(step), joint_position=STANDING + shares * way), way)
        if told:
            return told, step
    return "", steps


@pytest.mark.parametrize(
    ("joint", "name"), [(0, "FR_hip_joint"), (4, "FL_thigh_joint"), (11, "RL_calf_joint")]
)
@pytest.mark.parametrize("share", [0.0, 0.05])
def test_a_joint_that_stays_where_it_is_is_named_after_a_second(joint, name, share):
    said, step = watch(joint, share)
    assert said.startswith(f"{name} is blocked: it moved by ")
    assert step == WINDOW


@pytest.mark.parametrize("joint", range(12))
def test_a_joint_that_follows_a_fifth_of_the_way_is_believed(joint):
    assert watch(joint, 0.2)[0] == ""


def test_a_robot_that_stands_need_not_move():
    """Targets that tremble by little are borne by stiff legs."""
    assert watch(4, 0.0, swing=0.05)[0] == ""


def test_what_was_before_is_forgotten():
    blocking = Blocking()
    for step in range(3 * WINDOW):
        if step % (WINDOW - 1) == 0:
            blocking.start_over()
        assert blocking.warning(state(time_of(step)), STANDING + 0.5 * np.sin(0.3 * step)) == ""
