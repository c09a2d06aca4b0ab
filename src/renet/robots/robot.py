"""Description of a quadruped, from which tasks, simulators and drivers are derived."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from renet.camera import MountCfg
from renet.errors import RenetError
from renet.interface import JOINTS, MAP_HEIGHT
from renet.motors import KINDS, joint_kind

_T = TypeVar("_T")


@dataclass(frozen=True)
class Motor:
    """Motor of a joint, from the vendor's model."""

    torque: float
    """Largest torque, N m."""
    velocity: float
    """Largest velocity, rad/s."""
    armature: float | None = None
    """Reflected inertia of the rotor, kg m^2; None keeps the MJCF's."""


@dataclass(frozen=True)
class Robot:
    """Quadruped of twelve joints.

    Mappings over joints have regular expressions as keys, of which exactly one matches each joint
    of `interface.JOINTS`.

    Raises:
        RenetError: A joint has no value or two, a value makes no sense, or there is no model.
    """

    name: str
    """Name in bundles."""
    height: float
    """Height of the base above flat ground at the start, m. The feet may be a little above it."""
    pose: Mapping[str, float]
    """Default joint positions, rad, over joints."""
    limits: Mapping[str, tuple[float, float]]
    """Smallest and largest joint positions, rad, over joints."""
    motors: Mapping[str, Motor]
    """Motors of the `hip`, `thigh` and `calf` joints."""
    foot_radius: float
    """Radius of the feet, m."""
    mjcf: Path | None = None
    """File of the robot alone, in renet's names (see `model.load_robot_model`). The runtime also
    reads the lengths of the legs from it, without MuJoCo."""
    spec: Callable[[], Any] | None = None
    """Function that returns the robot alone as a new `mujoco.MjSpec`, in place of the file."""
    camera: MountCfg = field(default_factory=MountCfg)
    """Mount of the depth camera on the trunk."""
    stiffness: float = 40.0
    """Kp of every joint, N m/rad."""
    damping: float = 1.0
    """Kd of every joint, N m s/rad."""
    action_scale: float = 0.25
    """Change of a joint target per policy unit, rad."""
    map_height: float = MAP_HEIGHT
    """Height of the base above flat ground at which the height map is zero, m."""
    max_stiffness: float = 100.0
    """Largest Kp that drivers send, N m/rad; published policies of the Go1 use 20 to 40."""
    max_damping: float = 10.0
    """Largest Kd that drivers send, N m s/rad; they use 0.5 to 1."""

    def __post_init__(self) -> None:
        if self.mjcf is None and self.spec is None:
            raise RenetError(f"the robot {self.name} has no model: give its `mjcf` or its `spec`")
        if set(self.motors) != set(KINDS):
            expected = ", ".join(KINDS)
            raise RenetError(f"motors must be of {expected}, not {', '.join(self.motors)}")
        self._check_numbers()
        for joint, low, middle, high in zip(
            JOINTS, self.lower, self.default_position, self.upper, strict=True
        ):
            # False for NaN, too.
            if not low < high or not low <= middle <= high:
                raise RenetError(
                    f"the pose of {joint} is {middle:g} rad, which must be within its limits, "
                    f"{low:g} to {high:g} rad"
                )

    def _check_numbers(self) -> None:
        """Raise RenetError for a number that must be positive and is not."""
        for name in ("height", "foot_radius", "stiffness", "action_scale"):
            _demand_positive(f"the {name} of the robot {self.name}", getattr(self, name))
        for kind, motor in self.motors.items():
            _demand_positive(f"the torque of the {kind} motors", motor.torque)
            _demand_positive(f"the velocity of the {kind} motors", motor.velocity)

    def motor(self, joint: str) -> Motor:
        """Return the motor of a joint of `interface.JOINTS`."""
        return self.motors[joint_kind(joint)]

    @cached_property
    def default_position(self) -> np.ndarray:
        """Joint positions of the pose, [12] rad."""
        return np.array(_joint_values("pose", self.pose))

    @cached_property
    def lower(self) -> np.ndarray:
        """Smallest joint positions, [12] rad."""
        return np.array([low for low, _ in _joint_values("limits", self.limits)])

    @cached_property
    def upper(self) -> np.ndarray:
        """Largest joint positions, [12] rad."""
        return np.array([high for _, high in _joint_values("limits", self.limits)])

    @cached_property
    def torque(self) -> np.ndarray:
        """Largest torques, [12] N m."""
        return np.array([self.motor(joint).torque for joint in JOINTS])

    @cached_property
    def velocity(self) -> np.ndarray:
        """Largest joint velocities, [12] rad/s."""
        return np.array([self.motor(joint).velocity for joint in JOINTS])


def _demand_positive(name: str, value: float) -> None:
    """Raise RenetError unless a value is above zero; NaN is not."""
    if not value > 0.0:
        raise RenetError(f"{name} must be above 0, got {value:g}")


def _joint_values(name: str, values: Mapping[str, _T]) -> list[_T]:
    """List the value of each joint; raises RenetError unless each has exactly one."""
    found = []
    for joint in JOINTS:
        # A joint that two patterns match would depend on their order.
        matches = [value for pattern, value in values.items() if re.fullmatch(pattern, joint)]
        if len(matches) != 1:
            raise RenetError(f"{name} must have one value for {joint}, it has {len(matches)}")
        found.append(matches[0])
    return found


_ROBOTS: dict[str, Robot] = {}
"""Robots that can be simulated and driven, by name."""


def register_robot(robot: Robot) -> Robot:
    """Make a robot known to simulators and drivers by its name, and return it.

    Raises:
        RenetError: Its gains are larger than those that its drivers send.
    """
    for name in ("stiffness", "damping"):
        gain = getattr(robot, name)
        most = getattr(robot, f"max_{name}")
        # Found now, not when a policy that was trained with it is to be deployed.
        if not gain <= most:
            raise RenetError(
                f"the {name} of the robot {robot.name} is {gain:g}, and its drivers send at most "
                f"max_{name}, {most:g}"
            )
    _ROBOTS[robot.name] = robot
    return robot


def robots() -> dict[str, Robot]:
    """Return all registered robots by name."""
    return dict(_ROBOTS)


def find_robot(name: str) -> Robot:
    """Return the robot that a bundle names; raises RenetError if there is none of that name."""
    if name not in _ROBOTS:
        raise RenetError(
            f"the bundle drives a {name}, which has no description here: there is one of "
            f"{', '.join(_ROBOTS)} (docs/robots.md says how to add one)"
        )
    return _ROBOTS[name]
