"""Terminations of episodes. Leaving the tile is success, and therefore a time-out."""

import torch
from mjlab.envs import ManagerBasedRlEnv
from mjlab.managers.termination_manager import TerminationTermCfg
from torch import Tensor

from renet.tasks.mdp.barriers import before_barrier
from renet.tasks.mdp.base_state import base_position, distance_from_start, on_tiles
from renet.tasks.mdp.commands import goal
from renet.terrain.tiles import TILE

FALL_DEPTH = 0.25
"""Depth of the base below a tile's start at which it is in a gap, m."""
MAP_DEPTH = 3.0
"""Depth of the base below a tile's start at which it is below all ground, m; the highest stairs go
2.1 m down."""


def height_above_start(env: ManagerBasedRlEnv) -> Tensor:
    """Height of the base above the start of its tile, [N] m."""
    return base_position(env)[:, 2] - env.scene.env_origins[:, 2]


def not_finite(env: ManagerBasedRlEnv) -> Tensor:
    """True where positions or velocities are NaN or infinite, [N] bool."""
    # One such number makes the sum NaN or infinite.
    total = env.sim.data.qpos.sum(-1) + env.sim.data.qvel.sum(-1)
    return ~total.isfinite()


def in_gap(env: ManagerBasedRlEnv) -> Tensor:
    """True where the base is below the surface of a gap tile or of a ledge, [N] bool."""
    return (height_above_start(env) < -FALL_DEPTH) & on_tiles(env, "gap", "ledge")


def below_map(env: ManagerBasedRlEnv) -> Tensor:
    """True where the base was pressed through the ground, [N] bool."""
    return height_above_start(env) < -MAP_DEPTH


def beyond_limits(
    env: ManagerBasedRlEnv, joint_margin: float, joint_speed: float, turn_rate: float
) -> Tensor:
    """True where `renet deploy` would brake a real robot, [N] bool.

    Args:
        env: The environment.
        joint_margin: Largest distance of a joint from its range, rad.
        joint_speed: Largest speed of a joint, rad/s.
        turn_rate: Largest angular velocity of the base around an axis of its frame, rad/s.
    """
    robot = env.scene["robot"].data
    lower, upper = robot.joint_pos_limits.unbind(-1)
    position = robot.joint_pos
    out_of_range = (position < lower - joint_margin) | (position > upper + joint_margin)
    too_fast = robot.joint_vel.abs() > joint_speed
    turns_too_fast = robot.root_link_ang_vel_b.abs() > turn_rate
    return out_of_range.any(-1) | too_fast.any(-1) | turns_too_fast.any(-1)


def left_tile(env: ManagerBasedRlEnv) -> Tensor:
    """True where a robot walked off its tile in any direction, [N] bool."""
    return distance_from_start(env) > TILE / 2


class stalled:
    """True where a robot stands although its command is to walk, [N] bool; for training only.

    Otherwise a robot that gives up in front of a stair would earn the yaw reward for the rest of
    the episode, which is safer than any attempt to climb.

    Parameters:
        patience: Time in which a robot must make progress, s.
        progress: Distance that counts as progress, m.
    """

    def __init__(self, cfg: TerminationTermCfg, env: ManagerBasedRlEnv) -> None:
        # Position of the last progress; infinitely far away at the beginning of an episode.
        self._origin = torch.full((env.num_envs, 2), torch.inf, device=env.device)
        self.seconds = torch.zeros(env.num_envs, device=env.device)
        """Time since the last progress, [N] s."""

    def __call__(
        self, env: ManagerBasedRlEnv, patience: float = 3.0, progress: float = 0.15
    ) -> Tensor:
        position = base_position(env)[:, :2]
        is_still = (position - self._origin).norm(dim=-1) < progress
        # A robot may stand where its command says so, or a wall is ahead.
        is_still &= (goal(env).speed > 0.0) & ~before_barrier(env)
        self._origin = torch.where(is_still.unsqueeze(-1), self._origin, position)
        self.seconds = (self.seconds + env.step_dt) * is_still
        return self.seconds > patience

    def reset(self, env_ids: Tensor | slice | None = None) -> None:
        self._origin[env_ids] = torch.inf
        self.seconds[env_ids] = 0.0
