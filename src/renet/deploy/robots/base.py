"""What every robot driver offers; joints are always in the order of `interface.JOINTS`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from renet.interface import ACTION_SIZE, CONTROL_DT

if TYPE_CHECKING:
    from renet.deploy.robots.envelope import Envelope


@dataclass(frozen=True)
class RobotState:
    """One reading of a robot's sensors. Drivers report what they got: the controller checks it."""

    time: float
    """Seconds on the robot's clock (`RobotDriver.now`) at which it was measured."""
    joint_position: np.ndarray
    """[12] rad"""
    joint_velocity: np.ndarray
    """[12] rad/s"""
    joint_torque: np.ndarray
    """[12] N m, estimated by the motors."""
    quaternion: np.ndarray
    """[4] base to world, (w, x, y, z)."""
    angular_velocity: np.ndarray
    """[3] rad/s, base frame."""
    temperature: float = math.nan
    """Of the hottest motor, °C; NaN if the robot does not say."""
    battery: float = math.nan
    """Charge left, 0 to 1; NaN if the robot does not say."""


VECTORS = {
    "joint_position": ACTION_SIZE,
    "joint_velocity": ACTION_SIZE,
    "joint_torque": ACTION_SIZE,
    "quaternion": 4,
    "angular_velocity": 3,
}
"""Arrays of a reading, and how many numbers each has."""


@dataclass(frozen=True)
class JointCommand:
    """Joint servos: torque = stiffness (position - q) - damping dq/dt."""

    position: np.ndarray
    """[12] rad"""
    stiffness: np.ndarray
    """[12] N m/rad"""
    damping: np.ndarray
    """[12] N m s/rad"""


class RobotDriver(Protocol):
    """A robot, real or simulated, with a clock of its own."""

    envelope: Envelope
    """The robot's own limits, which no bundle can widen."""

    def connect(self) -> None:
        """Begin to talk; raises RenetError with what to do when that fails."""

    def read(self) -> RobotState | None:
        """Newest reading, without waiting; None before the first."""

    def write(self, command: JointCommand) -> None:
        """Hand a command to the joint servos, which hold it until the next."""

    def now(self) -> float:
        """Seconds on the robot's clock, never decreasing."""
        ...

    def wait(self, until: float) -> None:
        """Let time pass until `now()` reaches `until`; return at once if it has."""

    def close(self) -> None:
        """Let go of the robot; safe to call twice."""


def next_step(robot: RobotDriver, due: float) -> float:
    """Wait for the control step after the one that was due at `due`; returns when that is due.

    A step that is missed is left out: two in quick succession help no robot.
    """
    due += CONTROL_DT * (math.floor((robot.now() - due) / CONTROL_DT + 0.1) + 1)
    robot.wait(due)
    return due


def projected_gravity(quaternion: np.ndarray) -> tuple[float, float, float]:
    """Unit vector of gravity in the base frame, from base-to-world (w, x, y, z)."""
    w, x, y, z = quaternion.tolist()
    double = 2.0 / (w * w + x * x + y * y + z * z or math.nan)
    return double * (w * y - x * z), -double * (y * z + w * x), double * (x * x + y * y) - 1.0


def heading(quaternion: np.ndarray) -> float:
    """Yaw of the base, rad: direction of its x axis seen from above."""
    w, x, y, z = quaternion.tolist()
    return math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
