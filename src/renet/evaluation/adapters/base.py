"""The interface of adapters: physical units in, joint targets out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from renet.evaluation.adapters.models import Model
from renet.interface import ACTION_SIZE

LEFT_FIRST = np.array((3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8))
"""Index in `renet.interface.JOINTS` of each joint of legs FL, FR, RL, RR, the order of Isaac Gym
and of MuJoCo Menagerie's Go2. The permutation is its own inverse."""


@dataclass(frozen=True)
class Senses:
    """Sensor readings of N robots at a control step, 50 times a second.

    Joints are in the order of `renet.interface.JOINTS`: legs FR, FL, RR, RL, each with hip, thigh
    and calf. The base frame is x forward, y left, z up.
    """

    angular_velocity: np.ndarray
    """Angular velocity of the base, base frame, with the gyroscope's noise, [N, 3] rad/s."""
    gravity: np.ndarray
    """Direction of gravity, base frame, unit vector with noise, [N, 3]; (0, 0, -1) when level."""
    command: np.ndarray
    """Twists v_x, v_y in m/s and omega_z in rad/s, base frame, [N, 3]. On a course omega_z is the
    error of the heading times `interface.TURN_GAIN`, at most `MAX_TURN` either way."""
    joint_position: np.ndarray
    """Joint positions, not relative to a pose, with the encoders' zero errors, [N, 12] rad."""
    joint_velocity: np.ndarray
    """Joint velocities with noise, [N, 12] rad/s."""
    depth: np.ndarray
    """Depth images, at most 2 m, top row first, [N, 48, 64] m. There is a new image every 0.1 s,
    unless the camera fails. The field of view is 66 by 52 degrees, from the mount of the adapter's
    bundle: on the Go1 30, on the Go2 23 degrees downward (`renet.camera.Intrinsics`, the robot's
    `MountCfg`)."""
    velocity: np.ndarray
    """True velocity of the base, base frame, [N, 3] m/s, which no robot measures. Empty unless
    the adapter's `needs_velocity` is true."""
    feet_contact: np.ndarray
    """True for feet that touch the ground, as feet with sensors tell, [N, 4] bool, in the order of
    `renet.interface.LEGS`. Empty unless the adapter's `needs_feet_contact` is true."""


class Adapter:
    """Base of all adapters: one policy for N robots.

    A subclass names the robot and the gains that the policy was trained with, converts `Senses`
    to the inputs of its model, and the model's outputs to joint targets.
    """

    bundle: ClassVar[str] = "go1-parkour"
    """Name of the shipped bundle whose robot the policy drives: go1-parkour or go2-parkour."""
    stiffness: ClassVar[float] = 40.0
    """Kp in the policy's training, N m/rad."""
    damping: ClassVar[float] = 1.0
    """Kd in the policy's training, N m s/rad."""
    uses_camera: ClassVar[bool] = False
    """True if the policy reads depth images."""
    needs_velocity: ClassVar[bool] = False
    """True if the policy reads the base's true velocity; `Senses.velocity` is empty otherwise."""
    needs_feet_contact: ClassVar[bool] = False
    """True if the policy reads its feet's contacts; `Senses.feet_contact` is empty otherwise."""

    def __init__(self, model: Model, num_robots: int) -> None:
        """Prepare to drive N robots.

        Args:
            model: The user's file; raises RenetError if it does not fit this adapter.
            num_robots: N.
        """
        self.model = model
        self.num_robots = num_robots

    def reset(self, mask: np.ndarray) -> None:
        """Clear the state of the masked robots, [N] bool."""

    def act(self, senses: Senses) -> np.ndarray:
        """Return joint targets, [N, 12] rad."""
        raise NotImplementedError


class OffsetAdapter(Adapter):
    """Base of adapters whose actions are offsets from a pose, and who observe the last action."""

    pose: np.ndarray
    """Joint positions at which an action is zero, [12] rad, in the policy's joint order."""
    action_scale: np.ndarray | float
    """Joint target per unit of action, rad."""

    def __init__(self, model: Model, num_robots: int) -> None:
        super().__init__(model, num_robots)
        self._action = np.zeros((num_robots, ACTION_SIZE), np.float32)
        """Action of the last step, [N, 12], in the policy's joint order."""

    def reset(self, mask: np.ndarray) -> None:
        """Clear the last action of the masked robots, [N] bool."""
        # The first observation of an episode has no action before it.
        self._action[mask] = 0.0

    def _target(self) -> np.ndarray:
        """Return the joint targets of the last action, [N, 12] rad, in the policy's joint order."""
        return self.pose + self.action_scale * self._action
