"""A robot's readings and commands; joints are always in the order of `interface.JOINTS`."""

import math
from dataclasses import dataclass

import numpy as np

from renet.interface import ACTION_SIZE


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
    temperature: np.ndarray | float = math.nan
    """Temperatures of the motors, [12] °C, or that of the hottest; NaN if it is not measured."""
    battery: float = math.nan
    """Charge left, 0 to 1; NaN if the robot does not say."""
    voltage: float = math.nan
    """Voltage of the battery, V; likewise."""
    fault: str = ""
    """What the robot says is wrong with itself, such as a motor that obeys no more; else empty."""


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


def all_finite(values: np.ndarray) -> bool:
    """Whether a few numbers are finite: for a dozen this is three times as fast as NumPy."""
    return all(map(math.isfinite, values.tolist()))


def projected_gravity(quaternion: np.ndarray) -> tuple[float, float, float]:
    """Unit vector of gravity in the base frame, from base-to-world (w, x, y, z)."""
    w, x, y, z = quaternion.tolist()
    double = 2.0 / (w * w + x * x + y * y + z * z or math.nan)
    return double * (w * y - x * z), -double * (y * z + w * x), double * (x * x + y * y) - 1.0


def heading(quaternion: np.ndarray) -> float:
    """Yaw of the base, rad: direction of its x axis seen from above."""
    w, x, y, z = quaternion.tolist()
    return math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
