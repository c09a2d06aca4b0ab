"""Walls and ledges: how far they are, when a robot is right to stop, and levels nobody passes."""

import math

import pytest
import torch

from renet.tasks.mdp import before_barrier, free_distance, goal, velocity_tracking
from renet.tasks.parkour_env_cfg import tile_env_cfg
from renet.tasks.terrains import parkour_terrain
from renet.terrain.tiles import barriers

ROBOTS = 8


@pytest.fixture(scope="module")
def shared():
    from renet.tasks import make_env

    env = make_env(tile_env_cfg(parkour_terrain(kinds=barriers())), ROBOTS)
    yield env
    env.close()


@pytest.fixture
def env(shared):
    shared.reset()
    return shared


def put(env, x: float, y: float, yaw: float, speed: float = 0.5) -> None:
    """Put all robots at rest, m from the middle of their tiles, and tell them where to go."""
    env.sim.data.qpos[:, :2] = env.scene.env_origins[:, :2] + torch.tensor((x, y))
    env.sim.data.qvel[:] = 0.0
    env.sim.forward()
    command = goal(env)
    command.speed[:] = speed
    command.yaw[:] = yaw


@pytest.mark.parametrize(
    ("place", "yaw", "metres"),
    [
        ((0.0, 0.0), 0.0, 1.6),
        ((1.0, 0.0), 0.0, 0.6),
        ((1.0, 0.0), math.pi, 2.6),
        ((0.0, -1.1), -math.pi / 2, 0.5),
        ((0.0, 0.0), math.pi / 4, 1.6 * math.sqrt(2)),
        ((0.6, 0.2), math.radians(30), 1.0 / math.cos(math.radians(30))),
    ],
)
def test_the_way_that_is_left(env, place, yaw, metres):
    put(env, *place, yaw)
    torch.testing.assert_close(
        free_distance(env, goal(env).direction), torch.full((ROBOTS,), metres), atol=1e-3, rtol=0.0
    )


@pytest.mark.parametrize(
    ("place", "yaw", "speed", "stops"),
    [
        ((1.0, 0.0), 0.0, 0.5, True),
        ((1.0, 0.0), math.pi, 0.5, False),
        ((1.0, 0.0), 0.0, 0.0, False),
        ((0.0, 0.0), 0.0, 0.5, False),
    ],
)
def test_stops_only_before_barriers(env, place, yaw, speed, stops):
    put(env, *place, yaw, speed)
    assert (before_barrier(env) == stops).all()


def test_standing_before_barrier_is_rewarded(env):
    put(env, 1.0, 0.0, 0.0)
    torch.testing.assert_close(velocity_tracking(env), torch.ones(ROBOTS))
    env.sim.data.qvel[:, 0] = 0.5
    torch.testing.assert_close(velocity_tracking(env), torch.full((ROBOTS,), 1.0 / 1.5))
    put(env, 0.0, 0.0, 0.0)
    torch.testing.assert_close(velocity_tracking(env), torch.zeros(ROBOTS))


def test_standing_before_barrier_is_no_stall(env):
    stalled = env.termination_manager.get_term_cfg("stalled").func
    for place, ends in (((1.0, 0.0), False), ((0.0, 0.0), True)):
        put(env, *place, 0.0)
        stalled.reset(torch.arange(ROBOTS))
        over = [stalled(env) for _ in range(160)]
        assert over[-1].all() == ends
        assert over[-1].any() == ends


def test_a_robot_below_a_ledge_has_fallen(env):
    kinds = list(env.scene.terrain.cfg.terrain_generator.sub_terrains)
    put(env, 0.0, 0.0, 0.0)
    env.sim.data.qpos[:, 2] = env.scene.env_origins[:, 2] - 0.4
    env.sim.forward()
    fell = env.termination_manager.get_term_cfg("in_gap").func(env)
    assert torch.equal(fell, env.scene.terrain.terrain_types == kinds.index("ledge"))


def test_levels_of_barriers_are_drawn_anew(env):
    term = env.curriculum_manager.get_term_cfg("level").func
    seen = set()
    for _ in range(10):
        env.episode_length_buf[:] = 100
        env.reset()
        seen |= set(term.levels.tolist())
    assert len(seen) > 6
    assert not term.passed.any()
