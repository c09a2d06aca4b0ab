"""Terrain levels (walk-in-minutes rule) and the two-level command curriculum."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from renet.tasks.rewards import goal
from renet.tasks.terminations import tile_distance
from renet.tasks.terrains import TILE

if TYPE_CHECKING:
    from mjlab.envs import ManagerBasedRlEnv


def level_change(distance: Tensor, speed: Tensor, seconds: float) -> tuple[Tensor, Tensor]:
    """Who moves up and who moves down (Rudin et al. 2022).

    Args:
        distance: [N] m from the tile's middle at the episode's end.
        speed: [N] m/s commanded. seconds: length of a full episode.

    Returns:
        Masks [N]: up when half a tile lies behind, down below half of what was commanded (no more
        than half a tile can be covered, whatever the command).
    """
    up = distance > TILE / 2
    wanted = (speed * seconds).clamp_max(TILE / 2)
    return up, ~up & (distance < 0.5 * wanted)


def terrain_levels(env: ManagerBasedRlEnv, env_ids: Tensor) -> dict[str, Tensor]:
    """Move robots between rows; the mean level of each kind of tile is logged."""
    terrain = env.scene.terrain
    assert terrain is not None
    assert terrain.cfg.terrain_generator is not None
    if env.common_step_counter > 0:  # Before the first step nobody has walked.
        up, down = level_change(
            tile_distance(env)[env_ids], goal(env).speed[env_ids], env.max_episode_length_s
        )
        terrain.update_env_origins(env_ids, up, down)
    levels = terrain.terrain_levels.float()
    kinds = terrain.cfg.terrain_generator.sub_terrains
    means = {}
    for column, kind in enumerate(kinds):
        here = terrain.terrain_types == column
        means[kind] = (levels * here).sum() / here.sum().clamp_min(1)
    return means


def command_stage(env: ManagerBasedRlEnv, env_ids: Tensor, switch_step: int) -> Tensor:
    """Ask for standing still, too, once `switch_step` control steps have been taken."""
    del env_ids
    command = goal(env)
    if env.common_step_counter >= switch_step:
        command.stage = 1
    return torch.tensor(float(command.stage))
