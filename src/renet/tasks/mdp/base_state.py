"""State of the floating base, read from MuJoCo's arrays, and the tile below it.

The linear velocity of a free joint is that of the base in the world frame. It is up to date with
`qvel`, and takes one operation, whereas mjlab's EntityData derives it from body velocities and
quaternions. Positions and rotations are those of the last kinematics.
"""

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


def rotated(vector: Tensor, angle: Tensor) -> Tensor:
    """Rotate horizontal vectors [N, 2] counterclockwise by angles [N] rad."""
    cos = angle.cos()
    sin = angle.sin()
    x, y = vector.unbind(-1)
    return torch.stack((cos * x - sin * y, sin * x + cos * y), dim=-1)


def tile_terrain(env: ManagerBasedRlEnv) -> Any:
    """Return the scene's terrain, which tasks with tiles always have (mjlab's type is optional)."""
    return env.scene.terrain


def on_tiles(env: ManagerBasedRlEnv, *kinds: str) -> Tensor:
    """Return a mask of robots on tiles of these kinds, [N] bool; False on a plane."""
    mask = torch.zeros(env.num_envs, dtype=torch.bool, device=env.device)
    terrain = tile_terrain(env)
    if terrain is None or terrain.cfg.terrain_generator is None:
        return mask
    for column, kind in enumerate(terrain.cfg.terrain_generator.sub_terrains):
        if kind in kinds:
            mask |= terrain.terrain_types == column
    return mask


def distance_from_start(env: ManagerBasedRlEnv) -> Tensor:
    """Distance of the base from the start of its tile in the maximum norm, [N] m."""
    return (base_position(env) - env.scene.env_origins)[:, :2].abs().amax(-1)
