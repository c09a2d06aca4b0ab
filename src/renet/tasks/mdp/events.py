"""Events beyond mjlab's: resets, pushes and domain randomisation are mjlab's own."""

from __future__ import annotations

from mjlab.envs import ManagerBasedRlEnv
from torch import Tensor


def clip_reward(env: ManagerBasedRlEnv, env_ids: Tensor | None) -> None:
    """Keep each step's summed reward at or above zero: dying early never pays (Extreme Parkour)."""
    del env_ids  # An event of mode `step` is applied to all robots.
    env.reward_buf.clamp_min_(0.0)
