"""Commands by hand: wished headings, kept headings, and robots that do not follow."""

import math

import pytest

from renet.deploy.steering import FORWARD_ONLY, HeadingSteering, TwistSteering
from renet.deploy.teleop.base import Velocity
from renet.interface import CONTROL_DT

AHEAD = Velocity(0.6)


def angle(steering: HeadingSteering, turn_rate: float, heading: float) -> float:
    """Angle that a policy is told after one step, rad."""
    _, sine, cosine = steering.command(Velocity(0.6, 0.0, turn_rate), heading)
    return math.atan2(sine, cosine)


@pytest.fixture
def heading() -> HeadingSteering:
    steering = HeadingSteering()
    steering.start(0.0)
    return steering


@pytest.fixture
def twist() -> TwistSteering:
    steering = TwistSteering()
    steering.start(0.0)
    return steering


def test_a_robot_that_cannot_follow_is_led_by_a_quarter_turn_at_most(heading):
    for _ in range(300):
        lead = angle(heading, 1.0, 0.0)
    assert lead == pytest.approx(math.pi / 2)
    assert angle(heading, 0.0, math.pi / 3) == pytest.approx(math.pi / 6), "the way round stays"


def test_headings_are_counted_around_the_circle(heading):
    heading.start(math.radians(178.0))
    assert angle(heading, 0.0, math.radians(-178.0)) == pytest.approx(math.radians(-4.0))
    assert angle(heading, 1.0, math.radians(178.0)) == pytest.approx(CONTROL_DT)


def test_a_policy_that_walks_ahead_alone_is_never_told_to_walk_back(heading):
    assert heading.command(Velocity(-0.5), 0.0)[0] == 0.0
    assert heading.refused == FORWARD_ONLY
    assert heading.command(Velocity(0.6, 0.1), 0.0)[0] == 0.6
    assert heading.refused == FORWARD_ONLY
    assert heading.followed == Velocity(0.6)
    heading.command(AHEAD, 0.0)
    assert heading.refused == ""
    heading.command(Velocity(-0.3, 0.1, 0.5), 0.0)
    assert heading.followed == Velocity(turn_rate=0.5)


def test_a_speed_that_the_pilot_slowed_is_the_one_followed(heading, twist):
    heading.command(Velocity(0.6, 0.0, 0.5), 0.0)
    heading.slow((0.3, 0.1, 0.995))
    assert heading.followed == Velocity(0.3, 0.0, 0.5)
    twist.command(Velocity(-0.6, 0.2, 0.5), 0.0)
    twist.slow((-0.3, 0.1, 0.5))
    assert twist.followed == Velocity(-0.3, 0.1, 0.5)


def test_a_policy_that_is_told_a_velocity_follows_all_of_it(twist):
    twist.command(Velocity(-0.3, 0.1, 0.5), 0.0)
    assert twist.followed == Velocity(-0.3, 0.1, 0.5)


@pytest.mark.parametrize("velocity", [(0.6, 0.0), (-0.5, 0.0), (0.0, 0.4)])
def test_the_heading_at_which_a_turn_ended_is_kept(twist, velocity):
    assert twist.command(Velocity(*velocity, 0.7), 1.0) == (*velocity, 0.7)
    assert twist.command(Velocity(*velocity), 1.2) == (*velocity, pytest.approx(-1.5 * 0.2))
    assert twist.command(Velocity(*velocity), 0.99) == (*velocity, pytest.approx(1.5 * 0.01))
    assert twist.command(Velocity(*velocity), 1.0 + math.tau)[2] == pytest.approx(0.0)


def test_a_walk_begins_along_the_robots_heading(twist):
    twist.start(2.0)
    assert twist.command(AHEAD, 2.1)[2] == pytest.approx(-0.15)


def test_a_kept_heading_asks_for_no_faster_turn_than_training(twist):
    assert twist.command(AHEAD, -1.5)[2] == 1.0
    assert twist.command(AHEAD, 1.5)[2] == -1.0
    twist.command(AHEAD, 2.5)
    assert twist.command(AHEAD, 2.5 - math.pi / 2)[2] == pytest.approx(0.0), "it lags no farther"


def test_a_robot_that_stands_is_not_turned_back(twist):
    """Nor one that turned, or was turned, while it stood, once it walks on."""
    assert twist.command(Velocity(), 0.3) == (0.0, 0.0, 0.0)
    assert twist.command(Velocity(turn_rate=0.5), 0.4) == (0.0, 0.0, 0.5)
    assert twist.command(Velocity(), 0.8) == (0.0, 0.0, 0.0)
    assert twist.command(AHEAD, 0.8)[2] == 0.0


def test_a_drifting_robot_returns_to_its_heading(twist):
    """One that turns by itself at 0.05 rad/s settles where the feedback makes up for it."""
    here = 0.0
    for _ in range(2000):
        here += CONTROL_DT * (twist.command(AHEAD, here)[2] + 0.05)
    assert here == pytest.approx(0.05 / 1.5, rel=1e-3)
