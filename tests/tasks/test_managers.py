"""Stacked terms add up to what mjlab's managers make of them one by one."""

from __future__ import annotations

import pytest
import torch
from mjlab.managers.metrics_manager import MetricsManager, MetricsTermCfg
from mjlab.managers.reward_manager import RewardManager, RewardTermCfg
from mjlab.managers.termination_manager import TerminationManager, TerminationTermCfg

from renet.tasks.env import env_cfg
from renet.tasks.managers import StackedMetrics, StackedRewards, StackedTerminations
from renet.tasks.rewards import linear_velocity

from .conftest import build

NUMBERS = torch.tensor([[1.0, 2.0, 3.0], [float("nan"), 4.0, float("inf")]]).T


class Env:
    """As much of an environment as managers look at: three robots and two numbers of each."""

    num_envs, device, max_episode_length_s = 3, "cpu", 20.0


def first(env) -> torch.Tensor:
    return NUMBERS[:, 0] + env.offset


def second(env) -> torch.Tensor:
    return NUMBERS[:, 1] + env.offset


def test_rewards_are_mjlabs():
    cfg = {
        "first": RewardTermCfg(func=first, weight=-2.0),
        "off": RewardTermCfg(func=first, weight=0.0),
        "second": RewardTermCfg(func=second, weight=0.5),
    }
    env = Env()
    ours, theirs = StackedRewards(cfg, env), RewardManager(cfg, env)
    for env.offset, weight in ((0.0, 0.5), (1.0, 0.5), (2.0, 3.0)):
        for manager in (ours, theirs):
            manager.get_term_cfg("second").weight = weight
        assert torch.allclose(ours.compute(0.02), theirs.compute(0.02))
        for robot in range(3):
            assert ours.get_active_iterable_terms(robot) == [
                (name, pytest.approx(value))
                for name, value in theirs.get_active_iterable_terms(robot)
            ]
    for robots in (torch.tensor([0, 2]), None):
        ours_logged, theirs_logged = ours.reset(robots), theirs.reset(robots)
        assert ours_logged == {k: pytest.approx(v) for k, v in theirs_logged.items()}


def test_terminations_are_mjlabs():
    cfg = {
        "fall": TerminationTermCfg(func=lambda env: first(env) > 2.5),
        "late": TerminationTermCfg(func=lambda env: second(env) > 3.5, time_out=True),
    }
    env = Env()
    ours, theirs = StackedTerminations(cfg, env), TerminationManager(cfg, env)
    for env.offset in (0.0, 1.0, -3.0):
        assert torch.equal(ours.compute(), theirs.compute())
        assert torch.equal(ours.terminated, theirs.terminated)
        assert torch.equal(ours.time_outs, theirs.time_outs)
        assert all(torch.equal(ours.get_term(name), theirs.get_term(name)) for name in cfg)
        assert ours.reset(torch.tensor([1, 2])) == theirs.reset(torch.tensor([1, 2]))


@pytest.mark.parametrize("reduce", ["mean", "max"])
def test_metrics_are_mjlabs(reduce):
    cfg = {
        "first": MetricsTermCfg(func=first, reduce=reduce),
        "last": MetricsTermCfg(func=first, reduce="last"),
    }
    env = Env()
    ours, theirs = StackedMetrics(cfg, env), MetricsManager(cfg, env)
    for env.offset in (0.0, 5.0, 1.0):
        ours.compute()
        theirs.compute()
    for robots in (torch.tensor([0]), None):
        ours_logged, theirs_logged = ours.reset(robots), theirs.reset(robots)
        assert ours_logged == {k: pytest.approx(v) for k, v in theirs_logged.items()}


def test_a_term_of_the_wrong_shape_is_named():
    env = Env()
    rewards = StackedRewards({"odd": RewardTermCfg(func=lambda env: NUMBERS, weight=1.0)}, env)
    with pytest.raises(ValueError, match="'odd' returned shape"):
        rewards.compute(0.02)


def test_a_metric_of_a_reward_that_is_off_is_still_measured():
    cfg = env_cfg("Renet-Go1-Flat")
    cfg.rewards["linear_velocity"].weight = 0.0
    env = build(cfg, 2)
    env.reset()
    env.step(torch.zeros(2, 12))
    logged = dict(env.metrics_manager.get_active_iterable_terms(0))["lin_vel_reward"]
    assert logged[0] == pytest.approx(linear_velocity(env)[0].item(), abs=0.2)
    assert logged[0] != 0.0
    env.close()


def test_a_task_without_rewards_ends_and_metrics_goes_on():
    cfg = env_cfg("Renet-Go1-Flat")
    cfg.rewards, cfg.terminations, cfg.metrics = {}, {}, {}
    env = build(cfg, 2)
    env.reset()
    _, reward, terminated, truncated, _ = env.step(torch.zeros(2, 12))
    assert not reward.any()
    assert not (terminated | truncated).any()
    env.close()
