"""A sensor that says the same again and again, alone among others that live."""

from dataclasses import replace

import numpy as np
import pytest

from renet.deploy.watch.freezing import MAX_ALIKE, Freezing

from ..fakes import STANDING, live, time_of

MOVING = STANDING + 0.2 * np.sin(np.arange(20))[:, None]
"""Targets [20, 12] rad of joints that are to move."""


def watch(readings, powered=True, targets=None) -> str:
    """The last word of a watch over readings one after the other."""
    freezing, said = Freezing(), ""
    for step, reading in enumerate(readings):
        target = None if targets is None else targets[step]
        said = freezing.problem(replace(reading, time=time_of(step)), powered, target)
    return said


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("quaternion", "frozen: 6 readings of the attitude are the same"),
        ("angular_velocity", "frozen: 6 readings of the gyroscope are the same"),
        ("joint_position", "frozen: 6 readings of the joints' angles are the same"),
        ("joint_velocity", "frozen: 6 readings of the joints' speeds are the same"),
        ("joint_torque", "frozen: 6 readings of the joints' torques are the same"),
    ],
)
def test_each_vector_is_watched_for_itself_while_the_robot_has_power(name, reason):
    held = {name: getattr(live(joint_torque=np.arange(12.0)), name)}
    readings = [replace(live(joint_torque=np.full(12, 1.0 + n)), **held) for n in range(6)]
    assert watch(readings) == reason
    assert watch(readings[:MAX_ALIKE]) == ""
    assert watch(readings, powered=False) == "", "a robot that lies may read the same for long"


def test_a_robot_that_lies_and_says_the_same_altogether_is_frozen():
    assert watch([live()] * 6, powered=False) == "the readings are frozen: 6 are the same"


def test_a_robot_that_measures_no_torque_is_believed():
    assert watch([live() for _ in range(20)]) == ""


def test_readings_in_a_row_are_counted():
    stale = live()
    names = ("quaternion", "joint_position")
    same = {name: getattr(stale, name) for name in names}
    held = [replace(live(), **same) for _ in range(MAX_ALIKE)]
    assert watch([*held, live(), *held, live(), *held]) == ""


def frozen_joint(count: int) -> list:
    """Readings in which one joint's angle is always the same."""
    readings = []
    for target in MOVING[:count]:
        angles = target.copy()
        angles[7] = 1.2345
        readings.append(live(joint_position=angles))
        readings[-1].joint_position[7] = 1.2345
    return readings


def test_a_joint_that_stays_while_its_target_moves_is_named():
    readings = frozen_joint(6)
    told = "RR_thigh_joint is frozen or blocked: 6 readings are the same"
    assert watch(readings, targets=MOVING) == told
    assert watch(readings[:MAX_ALIKE], targets=MOVING) == ""


def test_a_joint_that_is_told_to_stay_may_say_the_same():
    """A real encoder counts steps: a leg that stands still stays at one of them."""
    still = np.repeat(STANDING[None], 20, axis=0)
    assert watch(frozen_joint(20), targets=still) == ""
    assert watch(frozen_joint(20)) == "", "nobody told it anything"
