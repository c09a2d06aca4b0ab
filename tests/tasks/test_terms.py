"""Reward, cost and curriculum maths against hand-computed numbers."""

from __future__ import annotations

import math

import torch

from renet.tasks import rewards
from renet.tasks.constraints import excess, outside
from renet.tasks.curriculum import level_change

from .conftest import build


def test_goal_velocity_is_equation_6():
    velocity = torch.tensor([[0.3, 0.0], [2.0, 0.0], [-0.5, 0.0], [0.0, 0.0], [3.0, 4.0]])
    direction = torch.tensor([[1.0, 0.0]]).repeat(5, 1)
    speed = torch.tensor([0.6, 0.6, 0.5, 0.0, 0.0])
    got = rewards.goal_velocity(velocity, direction, speed)
    expected = torch.tensor([0.5, 1.0, -1.0, 1.0, 1.0 / 6.0])
    torch.testing.assert_close(got, expected, atol=1e-4, rtol=0)


def test_collision_counts_bodies_not_geoms():
    thigh_trunk, calf = torch.zeros(2, 5, 3), torch.zeros(2, 8, 3)
    thigh_trunk[0, 4, 2] = 5.0
    calf[0, 0, 2] = calf[0, 1, 2] = 3.0  # Both geoms of one calf.
    calf[0, 6, 0] = 0.2
    thigh_trunk[1, 0, 1] = 0.05  # Below 0.1 N.
    assert rewards.collision_count(thigh_trunk, calf).tolist() == [3.0, 0.0]


def test_costs_by_hand():
    low, high = torch.tensor([[-1.0, -1.0]]), torch.tensor([[1.0, 1.0]])
    assert outside(torch.tensor([[1.5, -1.25]]), low, high).item() == 0.75
    assert excess(torch.tensor([[-12.0, 9.0]]), torch.tensor([10.0, 10.0])).item() == 2.0


def test_walk_in_minutes_rule():
    distance = torch.tensor([4.1, 3.0, 1.5, 1.5, 0.1])
    speed = torch.tensor([0.2, 1.0, 1.0, 0.1, 0.0])
    up, down = level_change(distance, speed, 20.0)
    # Wanted: min(4, 20 c_x) m; below half of it means down.
    assert up.tolist() == [True, False, False, False, False]
    assert down.tolist() == [False, False, True, False, False]


def test_goals_are_drawn_and_the_second_level_asks_for_standing():
    env = build("Renet-Go1-Flat", 256)
    env.reset()
    goal = env.command_manager.get_term("goal")
    assert 0.2 <= goal.speed.min() <= goal.speed.max() <= 1.0
    assert goal.heading_error.abs().max() <= math.pi / 2 + 1e-3
    goal.stage = 1
    env.reset()
    standing = (goal.speed == 0.0).float().mean()
    assert 0.02 < standing < 0.25
    command = goal.command
    torch.testing.assert_close(command[:, 1] ** 2 + command[:, 2] ** 2, torch.ones(256))


def test_a_fixed_goal_is_kept():
    from renet.tasks import env_cfg

    cfg = env_cfg("Renet-Go1-Flat", play=True)
    cfg.commands["goal"].fixed = (0.6, None)
    env = build(cfg, 8)
    env.reset()
    goal = env.command_manager.get_term("goal")
    assert (goal.speed == 0.6).all()
    assert goal.heading_error.abs().max() < 1e-3


def test_joint_acceleration_starts_each_episode_at_rest():
    env = build("Renet-Go1-Flat", 2)
    env.reset()
    env.step(torch.full((2, 12), 1.0))
    term = rewards.JointAcceleration(None, env)
    velocity = env.scene["robot"].data.joint_vel
    expected = (velocity / 0.02).square().sum(-1)
    torch.testing.assert_close(term(env), expected)
    assert (term(env) == 0.0).all()
    term.reset(torch.tensor([0]))
    again = term(env)
    torch.testing.assert_close(again[0], expected[0])
    assert again[1] == 0.0
