"""The interface of adapters: physical units in, joint targets out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from renet.evaluation.adapters.models import Model


@dataclass(frozen=True)
class Senses:
    """What N robots sense at a control step, 50 times a second.

    Joints are in the order of `renet.interface.JOINTS`: legs FR, FL, RR, RL, of each hip, thigh,
    calf. The base frame is x forward, y left, z up.
    """

    angular_velocity: np.ndarray
    """[N, 3] rad/s, base frame, with a gyroscope's noise."""
    gravity: np.ndarray
    """[N, 3] unit vector, base frame, with noise."""
    command: np.ndarray
    """[N, 3]: v_x, v_y in m/s and omega_z in rad/s, base frame."""
    joint_position: np.ndarray
    """[N, 12] rad, with errors of the joints' zeros."""
    joint_velocity: np.ndarray
    """[N, 12] rad/s, with noise."""
    depth: np.ndarray
    """[N, 48, 64] m, at most 2, top row first; a new image every 0.1 s, unless the camera fails.
    87 degrees wide, 58 high, 30 degrees downward (`renet.camera.Intrinsics`, the robot's
    `MountCfg`)."""
    velocity: np.ndarray
    """[N, 3] m/s, base frame: the simulator's truth, which no robot measures. Only for adapters
    whose `needs_velocity` is true; else empty."""


class Adapter:
    """Base of all adapters: one policy for N robots.

    A subclass says on which robot and with which gains the policy was trained, turns `Senses` into
    the inputs of its model, and its outputs into joint targets.
    """

    bundle: ClassVar[str] = "go1-parkour"
    """Name of the shipped bundle whose robot the policy drives: go1-parkour or go2-parkour."""
    stiffness: ClassVar[float] = 40.0
    """Kp of the policy's training, N m/rad."""
    damping: ClassVar[float] = 1.0
    """Kd of the policy's training, N m s/rad."""
    uses_camera: ClassVar[bool] = False
    """Whether the policy looks at depth images."""
    needs_velocity: ClassVar[bool] = False
    """Whether the policy needs the base's true velocity; the leaderboard says so."""

    def __init__(self, model: Model, num_robots: int) -> None:
        """Begin with N robots.

        Args:
            model: what the user's file holds; raises RenetError if it is not what this adapter
                is for. num_robots: N.
        """
        self.model = model
        self.num_robots = num_robots

    def reset(self, mask: np.ndarray) -> None:
        """Forget the past of the masked robots, [N] bool."""

    def act(self, senses: Senses) -> np.ndarray:
        """Joint targets, [N, 12] rad."""
        raise NotImplementedError
