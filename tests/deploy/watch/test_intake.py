"""Single odd readings are left out; what goes on to be odd is told."""

from dataclasses import replace

import numpy as np
import pytest

from renet.deploy.robots.base import RobotState
from renet.deploy.safety.limits import SafetyCfg
from renet.deploy.watch.intake import ACCEPTANCE, RECOVERY, Intake
from renet.training.export import robot_spec

from ..fakes import STANDING, state, time_of, turned

SWAY = np.tile([0.0, 1.0, 0.0], 4)
ODD = [
    ({"joint_velocity": np.full(12, np.nan)}, "joint_velocity is not finite"),
    ({"joint_position": np.zeros(3)}, "joint_position has shape (3,)"),
    ({"quaternion": turned("x", 180)}, "tilted"),
    ({"joint_velocity": np.full(12, 99.0)}, "FR_hip_joint is too fast"),
    ({"joint_velocity": np.full(12, 55.0)}, "angle and speed of FR_hip_joint disagree by 0.55"),
    ({"quaternion": turned("z", 90)}, "gyroscope and attitude disagree by 1.57 rad"),
    ({"joint_position": STANDING + 0.5 * SWAY}, "FR_thigh_joint jumped by 0.50 rad"),
]


class Taken:
    """An intake, and what it says of one reading after the other."""

    def __init__(self, **limits: float) -> None:
        self.intake, self.step = Intake(robot_spec(), SafetyCfg(**limits)), 0

    def take(self, count: int = 1, **changes) -> str:
        for _ in range(count):
            now = time_of(self.step)
            self.intake.offer(state(now, **changes), now)
            self.step += 1
            self.said = self.intake.problem(now)
        return self.said

    @property
    def newest(self) -> RobotState:
        assert self.intake.newest is not None
        return self.intake.newest


@pytest.mark.parametrize(("changes", "reason"), ODD)
def test_one_or_two_odd_readings_are_left_out_and_three_are_told(changes, reason):
    for count in (1, 2):
        taken = Taken()
        taken.take(20)
        assert taken.take(count, **changes) == ""
        assert taken.newest.time == time_of(19), "the last good one stands"
        assert taken.take(1) == ""
        assert taken.newest.time == time_of(20 + count), "and the next good one is believed"
    taken = Taken()
    taken.take(20)
    assert reason in taken.take(3, **changes)


@pytest.mark.parametrize(("changes", "reason"), ODD)
def test_odd_ones_between_good_ones_are_told_too(changes, reason):
    taken = Taken()
    taken.take(20)
    said = [(taken.take(1, **changes), taken.take(1)) for _ in range(3)]
    assert [bool(why) for why, _ in said] == [False, False, True]
    assert reason in taken.said
    taken.take(RECOVERY)
    assert taken.said == "", "they are forgotten after a while"


def test_a_joint_that_slipped_for_good_is_told_and_later_believed():
    taken, slipped = Taken(), STANDING + 0.5 * SWAY
    taken.take(20)
    assert "jumped" in taken.take(4, joint_position=slipped)
    assert "jumped" in taken.take(ACCEPTANCE - 10, joint_position=slipped)
    assert taken.take(10 + RECOVERY, joint_position=slipped) == ""
    np.testing.assert_array_equal(taken.newest.joint_position, slipped)


def test_a_jump_is_not_taken_back_by_another_one():
    """Readings that jump about never come back to where they were."""
    taken = Taken()
    taken.take(20)
    for degrees in (90, 180, 270):
        said = taken.take(1, quaternion=turned("z", degrees))
        assert taken.newest.time == time_of(19)
    assert "gyroscope and attitude disagree" in said


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("angular_velocity", [0.0, 0.4, 0.0], "gyroscope and attitude disagree by 0.2"),
        ("joint_velocity", 3.0 * SWAY, "angle and speed of FR_thigh_joint disagree by"),
    ],
)
def test_what_parts_slowly_is_told_within_half_a_second_and_a_little(name, value, reason):
    taken = Taken()
    taken.take(20)
    said = [taken.take(1, **{name: np.array(value)}) for _ in range(35)]
    assert reason in said[-1]
    assert said[10] == ""


def test_times_that_say_little_add_up_to_nothing():
    """A simulated robot on a busy computer lives more slowly than the clock says."""
    taken = Taken(max_state_age=9.0)
    taken.take(20)
    assert taken.take(60, joint_velocity=3.0 * SWAY, angular_velocity=np.array([0, 0.4, 0])) == ""
    assert "jumped" in taken.take(3, joint_position=STANDING + 0.5 * SWAY)


def test_the_age_of_the_last_good_one_is_told():
    taken = Taken()
    assert taken.intake.problem(0.0) == "no state from the robot"
    taken.take(5)
    assert taken.intake.problem(time_of(4) + 0.06) == "the state is 60 ms old"


def test_the_first_reading_may_be_odd_and_is_named():
    taken = Taken()
    assert "tilted" in taken.take(1, quaternion=turned("x", 180))
    assert taken.take(1) == ""


def test_an_older_reading_is_no_news_and_the_same_one_counts_once():
    taken = Taken()
    taken.take(5)
    odd = replace(state(time_of(5)), quaternion=turned("x", 180))
    for _ in range(5):
        assert taken.intake.offer(state(time_of(2)), time_of(5)) is None
        taken.intake.offer(odd, time_of(5))
    assert taken.intake.problem(time_of(5)) == ""
    assert taken.newest.time == time_of(4)
