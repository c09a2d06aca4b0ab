"""Metrics, logged as means over an episode's steps."""

from __future__ import annotations

from mjlab.envs import ManagerBasedRlEnv
from torch import Tensor


def reward_clipped(env: ManagerBasedRlEnv) -> Tensor:
    """1 where the step's summed reward is negative, which `clip_reward` sets to zero, [N]."""
    return (env.reward_buf < 0.0).float()


def reward_term(env: ManagerBasedRlEnv, name: str) -> Tensor:
    """Value of a reward before its weight, which may be zero, [N].

    Args:
        env: the environment.
        name: of the reward.
    """
    manager = env.reward_manager
    term = manager.get_term_cfg(name)
    if term.weight == 0.0:
        return term.func(env, **term.params)
    return manager._step_reward[:, manager.active_terms.index(name)] / term.weight
