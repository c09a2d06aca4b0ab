"""State of the floating base, read from MuJoCo's arrays.

The velocities of a free joint are those of the base: linear in the world frame, angular in the
base frame. They are as new as `qvel`, and cost one operation where mjlab's EntityData derives them
from body velocities and quaternions.
"""

from __future__ import annotations

from typing import Any

import torch
from mjlab.envs import ManagerBasedRlEnv
from torch import Tensor


def base_position(env: ManagerBasedRlEnv) -> Tensor:
    """Position of the base in the world frame, [N, 3] m."""
    return env.sim.data.xpos[:, env.scene["robot"].indexing.root_body_id]


def base_rotation(env: ManagerBasedRlEnv) -> Tensor:
    """Rotation matrix from the base frame to the world frame, [N, 3, 3]."""
    return env.sim.data.xmat[:, env.scene["robot"].indexing.root_body_id]


def base_velocity(env: ManagerBasedRlEnv) -> Tensor:
    """Linear velocity of the base in the world frame, [N, 3] m/s."""
    return env.sim.data.qvel[:, env.scene["robot"].indexing.free_joint_v_adr[:3]]


def base_heading(env: ManagerBasedRlEnv) -> Tensor:
    """Yaw of the base's forward axis in the world frame, [N] rad."""
    forward = base_rotation(env)[:, :, 0]
    return torch.atan2(forward[:, 1], forward[:, 0])


def tile_terrain(env: ManagerBasedRlEnv) -> Any:
    """The terrain of a task on tiles; mjlab's type allows for none, and for planes."""
    return env.scene.terrain


def on_tiles(env: ManagerBasedRlEnv, *kinds: str) -> Tensor:
    """Robots on tiles of these kinds, [N] bool: none where the task has no such tiles."""
    found, terrain = (
        torch.zeros(env.num_envs, dtype=torch.bool, device=env.device),
        tile_terrain(env),
    )
    generator = terrain.cfg.terrain_generator if terrain is not None else None
    for number, kind in enumerate(generator.sub_terrains if generator is not None else ()):
        if kind in kinds:
            found |= terrain.terrain_types == number
    return found


def height_above_start(env: ManagerBasedRlEnv) -> Tensor:
    """Height of the base above the start of its tile, [N] m."""
    return base_position(env)[:, 2] - env.scene.env_origins[:, 2]


def distance_from_start(env: ManagerBasedRlEnv) -> Tensor:
    """Distance of the base from the start of its tile in the maximum norm, [N] m."""
    return (base_position(env) - env.scene.env_origins)[:, :2].abs().amax(-1)
