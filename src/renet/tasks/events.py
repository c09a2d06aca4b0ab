"""How episodes begin, and what happens in them."""

# Warp compiles annotations and arithmetic that pyright takes for Python's.
# pyright: reportGeneralTypeIssues=false, reportInvalidTypeForm=false

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
import warp as wp
from torch import Tensor

from renet.tasks.step import Step
from renet.tasks.terms import Launch

if TYPE_CHECKING:
    from mjlab.envs import ManagerBasedRlEnv
    from mjlab.managers.event_manager import EventTermCfg

    from renet.tasks.env import RenetEnv


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


class Push:
    """Bases are given another horizontal velocity now and then, each at its own time."""

    def __init__(self, cfg: EventTermCfg, env: RenetEnv) -> None:
        """Parameters: `speed`, at most so much is added along x and y, m/s; `every`, s."""
        del cfg
        self._left = torch.zeros(env.num_envs, device=env.device)
        self._draws = torch.zeros(env.num_envs, 3, device=env.device)
        self._push: Launch | None = None

    def reset(self, env_ids: Tensor | None = None) -> None:
        """These robots begin a new episode: their time is drawn anew."""
        self._left[slice(None) if env_ids is None else env_ids] = 0.0

    def __call__(self, env: RenetEnv, env_ids: None, speed: float, every: tuple) -> None:
        """Push those whose time is up."""
        if self._push is None:
            inputs = [env.watched, self._draws, speed, *every, self._left]
            self._push = Launch(push, env.num_envs, inputs, env.device)
        self._draws.uniform_()
        self._push()


@wp.kernel(enable_backward=False)
def push(
    step: Step,
    draws: wp.array2d(dtype=float),
    speed: float,
    soonest: float,
    latest: float,
    left: wp.array(dtype=float),
):
    """Add up to `speed` to the base's velocity along x and y where the time `left` [N] is up.

    Where it is zero an episode begins, with another time and without a push.
    """
    robot = wp.tid()
    begins = left[robot] <= 0.0
    left[robot] = left[robot] - step.dt
    if left[robot] > 0.0:
        return
    left[robot] = soonest + (latest - soonest) * draws[robot, 2]
    if not begins:
        for axis in range(2):
            column = step.base_velocity + axis
            by = speed * (2.0 * draws[robot, axis] - 1.0)
            step.qvel[robot, column] = step.qvel[robot, column] + by
