"""What a robot's joints may ever be told, whatever a bundle says."""

import xml.etree.ElementTree as ET
from dataclasses import dataclass

import numpy as np

from renet.bundle.manifest import RobotSpec
from renet.deploy.robots.base import JointCommand, RobotState
from renet.descriptions import RobotDescription
from renet.errors import RenetError
from renet.interface import JOINTS


@dataclass(frozen=True)
class Envelope:
    """A robot's own limits; arrays follow `interface.JOINTS`."""

    name: str
    lower: np.ndarray
    """[12] rad"""
    upper: np.ndarray
    """[12] rad"""
    torque: np.ndarray
    """[12] N m"""
    velocity: np.ndarray
    """[12] rad/s, beyond which a joint is only braked, not driven further."""
    stiffness: float
    """Largest Kp, N m/rad."""
    damping: float
    """Largest Kd, N m s/rad."""

    def check(self, robot: RobotSpec) -> None:
        """Raise RenetError naming joint and number unless a bundle stays within these limits."""
        limits = (
            ("stiffness", "N m/rad", 0.0, self.stiffness),
            ("damping", "N m s/rad", 0.0, self.damping),
            ("torque_limit", "N m", 0.0, self.torque),
            ("lower", "rad", self.lower, np.inf),
            ("upper", "rad", -np.inf, self.upper),
            ("default_position", "rad", self.lower, self.upper),
        )
        for field, unit, least, most in limits:
            values = np.asarray(getattr(robot, field))
            outside = (values < np.asarray(least) - 1e-6) | (values > np.asarray(most) + 1e-6)
            if outside.any():
                joint = int(outside.argmax())
                low, high = (float(np.broadcast_to(end, 12)[joint]) for end in (least, most))
                raise RenetError(
                    f"the bundle asks for {field} {values[joint]:g} {unit} of {JOINTS[joint]}; "
                    f"a {self.name} takes {low:g} to {high:g}"
                )

    def clamp(self, command: JointCommand, state: RobotState | None = None) -> JointCommand:
        """The nearest command within the limits; raises RenetError unless of [12] finite numbers.

        Without a reading, the limits of torque and velocity are left to the motors.
        """
        parts = {}
        for name in ("position", "stiffness", "damping"):
            value = np.asarray(getattr(command, name), float)
            if value.shape != (len(JOINTS),) or not np.isfinite(value).all():
                raise RenetError(f"the command's {name} must be {len(JOINTS)} finite numbers")
            parts[name] = value
        position = np.clip(parts["position"], self.lower, self.upper)
        stiffness = np.clip(parts["stiffness"], 0.0, self.stiffness)
        damping = np.clip(parts["damping"], 0.0, self.damping)
        if state is not None and stiffness.any():
            torque = stiffness * (position - state.joint_position) - damping * state.joint_velocity
            share = np.minimum(1.0, self.torque / np.fmax(np.abs(torque), 1e-9))
            stiffness, damping = share * stiffness, share * damping
            speed = state.joint_velocity
            driven = (np.abs(speed) > self.velocity) & (torque * speed > 0.0)
            stiffness = np.where(driven, 0.0, stiffness)
        return JointCommand(position, stiffness, damping)


def read_envelope(robot: RobotDescription) -> Envelope:
    """A robot's limits from its description."""
    root = ET.parse(robot.mjcf).getroot()
    ranges = {j.get("name"): j.get("range", "").split() for j in root.iter("joint")}
    forces = {g.get("name"): g.get("forcerange", "").split() for g in root.iter("general")}
    lower, upper = np.array([ranges[joint] for joint in JOINTS], float).T
    torque = np.array([forces[joint][1] for joint in JOINTS], float)
    speed = np.array([robot.speeds[joint.split("_")[1]] for joint in JOINTS])
    return Envelope(robot.name, lower, upper, torque, speed, robot.stiffness, robot.damping)
