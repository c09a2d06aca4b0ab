"""Terrain levels (walk-in-minutes rule) and the two-level command curriculum."""

from __future__ import annotations

import math

import numpy as np
import torch
from mjlab.envs import ManagerBasedRlEnv
from mjlab.managers.curriculum_manager import CurriculumTermCfg
from torch import Tensor

from renet.tasks.mdp.base_state import distance_from_start, on_tiles, tile_terrain
from renet.tasks.mdp.commands import goal
from renet.terrain.tiles import TILE

FIRST_LEVELS = 2
"""A robot that fails at the first level tries one of so many next. The narrowest gap is all but
invisible (10 cm, seen from 30 cm above through the camera's noise): where all robots start over at
it, VP never learns what a gap looks like."""
EASIER_SHARE = 0.25
"""Share of episodes whose tile is of a level drawn from those up to the robot's own."""


class TerrainLevels:
    """Move robots whose episodes end up or down a level (Rudin et al. 2022).

    Up when half a tile lies behind, down below half of what was commanded (no more than half a tile
    can be covered, whatever the command). A flat first level is for robots that cannot walk yet:
    failing does not lead back to it, or most steps would go to flat ground, where episodes last
    longest. A robot that fell owes the whole episode, lest falling early look like keeping up; one
    that was cut off, as in a run's first, randomly shortened episodes, owes what it had time for.
    One that has not walked keeps its level, as after loading a checkpoint. A robot that passes the
    last level is sent to any level.

    From control step `easier_step` on, a share of the episodes on tiles of `easier_kinds` (both are
    parameters) use a tile of a level drawn uniformly up to the robot's own. They do not change that
    level. Without them robots forget how to cross narrow gaps.

    Attributes:
        levels: each robot's own level, [N]; `terrain.terrain_levels` is that of the tile it is on.
        passed: robots that passed the last level and have not failed since, [N] bool. They count
            as having reached the number of levels: the mean of the levels that they are sent to
            would be 6 of 10 for robots that always succeed.
    """

    def __init__(self, cfg: CurriculumTermCfg, env: ManagerBasedRlEnv) -> None:
        del cfg
        self.levels = tile_terrain(env).terrain_levels.clone()
        self.passed = torch.zeros(env.num_envs, dtype=torch.bool, device=env.device)

    def __call__(
        self,
        env: ManagerBasedRlEnv,
        env_ids: Tensor,
        easier_step: float = math.inf,
        easier_kinds: tuple[str, ...] = (),
    ) -> dict[str, Tensor]:
        """Set the levels and tiles of robots whose episodes end.

        Args:
            env: environment on tiles.
            env_ids: these robots.
            easier_step: control step from which easier tiles are drawn.
            easier_kinds: kinds of tile that are drawn so.

        Returns:
            Mean level of each kind of tile.
        """
        terrain, command = tile_terrain(env), goal(env)
        steps = env.episode_length_buf[env_ids]
        left = (env.max_episode_length - steps).clamp_min(0) * env.step_dt
        failed = env.termination_manager.terminated[env_ids]
        owed = command.commanded_distance[env_ids] + failed * left * command.speed[env_ids]
        distance = distance_from_start(env)[env_ids]
        before, types = self.levels[env_ids], terrain.terrain_types[env_ids]
        counts = (steps > 0) & (terrain.terrain_levels[env_ids] == before)
        up = counts & (distance > TILE / 2)
        down = counts & ~up & (distance < 0.5 * owed.clamp_max(TILE / 2))
        level = before + up.long() - down.long()
        highest = len(terrain.terrain_origins)
        tiles = terrain.cfg.terrain_generator.sub_terrains
        flat_starts = (kind for kind, tile in tiles.items() if getattr(tile, "flat_start", False))
        lowest = on_tiles(env, *flat_starts)[env_ids].long()
        retry = lowest + torch.randint_like(level, FIRST_LEVELS)
        level = torch.where((before >= lowest) & (level < lowest), retry, level).clamp_min(0)
        self.passed[env_ids] = (level >= highest) | (self.passed[env_ids] & ~down)
        level = torch.where(level >= highest, torch.randint_like(level, highest), level)
        self.levels[env_ids] = level
        tile = level
        if env.common_step_counter >= easier_step:
            eased = on_tiles(env, *easier_kinds)[env_ids]
            tile = torch.where(eased, _some_easier(level, lowest), level)
        terrain.terrain_levels[env_ids] = tile
        terrain.env_origins[env_ids] = terrain.terrain_origins[tile, types]
        reached = torch.where(self.passed, highest, self.levels).float()
        means = torch.zeros(len(tiles), device=env.device).scatter_reduce(
            0, terrain.terrain_types, reached, "mean", include_self=False
        )
        return dict(zip(tiles, means.unbind(), strict=True))


def _some_easier(level: Tensor, lowest: Tensor) -> Tensor:
    """Levels, a share of them replaced by ones drawn from `lowest` up to themselves, all [N]."""
    drawn = torch.rand_like(level, dtype=torch.float) < EASIER_SHARE
    depth = torch.rand_like(level, dtype=torch.float) * (level - lowest + 1)
    return torch.where(drawn & (level > lowest), lowest + depth.long(), level)


def reward_weight(
    env: ManagerBasedRlEnv, env_ids: Tensor, reward: str, points: tuple[tuple[float, float], ...]
) -> Tensor:
    """Set a reward's weight by a schedule, and return it.

    Args:
        env: environment with the reward.
        env_ids: ignored.
        reward: name of the reward.
        points: (control step, weight), in order; linear in between.
    """
    del env_ids
    steps, weights = zip(*points, strict=True)
    weight = float(np.interp(env.common_step_counter, steps, weights))
    env.reward_manager.get_term_cfg(reward).weight = weight
    return torch.tensor(weight)


def command_stage(env: ManagerBasedRlEnv, env_ids: Tensor, switch_step: int) -> Tensor:
    """Ask for standing, too, from control step `switch_step` on; returns the stage, 0 or 1."""
    del env_ids
    command = goal(env)
    if env.common_step_counter >= switch_step:
        command.stage = 1
    return torch.tensor(float(command.stage))
