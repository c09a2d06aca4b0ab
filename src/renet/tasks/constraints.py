"""Constraint costs of the cMDP: joint position, joint velocity, torque (RENet, Method A).

Each is zero for motion inside its soft limit. Torque is judged before the actuator saturates:
clipped torque never violates anything.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from renet.vocabulary import CONSTRAINTS

if TYPE_CHECKING:
    from renet.tasks.env import RenetEnv


@dataclass
class ConstraintCfg:
    """Soft fractions of the hard limits above which a joint costs."""

    position: float = 0.9
    """Share of the joint range, as the robot's soft limits."""
    velocity: float = 0.8
    """Share of the motor's speed limit."""
    torque: float = 0.8
    """Share of the motor's effort limit."""


def excess(value: Tensor, limit: Tensor) -> Tensor:
    """sum relu(|value| - limit) over joints, [N]."""
    return torch.relu(value.abs() - limit).sum(-1)


def outside(value: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """sum of distances outside [low, high] over joints, [N]."""
    return (torch.relu(low - value) + torch.relu(value - high)).sum(-1)


def violated(env: RenetEnv, constraint: str) -> Tensor:
    """1 where a constraint of vocabulary.CONSTRAINTS cost something in this step, [N]."""
    return (env.costs[:, CONSTRAINTS.index(constraint)] > 0.0).float()


class Constraints:
    """Evaluates all three costs of an environment, order of vocabulary.CONSTRAINTS."""

    def __init__(self, cfg: ConstraintCfg, env: RenetEnv) -> None:
        self.robot, self.kind = env.scene["robot"], env.cfg.robot
        motors = [self.kind.motor(name) for name in self.robot.joint_names]
        limits = torch.tensor([(m.velocity, m.torque) for m in motors], device=env.device)
        self.velocity_limit = cfg.velocity * limits[:, 0]
        self.torque_limit = cfg.torque * limits[:, 1]
        low, high = self.robot.data.joint_pos_limits.unbind(-1)
        middle, reach = (low + high) / 2, cfg.position * (high - low) / 2
        self.low, self.high = middle - reach, middle + reach

    def __call__(self) -> Tensor:
        """[N, 3]: rad, rad/s (each joint counts at most 1), N m.

        Torque is what the nominal gains ask for, whatever gains a robot's servos have drawn.
        """
        data, kind = self.robot.data, self.kind
        error = data.joint_pos_target - data.joint_pos
        torque = kind.stiffness * error - kind.damping * data.joint_vel
        velocity = torch.relu(data.joint_vel.abs() - self.velocity_limit).clamp_max(1.0).sum(-1)
        costs = (
            outside(data.joint_pos, self.low, self.high),
            velocity,
            excess(torque, self.torque_limit),
        )
        return torch.nan_to_num(torch.stack(costs, dim=-1), nan=0.0, posinf=0.0, neginf=0.0)
