"""When an episode ends; leaving the tile is success, hence a time-out, not a failure."""

import torch
from mjlab.envs import ManagerBasedRlEnv
from mjlab.managers.termination_manager import TerminationTermCfg
from torch import Tensor

from renet.tasks.mdp.barriers import before_barrier
from renet.tasks.mdp.base_state import base_position, distance_from_start, on_tiles
from renet.tasks.mdp.commands import goal
from renet.terrain.tiles import TILE

PIT_DEPTH = 0.25
"""Metres below a tile's start at which the base is in a gap, not above it."""


def height_above_start(env: ManagerBasedRlEnv) -> Tensor:
    """Height of the base above the start of its tile, [N] m."""
    return base_position(env)[:, 2] - env.scene.env_origins[:, 2]


def not_finite(env: ManagerBasedRlEnv) -> Tensor:
    """NaN or infinity in the physics state, where those in forces end up, [N]."""
    # A single one makes the sum not finite.
    return ~(env.sim.data.qpos.sum(-1) + env.sim.data.qvel.sum(-1)).isfinite()


def in_gap(env: ManagerBasedRlEnv) -> Tensor:
    """Base below the surface of a gap tile or of a ledge, [N]."""
    return (height_above_start(env) < -PIT_DEPTH) & on_tiles(env, "gap", "ledge")


def below_map(env: ManagerBasedRlEnv) -> Tensor:
    """Base below everything a robot can stand on: it was pressed through the ground, [N]."""
    return height_above_start(env) < -3.0  # The highest stairs go 2.1 m down.


def beyond_limits(
    env: ManagerBasedRlEnv, joint_margin: float, joint_speed: float, turn_rate: float
) -> Tensor:
    """Readings at which `renet deploy` brakes a robot, [N].

    Args:
        env: the environment.
        joint_margin: how far a joint may be beyond its range, rad.
        joint_speed: fastest of a joint, rad/s.
        turn_rate: fastest of the base around an axis of its own frame, rad/s.
    """
    robot = env.scene["robot"].data
    lower, upper = robot.joint_pos_limits.unbind(-1)
    position = robot.joint_pos
    outside = (position < lower - joint_margin) | (position > upper + joint_margin)
    too_fast = robot.joint_vel.abs() > joint_speed
    turning = robot.root_link_ang_vel_b.abs() > turn_rate
    return outside.any(-1) | too_fast.any(-1) | turning.any(-1)


def left_tile(env: ManagerBasedRlEnv) -> Tensor:
    """Walked off its tile in any direction, [N]."""
    return distance_from_start(env) > TILE / 2


class stalled:
    """Stands where it was told to walk, [N].

    Training only. Giving up in front of a stair otherwise earns the yaw reward for the rest of the
    episode, safer than any attempt to climb.

    Parameters: `patience`, seconds in which a robot that is told to walk must make `progress`, m.
    """

    def __init__(self, cfg: TerminationTermCfg, env: ManagerBasedRlEnv) -> None:
        self._origin = torch.full((env.num_envs, 2), torch.inf, device=env.device)
        self.seconds = torch.zeros(env.num_envs, device=env.device)
        """Since the last progress, [N]."""

    def __call__(
        self, env: ManagerBasedRlEnv, patience: float = 3.0, progress: float = 0.15
    ) -> Tensor:
        position = base_position(env)[:, :2]
        waits = (position - self._origin).norm(dim=-1) < progress
        waits &= (goal(env).speed > 0.0) & ~before_barrier(env)
        self._origin = torch.where(waits.unsqueeze(-1), self._origin, position)
        self.seconds = (self.seconds + env.step_dt) * waits
        return self.seconds > patience

    def reset(self, env_ids: Tensor | slice | None = None) -> None:
        self._origin[env_ids] = torch.inf
        self.seconds[env_ids] = 0.0
