"""Interface of robot drivers; joints are always in the order of `interface.JOINTS`."""

import math
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from renet.bundle.manifest import RobotSpec
from renet.interface import ACTION_SIZE
from renet.robots import Robot


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


class RobotDriver(Protocol):
    """Robot, real or simulated, with a clock of its own.

    It may have a method `show`, which is called at every control step to show it to the user; an
    attribute `refused` after `connect`, a line for the user about what the system refused it; and
    in a simulation `base_position`, [3] m in the world, which is recorded.
    """

    description: Robot
    """Description of the robot, whose limits no bundle can widen."""

    def connect(self) -> None:
        """Begin to talk to the robot; raises RenetError that says what to do if that fails."""

    def read(self) -> RobotState | None:
        """Return the newest reading, without waiting; None before the first."""

    def write(self, command: JointCommand) -> None:
        """Hand a command to the joint servos, which hold it until the next."""

    def now(self) -> float:
        """Return the time on the robot's clock, s, which never decreases."""
        ...

    def wait(self, until: float) -> None:
        """Let time pass until `now()` reaches `until`; return at once if it has."""

    def close(self) -> None:
        """Let go of the robot; a second call does nothing."""


@dataclass(frozen=True)
class DriverCfg:
    """Robot of `renet deploy --robot NAME`; its fields are options of the command."""

    simulated: ClassVar[bool] = False
    """True if the robot lives in this process, on a clock of its own."""
    drives: ClassVar[Robot | None] = None
    """The only robot that it drives; None if it drives any that a bundle may have."""
    bundle: ClassVar[str | None] = None
    """Name of the bundle that ships for this robot; None: that of the Go1."""
    camera: ClassVar[str] = "realsense"
    """Name of the camera that `--camera auto` means."""

    @property
    def live(self) -> bool:
        """True if the robot's clock is the wall's."""
        return not self.simulated

    @property
    def address(self) -> str:
        """Address that tells this robot from others of its kind, such as a port.

        Only one program at a time drives the robot at an address. By default there is only one
        robot of a kind.
        """
        return ""

    def check(self) -> None:
        """Raise RenetError for options that cannot work."""

    def build(self, spec: RobotSpec, live: bool, seed: int, dry_run: bool) -> RobotDriver:
        """Make the driver without connecting it.

        Args:
            spec: Robot of the bundle.
            live: Pace a simulation to the wall clock.
            seed: Seed of a simulation's randomness.
            dry_run: Nothing will be commanded.

        Raises:
            RenetError: The bundle is another robot's, or a package or file is missing.
        """
        raise NotImplementedError


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
