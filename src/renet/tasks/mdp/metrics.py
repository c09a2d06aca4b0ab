"""Metrics, logged as means over an episode's steps."""

from __future__ import annotations

from mjlab.envs import ManagerBasedRlEnv
from torch import Tensor


def reward_clipped(env: ManagerBasedRlEnv) -> Tensor:
    """1 where the step's summed reward is negative, which `clip_reward` sets to zero, [N]."""
    return (env.reward_buf < 0.0).float()
