"""A robot's readings and commands; joints are always in the order of `interface.JOINTS`."""

import math
from dataclasses import dataclass

import numpy as np

from renet.interface import ACTION_SIZE


@dataclass(frozen=True)
class RobotState:
    """Reading of a robot's sensors, as the driver got it: checks are the controller's."""

    time: float
    """Time of the measurement on the robot's clock (`RobotDriver.now`), s."""
    joint_position: np.ndarray
    """[12] rad"""
    joint_velocity: np.ndarray
    """[12] rad/s"""
    joint_torque: np.ndarray
    """[12] N m, estimated by the motors."""
    quaternion: np.ndarray
    """[4] rotation from base to world, (w, x, y, z)."""
    angular_velocity: np.ndarray
    """[3] rad/s, base frame."""
    temperature: np.ndarray | float = math.nan
    """Temperatures of the motors, [12] °C, or that of the hottest; NaN if it is not measured."""
    battery: float = math.nan
    """Charge left, 0 to 1; NaN if the robot does not say."""
    voltage: float = math.nan
    """Voltage of the battery, V; NaN if the robot does not say."""
    fault: str = ""
    """Fault that the robot itself reports, such as a motor that no longer obeys; empty if none."""


VECTORS = {
    "joint_position": ACTION_SIZE,
    "joint_velocity": ACTION_SIZE,
    "joint_torque": ACTION_SIZE,
    "quaternion": 4,
    "angular_velocity": 3,
}
"""Arrays of a reading, with the number of their elements."""


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
    """Return True if all numbers are finite; for a dozen numbers three times as fast as NumPy."""
    return all(map(math.isfinite, values.tolist()))


def projected_gravity(quaternion: np.ndarray) -> tuple[float, float, float]:
    """Return the unit vector of gravity in the base frame, from base-to-world (w, x, y, z)."""
    # A quaternion of zeros has no direction: NaN, which the controller's checks find.
    w, x, y, z = quaternion.tolist()
    double = 2.0 / (w * w + x * x + y * y + z * z or math.nan)
    return double * (w * y - x * z), -double * (y * z + w * x), double * (x * x + y * y) - 1.0


def heading(quaternion: np.ndarray) -> float:
    """Return the yaw of the base, rad: the direction of its x axis seen from above."""
    w, x, y, z = quaternion.tolist()
    return math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
