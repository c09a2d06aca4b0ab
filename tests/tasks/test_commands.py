"""Goals: when they are drawn anew, from what, and around which yaw."""

import math

import pytest
import torch

from renet.tasks import make_env
from renet.tasks.parkour_env_cfg import flat_env_cfg

STILL = torch.zeros(64, 12)


@pytest.fixture(scope="module")
def walkers():
    """64 robots on a plane that no fall resets."""
    cfg = flat_env_cfg()
    cfg.terminations = {"time_out": cfg.terminations["time_out"]}
    cfg.events.pop("push")
    env = make_env(cfg, 64)
    yield env
    env.close()


@pytest.fixture
def goal(walkers):
    return walkers.command_manager.get_term("goal")


def wrapped(angle: torch.Tensor) -> torch.Tensor:
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


@pytest.mark.parametrize("begins", ["reset", "time-out"])
def test_first_goal_is_around_initial_yaw(walkers, goal, begins):
    walkers.reset(seed=3)
    goal.yaw[:], goal.commanded_distance[:] = 100.0, 5.0
    if begins == "reset":
        walkers.reset()
    else:
        walkers.episode_length_buf[:] = walkers.max_episode_length
        walkers.step(STILL)
    turn = wrapped(goal.yaw - walkers.scene["robot"].data.heading_w)
    assert turn.abs().max() <= math.pi / 2 + 1e-4
    assert turn.min() < -1.0
    assert turn.max() > 1.0
    assert ((goal.speed >= 0.2) & (goal.speed <= 1.0)).all()
    assert ((goal.time_left >= 4.0) & (goal.time_left <= 10.0)).all(), "the flat task's goals last"
    assert (goal.commanded_distance == 0.0).all()


def test_goals_change_after_their_time(walkers, goal):
    walkers.reset(seed=4)
    goal.cfg.later_turn = 0.3
    goal.time_left.clamp_(max=0.09)  # Five steps.
    speed, yaw = goal.speed.clone(), goal.yaw.clone()
    for _ in range(4):
        walkers.step(STILL)
    assert torch.equal(goal.yaw, yaw)
    assert torch.equal(goal.speed, speed)
    torch.testing.assert_close(goal.commanded_distance, 0.08 * speed)
    walkers.step(STILL)
    assert (goal.speed != speed).all()
    assert (goal.time_left >= 4.0).all()
    assert 0.2 < wrapped(goal.yaw - yaw).abs().max() <= 0.3001
    # The last step was walked towards the old goal.
    torch.testing.assert_close(goal.commanded_distance, 0.1 * speed)
    goal.cfg.later_turn = math.pi


def test_resets_keep_other_goals(walkers, goal):
    walkers.reset(seed=5)
    walkers.step(STILL)
    speed, left = goal.speed.clone(), goal.time_left.clone()
    walkers.reset(env_ids=torch.tensor([1, 2]))
    assert (goal.commanded_distance == 0.0).nonzero().flatten().tolist() == [1, 2]
    assert torch.equal(goal.speed[3:], speed[3:])
    assert torch.equal(goal.time_left[3:], left[3:])
    assert (goal.speed[1:3] != speed[1:3]).all()


def test_the_second_level_asks_for_standing(build):
    env = build(flat_env_cfg(), 256)
    goal = env.command_manager.get_term("goal")
    goal.stage = 1
    env.reset()
    # A tenth of an episode's first goals is too slow to be walking.
    assert 0.04 < (goal.speed == 0.0).float().mean() < 0.18
    goal.standing_time = 0.4
    goal.time_left[:] = 0.01
    goal.compute(dt=0.02)
    # Of those that replace them three tenths by choice, and a tenth of the rest.
    stands = goal.speed == 0.0
    assert 0.27 < stands.float().mean() < 0.47
    assert torch.equal(goal.time_left < 4.0, stands)
    walking = goal.speed[~stands]
    assert 0.1 <= walking.min() < 0.2 < walking.max() <= 1.0
    goal.standing_time, goal.time_left[:] = 1.0, 0.01
    goal.compute(dt=0.02)
    assert (goal.time_left >= 4.0).all()


def test_a_fixed_goal_is_kept(build):
    cfg = flat_env_cfg(play=True)
    cfg.commands["goal"].fixed_speed = 0.6
    goal = build(cfg, 8).command_manager.get_term("goal")
    assert (goal.speed == 0.6).all()
    assert goal.heading_error.abs().max() < 1e-3
    yaw = goal.yaw.clone()
    goal.time_left[:] = 0.01
    goal.compute(dt=0.02)
    assert (goal.speed == 0.6).all()
    torch.testing.assert_close(goal.yaw, yaw)
