"""When an episode ends; leaving the tile is success, hence a time-out, not a failure."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from renet.tasks.rewards import goal
from renet.tiles import TILE

if TYPE_CHECKING:
    from mjlab.envs import ManagerBasedRlEnv

TILT = -0.17
"""Vertical part of gravity in the base frame above which the robot lies: tilted over 80 degrees."""
PIT_DEPTH = 0.25
"""Metres below the tile's start at which the base is in a gap, not above it."""
MAP_DEPTH = 3.0
"""Metres below a tile's start at which there is no ground: the highest stairs go 2.1 m down."""


def fallen(env: ManagerBasedRlEnv) -> Tensor:
    """Rolled or pitched over."""
    return env.scene["robot"].data.projected_gravity_b[:, 2] > TILT


def not_finite(env: ManagerBasedRlEnv) -> Tensor:
    """NaN or infinity in the physics state, which those of forces end in: one makes the sum so."""
    return ~((env.sim.data.qpos.sum(-1) + env.sim.data.qvel.sum(-1)).abs() < torch.inf)


def in_gap(env: ManagerBasedRlEnv) -> Tensor:
    """Base below the surface of a gap tile."""
    terrain = env.scene.terrain
    assert terrain is not None
    assert terrain.cfg.terrain_generator is not None
    kinds = list(terrain.cfg.terrain_generator.sub_terrains)
    if "gap" not in kinds:
        return torch.zeros(env.num_envs, dtype=torch.bool, device=env.device)
    height = env.scene["robot"].data.root_link_pos_w[:, 2] - env.scene.env_origins[:, 2]
    return (terrain.terrain_types == kinds.index("gap")) & (height < -PIT_DEPTH)


def below_map(env: ManagerBasedRlEnv) -> Tensor:
    """Base below everything a robot can stand on: it was pressed through the ground."""
    height = env.scene["robot"].data.root_link_pos_w[:, 2] - env.scene.env_origins[:, 2]
    return height < -MAP_DEPTH


def left_tile(env: ManagerBasedRlEnv) -> Tensor:
    """Walked off its tile in any direction."""
    return tile_distance(env) > TILE / 2


def tile_distance(env: ManagerBasedRlEnv) -> Tensor:
    """Distance from the tile's middle in the tile's (square) norm, [N] m."""
    offset = env.scene["robot"].data.root_link_pos_w - env.scene.env_origins
    return offset[:, :2].abs().amax(-1)


class Stalled:
    """Stands where it was told to walk: less than `progress` metres in `window` seconds.

    Training only. Giving up in front of a stair otherwise earns the yaw reward for the rest of the
    episode, safer than any attempt to climb.
    """

    def __init__(self, cfg, env: ManagerBasedRlEnv) -> None:
        del cfg
        self._origin = torch.full((env.num_envs, 2), torch.nan, device=env.device)
        self._since = torch.zeros(env.num_envs, device=env.device)

    def __call__(self, env: ManagerBasedRlEnv, window: float, progress: float) -> Tensor:
        """Update and return [N] bool."""
        at = env.scene["robot"].data.root_link_pos_w[:, :2]
        moved = ~((at - self._origin).norm(dim=-1) < progress)
        restart = moved | (goal(env).speed == 0.0)
        self._origin = torch.where(restart.unsqueeze(-1), at, self._origin)
        self._since = torch.where(restart, 0.0, self._since + env.step_dt)
        return self._since > window

    def reset(self, env_ids: Tensor | slice | None = None) -> None:
        """A new episode starts somewhere else."""
        ids = slice(None) if env_ids is None else env_ids
        self._origin[ids], self._since[ids] = torch.nan, 0.0
