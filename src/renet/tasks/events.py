"""How episodes begin."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:
    from mjlab.envs import ManagerBasedRlEnv


def spawn(
    env: ManagerBasedRlEnv,
    env_ids: Tensor,
    pose_range: dict[str, tuple[float, float]],
    joint_offset: float,
) -> None:
    """Put robots near their tiles' starts, upright, about in the default pose, at rest.

    Args:
        env_ids: robots that the simulation has just reset, so that they do not move.
        pose_range: of x, y, z in m, from the default position over the start, and yaw in rad.
        joint_offset: largest difference to the default pose, rad; soft limits hold.
    """
    robot, data = env.scene["robot"], env.scene["robot"].data

    def draw(low: float, high: float, *shape: int) -> Tensor:
        return torch.empty(len(env_ids), *shape, device=env.device).uniform_(low, high)

    shift = torch.stack([draw(*pose_range[axis]) for axis in "xyz"], dim=-1)
    position = data.default_root_state[env_ids, :3] + env.scene.env_origins[env_ids] + shift
    half_yaw = draw(*pose_range["yaw"]) / 2
    zero = torch.zeros_like(half_yaw)
    rotation = torch.stack((half_yaw.cos(), zero, zero, half_yaw.sin()), dim=-1)
    robot.write_root_link_pose_to_sim(torch.cat((position, rotation), dim=-1), env_ids)
    pose = data.default_joint_pos[env_ids]
    low, high = data.soft_joint_pos_limits[env_ids].unbind(-1)
    joints = pose + draw(-joint_offset, joint_offset, pose.shape[-1])
    robot.write_joint_position_to_sim(joints.clamp(low, high), env_ids=env_ids)
