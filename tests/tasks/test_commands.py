"""Goals: when they are drawn anew, from what, and around which yaw."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from .conftest import build

STILL = torch.zeros(64, 12)


@pytest.fixture(scope="module")
def walkers():
    """64 robots on a plane that no fall resets."""
    from renet.tasks import env_cfg

    cfg = env_cfg("Renet-Go1-Flat")
    cfg.terminations = {"time_out": cfg.terminations["time_out"]}
    cfg.events.pop("push")
    env = build(cfg, 64)
    yield env
    env.close()


def expected(goal, before: dict, heading: np.ndarray, ranges: tuple, dt: float) -> dict:
    """What `pursue` should make of a state and its draws, robot by robot in plain Python."""
    after = {name: value.copy() for name, value in before.items()}
    for i, draw in enumerate(goal._draws.numpy().astype(float)):
        origin, turn, share = before["yaw"][i], ranges[5], ranges[2]
        if before["time_left"][i] <= 0.0:
            origin, turn, share = heading[i], ranges[4], 0.0
        else:
            after["asked"][i] += before["speed"][i] * dt
            after["time_left"][i] -= dt
        if after["time_left"][i] <= 0.0:
            speed = ranges[0] + (ranges[1] - ranges[0]) * draw[0]
            standing = draw[1] < share or speed < ranges[3]
            after["speed"][i] = 0.0 if standing else speed
            aim = origin + turn * (2.0 * draw[2] - 1.0)
            after["yaw"][i] = (aim + math.pi) % (2.0 * math.pi) - math.pi
            after["time_left"][i] = ranges[6] + (ranges[7] - ranges[6]) * draw[3]
    return after


@pytest.mark.parametrize("stage", [0, 1])
def test_a_step_of_all_goals_is_what_plain_python_makes_of_the_same_draws(walkers, stage):
    goal = walkers.command_manager.get_term("goal")
    goal.stage = stage
    walkers.reset(seed=3)
    goal.time_left[::3] = 0.01  # Up with the next step.
    walkers._reset_idx(torch.arange(0, 64, 5))
    walkers.sim.forward()
    names = ("speed", "yaw", "time_left", "asked")
    before = {name: getattr(goal, name).numpy().copy() for name in names}
    ranges = (*goal.cfg.ranges(stage), *goal.cfg.resampling_time_range)
    walkers.command_manager.compute(dt=0.02)
    heading = walkers.scene["robot"].data.heading_w.numpy()
    for name, value in expected(goal, before, heading, ranges, 0.02).items():
        np.testing.assert_allclose(getattr(goal, name).numpy(), value, atol=1e-5, err_msg=name)
    error = goal.yaw.numpy() - heading
    told = np.stack((goal.speed.numpy(), np.sin(error), np.cos(error)), -1)
    np.testing.assert_allclose(goal.command.numpy(), told, atol=1e-5)
    goal.stage = 0


def test_goals_change_after_their_time_and_turn_no_further_than_they_may(walkers):
    goal = walkers.command_manager.get_term("goal")
    walkers.reset(seed=4)
    assert (goal.time_left >= 4.0).all(), "the flat task's goals last 4 to 10 s"
    goal.cfg.later_turn = 0.3
    goal.time_left.clamp_(max=0.1)  # Five steps.
    speed, yaw = goal.speed.clone(), goal.yaw.clone()
    for _ in range(4):
        walkers.step(STILL)
    assert torch.equal(goal.yaw, yaw)
    walkers.step(STILL)
    walkers.step(STILL)
    assert (goal.speed != speed).all()
    turned = (goal.yaw - yaw + math.pi) % (2 * math.pi) - math.pi
    assert 0.2 < turned.abs().max() <= 0.3001
    goal.cfg.later_turn = math.pi


def test_others_keep_their_goals_when_some_begin_anew(walkers):
    goal = walkers.command_manager.get_term("goal")
    walkers.reset(seed=5)
    speed, left = goal.speed.clone(), goal.time_left.clone()
    walkers.reset(env_ids=torch.tensor([1, 2]))
    assert torch.equal(goal.speed[3:], speed[3:])
    assert torch.equal(goal.time_left[3:], left[3:])
    assert (goal.speed[1:3] != speed[1:3]).all()
