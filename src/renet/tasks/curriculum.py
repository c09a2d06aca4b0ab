"""Terrain levels (walk-in-minutes rule) and the two-level command curriculum."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor
from torch.nn.functional import one_hot

from renet.tasks.rewards import goal
from renet.tasks.terminations import tile_distance
from renet.tiles import TILE

if TYPE_CHECKING:
    from mjlab.envs import ManagerBasedRlEnv

FIRST_LEVELS = 4
"""A robot that fails at the first level tries one of so many next. The narrowest gap is all but
invisible (10 cm, seen from 30 cm above through the camera's noise): where all robots start over at
it, VP never learns what a gap looks like."""


def level_change(distance: Tensor, asked: Tensor) -> tuple[Tensor, Tensor]:
    """Who moves up and who moves down (Rudin et al. 2022).

    Args:
        distance: [N] m from the tile's middle at the episode's end.
        asked: [N] m the commands amount to over the episode.

    Returns:
        Masks [N]: up when half a tile lies behind, down below half of what was commanded (no more
        than half a tile can be covered, whatever the command).
    """
    up = distance > TILE / 2
    return up, ~up & (distance < 0.5 * asked.clamp_max(TILE / 2))


def asked_distance(env: ManagerBasedRlEnv) -> Tensor:
    """Metres each robot was to walk, [N].

    A robot that fell owes the whole episode, lest falling early look like keeping up; one that was
    cut off, as in a run's first, randomly shortened episodes, owes what it had time for.
    """
    command = goal(env)
    left = (env.max_episode_length - env.episode_length_buf).clamp_min(0) * env.step_dt
    return command.asked + env.termination_manager.terminated * command.speed * left


class TerrainLevels:
    """Moves robots between rows; the mean level of each kind of tile is logged."""

    def __init__(self, cfg, env: ManagerBasedRlEnv) -> None:
        del cfg
        terrain = env.scene.terrain
        assert terrain is not None
        assert terrain.cfg.terrain_generator is not None
        self.kinds = list(terrain.cfg.terrain_generator.sub_terrains)
        here = one_hot(terrain.terrain_types, len(self.kinds))
        self._share = here / here.sum(0).clamp_min(1)
        """What each robot counts in each kind's mean, [N, kinds]."""

    def __call__(self, env: ManagerBasedRlEnv, env_ids: Tensor) -> dict[str, Tensor]:
        """Move the robots in `env_ids`, whose episodes end."""
        terrain = env.scene.terrain
        assert terrain is not None
        up, down = level_change(tile_distance(env), asked_distance(env))
        # A robot that has not walked, as after loading a checkpoint, may stand on any other tile.
        walked = env.episode_length_buf > 0
        up, down = (up & walked)[env_ids], (down & walked)[env_ids]
        before = terrain.terrain_levels[env_ids]
        failed = down & (before == 0)
        first = torch.randint_like(before, FIRST_LEVELS)
        terrain.terrain_levels[env_ids] = torch.where(failed, first, before)
        terrain.update_env_origins(env_ids, up, down & ~failed)
        means = terrain.terrain_levels.float() @ self._share
        return dict(zip(self.kinds, means.unbind(), strict=True))


def command_stage(env: ManagerBasedRlEnv, env_ids: Tensor, switch_step: int) -> Tensor:
    """Ask for standing still, too, once `switch_step` control steps have been taken."""
    del env_ids
    command = goal(env)
    if env.common_step_counter >= switch_step:
        command.stage = 1
    return torch.tensor(float(command.stage))
