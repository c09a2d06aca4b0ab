"""The end of seen ground by hand-computed walks, and what a pilot's robots do there."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import renet
from renet.bundle import Bundle
from renet.errors import RenetError
from renet.interface import CONTROL_DT, HEIGHT_MAP_X, HEIGHT_MAP_Y, STEPS_PER_TICK
from renet.pilot import Pilot
from renet.pilot.pilot import BEYOND
from renet.pilot.policy import BundlePolicy
from renet.pilot.reach import (
    HALF_WIDTH,
    STOPPING_MARGIN,
    Reach,
    can_stop,
    direction_of,
    slowed,
)

WALKS = np.load(Path(__file__).with_name("data") / "walks.npz")
"""Recorded walks, see test_pilot."""
AHEAD = np.array([[1.0, 0.0]])


def walk(reach: Reach, seconds: float, velocity=(0.0, 0.0), turn_rate=0.0) -> None:
    for _ in range(round(seconds / CONTROL_DT)):
        reach.move(np.array([velocity]), np.array([turn_rate]))


def test_what_lies_ahead_shrinks_by_the_way_walked():
    reach = Reach(1)
    assert reach.ahead(AHEAD) == pytest.approx(1.2)
    walk(reach, 1.0, (0.5, 0.0))
    assert reach.ahead(AHEAD) == pytest.approx(0.7)


def test_an_image_shows_new_ground():
    reach = Reach(2)
    for _ in range(50):
        reach.move(np.full((2, 2), (0.5, 0.0)), np.zeros(2))
    reach.reset(np.array([False, True]))
    np.testing.assert_allclose(reach.ahead(np.tile(AHEAD, (2, 1))), [0.7, 1.2])


def test_a_turn_by_a_right_angle_leads_to_the_side():
    reach = Reach(1)
    walk(reach, 1.0, (0.4, 0.0))
    walk(reach, 1.0, turn_rate=math.pi / 2)
    assert reach.ahead(AHEAD) == pytest.approx(HALF_WIDTH, abs=1e-6)
    walk(reach, 1.0, (0.25, 0.0))
    assert reach.ahead(AHEAD) == pytest.approx(HALF_WIDTH - 0.25, abs=1e-6)


def test_the_way_back_has_been_walked():
    reach = Reach(1)
    walk(reach, 2.0, (0.5, 0.0))
    assert reach.ahead(-AHEAD) == np.inf
    assert reach.ahead(np.zeros((1, 2))) == np.inf


def test_points_are_seen_up_to_the_end_of_the_image_and_on_the_way_behind():
    reach = Reach(1)
    points = np.array([(1.2, 0.0), (0.7, HALF_WIDTH), (0.75, 0.0), (-0.6, 0.9), (0.0, 0.9)])
    np.testing.assert_array_equal(reach.covers(points), [[True, True, True, True, False]])
    walk(reach, 1.0, (0.5, 0.0))
    np.testing.assert_array_equal(reach.covers(points), [[False, True, False, True, False]])
    # Half a metre on, and then to the left: what was ahead lies on the right.
    walk(reach, 1.0, turn_rate=math.pi / 2)
    points = np.array([(0.0, -0.65), (0.0, -0.75)])
    np.testing.assert_array_equal(reach.covers(points), [[True, False]])
    points = np.array([(HALF_WIDTH - 0.01, 0.0), (HALF_WIDTH + 0.01, 0.0)])
    np.testing.assert_array_equal(reach.covers(points), [[True, False]])


def test_a_robot_that_has_seen_nothing_knows_no_ground_until_it_has_an_image():
    reach = Reach(2)
    ways = np.array([(1.0, 0.0), (0.0, 0.0)])
    points = np.array([(0.0, 0.0), (-1.0, 0.0)])
    reach.forget(np.array([True, True]))
    np.testing.assert_array_equal(reach.ahead(ways), [-np.inf, np.inf])
    np.testing.assert_array_equal(reach.ahead(-ways), [-np.inf, np.inf])
    assert not reach.covers(points).any()
    assert can_stop(reach.ahead(ways), np.repeat(gap_between(-0.4, 0.4), 2, axis=0))[0]
    reach.reset(np.array([True, False]))
    np.testing.assert_array_equal(reach.ahead(ways), [1.2, np.inf])
    np.testing.assert_array_equal(reach.covers(points).all(axis=1), [True, False])


@pytest.mark.parametrize(
    ("told", "command", "expected"),
    [
        ("heading", (0.6, 0.5, 0.8), (1.0, 0.0)),
        ("heading", (0.0, 0.5, 0.8), (0.0, 0.0)),
        ("twist", (0.3, -0.4, 1.0), (0.6, -0.8)),
        ("twist", (0.0, 0.0, 1.0), (0.0, 0.0)),
    ],
)
def test_the_way_that_a_command_asks_for(told, command, expected):
    np.testing.assert_allclose(direction_of(np.array([command]), told), [expected])


def test_a_slowed_twist_keeps_its_direction_and_turn():
    fast = np.array([[0.6, -0.8, 0.7], [0.1, 0.0, 0.7]])
    np.testing.assert_allclose(
        slowed(fast, "twist", np.array([0.5, 0.5])), [[0.3, -0.4, 0.7], [0.1, 0.0, 0.7]]
    )
    np.testing.assert_allclose(
        slowed(fast, "heading", np.array([0.0, np.inf])), [[0.0, -0.8, 0.7], [0.1, 0.0, 0.7]]
    )


def gap_between(start: float, end: float) -> np.ndarray:
    """A map of level ground with a gap of 0.5 m in depth, between two places ahead, [1, 132] m."""
    depth = [0.5 if start < x < end else 0.0 for x in HEIGHT_MAP_X]
    return np.repeat(depth, len(HEIGHT_MAP_Y))[None]


@pytest.mark.parametrize(
    ("ahead", "gap", "stops"),
    [
        (0.6, (2.0, 2.0), False),
        (0.4, (2.0, 2.0), True),
        # A gap that is too near to stop before, and one that is not.
        (0.4, (0.4, 0.8), False),
        (0.4, (0.55, 0.9), True),
        # Under the hind feet.
        (0.4, (-0.4, -0.2), False),
        (-0.2, (-0.4, -0.2), False),
        # Beyond the end of the ground seen, a gap ahead is imagined, one below is not.
        (-0.2, (0.2, 0.8), True),
        (-0.2, (0.1, 0.8), False),
        # Not for ever.
        (-3.1, (-0.4, -0.2), True),
    ],
)
def test_where_a_robot_can_stop(ahead, gap, stops):
    assert can_stop(np.array([ahead]), gap_between(*gap))[0] == stops


class Told:
    """Keeps the commands that a policy is told; knows how fast it walks."""

    def __init__(self, pilot, velocity: float) -> None:
        self.commands = []
        self._policy = pilot.policy
        self._step = self._policy.step
        self._velocity = velocity
        self._policy.step = self.step

    def step(self, observation, *args):
        action = self._step(observation, *args)
        self.commands.append(observation[:, 6:9].copy())
        self._policy.velocity_vp = np.full_like(self._policy.velocity_vp, (self._velocity, 0, 0))
        return action


def commanded(conduct: Any, mode: str = "memory") -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Walk with a camera that dies after 1 s.

    Returns the speeds told, whether the ground ahead was unseen, and how far ahead the middle of
    the map showed ground that was seen, [T] each.
    """
    pilot = renet.load("go1-parkour", mode=mode, unseen=conduct)
    told = Told(pilot, velocity=0.5)
    unseen = []
    seen_to = []
    for step in range(200):
        # The recorded camera is healthy for two seconds.
        observation = WALKS["memory_observation"][min(step, 99)][None].copy()
        observation[:, 2] = 0.0
        observation[:, 6:9] = (0.5, 0.0, 1.0)
        image = None
        if step < 50 and step % STEPS_PER_TICK == 0:
            image = WALKS["memory_images"][step // STEPS_PER_TICK][None].astype(np.float32) / 255
        pilot.step(observation, image, step * CONTROL_DT)
        unseen.append(bool(pilot.unseen[0]))
        middle = pilot.map_seen[0].reshape(len(HEIGHT_MAP_X), -1)[:, len(HEIGHT_MAP_Y) // 2]
        seen_to.append(max((x for x, seen in zip(HEIGHT_MAP_X, middle, strict=True) if seen)))
    return np.concatenate(told.commands)[:, 0], np.array(unseen), np.array(seen_to)


@pytest.mark.parametrize(("conduct", "speed"), [("walk", 0.5), ("slow", 0.3), ("stop", 0.0)])
def test_conduct_at_the_end_of_seen_ground(conduct, speed):
    speeds, unseen, _ = commanded(conduct)
    first = int(np.argmax(unseen))
    walked = 0.5 * (first - 50) * CONTROL_DT
    assert unseen.any()
    # Memory reaches 1.2 m.
    assert 1.2 - STOPPING_MARGIN - 0.1 <= walked <= 1.2 - STOPPING_MARGIN + 0.15
    assert (speeds[:first] == 0.5).all()
    assert speeds[first:] == pytest.approx(speed)


def test_op_drives_a_robot_that_stands_beyond_the_ground_seen():
    pilot = renet.load("go1-parkour", unseen="stop")
    policy: Any = pilot.policy
    told = Told(pilot, velocity=0.5)
    steps = []
    for step in range(400):
        observation = WALKS["memory_observation"][step % 100][None].copy()
        observation[:, 2] = 0.0
        observation[:, 6:9] = (0.5, 0.0, 0.0)
        image = None
        # The camera is dead from 1 to 6 s.
        if not 50 <= step < 300 and step % STEPS_PER_TICK == 0:
            recorded = WALKS["memory_images"][step // STEPS_PER_TICK % 20][None]
            image = recorded.astype(np.float32) / 255
        # On a gap until 3.6 s, then behind it; VP imagines to be on one again later.
        on_gap = 100 <= step < 180 or step >= 240
        policy.height_map = gap_between(-0.4, -0.2) if on_gap else gap_between(0.3, 0.9)
        steps.append(pilot.step(observation, image, step * CONTROL_DT))
    speeds = np.concatenate(told.commands)[:, 0]
    vision = np.array([one.vision[0] for one in steps])
    # It has seen 1.2 m and walked 1.3 m when the gap is behind it.
    assert (speeds[100:180] == 0.5).all()
    assert vision[:180].all()
    assert (speeds[180:300] == 0.0).all()
    assert not vision[180:300].any()
    assert steps[200].state[0] == "blind"
    assert steps[200].reason[0] == BEYOND
    # It walks on with vision once it sees again.
    assert speeds[-1] == 0.5
    assert vision[-1]
    assert steps[-1].state[0] == "sees"


@pytest.mark.parametrize("black", [True, False], ids=["black", "no camera"])
@pytest.mark.parametrize("forward", [0.5, -0.5])
def test_a_robot_that_has_never_seen_stands_until_it_sees(black, forward):
    pilot = renet.load("go1-driven", unseen="stop")
    told = Told(pilot, velocity=0.0)
    steps = []
    for step in range(350):
        observation = WALKS["memory_observation"][step % 100][None].copy()
        observation[:, 2] = 0.0
        observation[:, 6:9] = (forward, 0.0, 0.0)
        image = np.zeros((1, 48, 64)) if black else None
        if step >= 50:
            image = WALKS["memory_images"][step // STEPS_PER_TICK % 20][None].astype(np.float32)
            image /= 255
        taken = image if step % STEPS_PER_TICK == 0 else None
        steps.append(pilot.step(observation, taken, step * CONTROL_DT))
    speeds = np.concatenate(told.commands)[:, 0]
    # The first tick finds out that there is no image.
    assert (speeds[1:50] == 0.0).all()
    assert steps[49].unseen[0]
    assert steps[49].reason[0] != BEYOND
    assert steps[-1].state[0] == "sees"
    assert speeds[-1] == forward


def test_robots_without_memory_go_on():
    speeds, unseen, seen_to = commanded("stop", mode="camera")
    assert (speeds == 0.5).all()
    assert not unseen.any()
    assert (seen_to == max(HEIGHT_MAP_X)).all()


def test_the_map_of_a_robot_without_images_shows_less_and_less_seen_ground():
    _, unseen, seen_to = commanded("walk")
    last = np.flatnonzero(seen_to == max(HEIGHT_MAP_X))[-1]
    walked = 0.5 * CONTROL_DT * (np.arange(len(seen_to)) - last)
    spacing = HEIGHT_MAP_X[1] - HEIGHT_MAP_X[0]
    left = max(HEIGHT_MAP_X) - walked[last:]
    assert (seen_to[last:] <= left + 0.02).all()
    assert (seen_to[last:] > left - spacing - 0.02).all()
    assert seen_to[np.argmax(unseen)] == pytest.approx(STOPPING_MARGIN, abs=spacing)


def test_an_unknown_conduct_is_refused():
    with pytest.raises(RenetError, match="unseen"):
        renet.load("go1-parkour", unseen="fly")  # type: ignore[arg-type]


def test_as_many_conducts_as_robots():
    bundle = Bundle.load()
    with pytest.raises(RenetError, match="2 conducts for 1 robots"):
        Pilot(BundlePolicy(bundle), {}, ["memory"], ["walk", "stop"])
