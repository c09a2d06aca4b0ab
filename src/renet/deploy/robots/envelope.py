"""Limits of a robot's joints, which no bundle and no command can widen."""

import numpy as np

from renet.bundle.manifest import RobotSpec
from renet.deploy.robots.base import JointCommand, RobotState
from renet.errors import RenetError
from renet.interface import JOINTS
from renet.robots import Robot


def demand_within(robot: Robot, policy: RobotSpec) -> None:
    """Raise RenetError with joint and number unless a bundle stays within a robot's limits."""
    limits = (
        ("stiffness", "N m/rad", 0.0, robot.max_stiffness),
        ("damping", "N m s/rad", 0.0, robot.max_damping),
        ("torque_limit", "N m", 0.0, robot.torque),
        ("lower", "rad", robot.lower, np.inf),
        ("upper", "rad", -np.inf, robot.upper),
        ("default_position", "rad", robot.lower, robot.upper),
    )
    for field, unit, least, most in limits:
        values = np.asarray(getattr(policy, field))
        # Bundles may have rounded a limit.
        outside = (values < np.asarray(least) - 1e-6) | (values > np.asarray(most) + 1e-6)
        if outside.any():
            joint = int(outside.argmax())
            low = float(np.broadcast_to(least, len(JOINTS))[joint])
            high = float(np.broadcast_to(most, len(JOINTS))[joint])
            raise RenetError(
                f"the bundle asks for {field} {values[joint]:g} {unit} of {JOINTS[joint]}; "
                f"a {robot.name} takes {low:g} to {high:g}"
            )


def clamp(robot: Robot, command: JointCommand, state: RobotState | None = None) -> JointCommand:
    """Return the nearest command within a robot's limits.

    Beyond its largest velocity a joint is only braked, not driven further. Without a reading, the
    limits of torque and velocity are left to the motors.

    Raises:
        RenetError: The command is not made of [12] finite numbers each.
    """
    parts = {}
    for name in ("position", "stiffness", "damping"):
        value = np.asarray(getattr(command, name), float)
        if value.shape != (len(JOINTS),) or not np.isfinite(value).all():
            raise RenetError(f"the command's {name} must be {len(JOINTS)} finite numbers")
        parts[name] = value
    position = np.clip(parts["position"], robot.lower, robot.upper)
    stiffness = np.clip(parts["stiffness"], 0.0, robot.max_stiffness)
    damping = np.clip(parts["damping"], 0.0, robot.max_damping)
    if state is not None and stiffness.any():
        # Both gains shrink alike until the torque is one that the motor has.
        speed = state.joint_velocity
        # A damaged reading may be infinite or huge, and its torque NaN, which scales nothing.
        with np.errstate(invalid="ignore", over="ignore"):
            torque = stiffness * (position - state.joint_position) - damping * speed
            driven = (np.abs(speed) > robot.velocity) & (torque * speed > 0.0)
        share = np.minimum(1.0, robot.torque / np.fmax(np.abs(torque), 1e-9))
        stiffness = share * stiffness
        damping = share * damping
        stiffness = np.where(driven, 0.0, stiffness)
    return JointCommand(position, stiffness, damping)
