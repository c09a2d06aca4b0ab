"""Limits of a run, and joint commands within them."""

import math
from dataclasses import dataclass

import numpy as np

from renet.bundle.manifest import RobotSpec
from renet.deploy.robots.base import JointCommand, RobotState, all_finite
from renet.deploy.teleop.base import TeleopCommand, Velocity
from renet.errors import RenetError
from renet.interface import (
    CONTROL_DT,
    FALL_TILT,
    JOINT_MARGIN,
    MAX_BASE_RATE,
    MAX_JOINT_SPEED,
    MAX_REVERSE,
    MAX_SIDEWAYS,
    MAX_SPEED,
    MAX_TURN,
    TARGET_RATE,
)

_OPTIONAL = ("min_battery", "least_torque", "leg_test_seconds")
"""Limits for which 0 is allowed and switches them off."""


@dataclass(frozen=True)
class SafetyCfg:
    """Limits beyond which a robot is damped, and limits of its commands."""

    max_tilt: float = FALL_TILT
    """Largest angle between the base's z axis and up, rad."""
    max_state_age: float = 0.05
    """Oldest reading to act on, s."""
    max_gap: float = 0.1
    """Longest time between two control ticks, s."""
    max_late: int = 5
    """Late control ticks (over 1.5 periods) in a row."""
    joint_margin: float = JOINT_MARGIN
    """Margin beyond its range within which a joint may be measured, rad."""
    max_joint_speed: float = MAX_JOINT_SPEED
    """Largest speed of a joint, rad/s."""
    max_turn_rate: float = MAX_BASE_RATE
    """Largest angular velocity of the base about each axis, rad/s."""
    target_rate: float = TARGET_RATE
    """Fastest change of a joint target, rad/s."""
    first_rate: float = 10.0
    """The same at the start of a walk, rad/s; it grows to `target_rate` in `walk_in_seconds`."""
    walk_in_seconds: float = 1.0
    """Duration of the transition from standing to walking, s."""
    damping: float = 3.0
    """Braking gain in DAMPING, N m s/rad."""
    stand_up_seconds: float = 2.0
    """Duration of the motion from the pose at arming to the default pose, s."""
    leg_test_seconds: float = 0.0
    """Duration of the test before that, s, in which each leg in turn pushes against the ground: the
    base must lean away from it, or legs are wired in another order. 0: no test."""
    max_stand_up_error: float = 0.5
    """Largest error of a joint after standing up, rad. A standing Go1 sags by 0.2; one that still
    lies, or whose motors take no commands, is 0.9 away from the default pose."""

    min_battery: float = 0.2
    """Charge, 0 to 1, below which a robot does not stand up; 0 if it reports none."""
    max_temperature: float = 65.0
    """Motor temperature above which a robot does not stand up, °C."""
    least_torque: float = 0.12
    """Least share of the torque asked for that a walking robot's motor must give, 0 to 1. Ideal
    motors give all of it; a network of a real Go1's motors, which answer late, at least 0.29 in
    160 s of walks with pushes. 0 for a robot that is not to follow, as in a dry run."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            # The smallest positive number, so that 0 is refused.
            least = 0.0 if name in _OPTIONAL else math.ulp(0.0)
            if not least <= value < math.inf:
                raise RenetError(f"the safety limit {name} must be positive, got {value}")
        # Degrees in place of radians.
        if self.max_tilt > math.pi:
            raise RenetError(f"the safety limit max_tilt is in rad, got {self.max_tilt}")


def rate_after(walked: float, cfg: SafetyCfg) -> float:
    """Return the fastest change of a joint target, rad/s, `walked` seconds into a walk."""
    share = min(max(walked / cfg.walk_in_seconds, 0.0), 1.0)
    first = min(cfg.first_rate, cfg.target_rate)
    return first + share * (cfg.target_rate - first)


def limited_velocity(teleop: TeleopCommand) -> Velocity:
    """Return the velocity that the operator asks for, clipped to the ranges of training."""
    return Velocity(
        min(max(float(teleop.forward), -MAX_REVERSE), MAX_SPEED),
        min(max(float(teleop.left), -MAX_SIDEWAYS), MAX_SIDEWAYS),
        min(max(float(teleop.turn_rate), -MAX_TURN), MAX_TURN),
    )


def limited_command(
    target: np.ndarray, previous: np.ndarray, state: RobotState, robot: RobotSpec, rate: float
) -> JointCommand:
    """Return the servo command for a joint target, [12] rad, within all limits.

    It changes from the previous target, [12] rad, by at most `rate`, rad/s, and stays within the
    joints' ranges. Where the servo would ask for more torque than the motor gives, its gains are
    scaled down, which at this instant equals the saturation of training. Between two commands only
    the motor's own limit holds.

    Raises:
        RenetError: The target is not finite.
    """
    if not all_finite(target):
        raise RenetError("the joint target is not finite")
    limit = robot.arrays
    # Rate first, range second: the range holds even where the previous target left it.
    reach = rate * CONTROL_DT
    target = np.clip(target, previous - reach, previous + reach)
    target = np.clip(target, limit["lower"], limit["upper"])
    # Torque that the servo would ask for, and the gains that keep it within the motor's limit.
    stiffness = limit["stiffness"]
    damping = limit["damping"]
    torque = stiffness * (target - state.joint_position) - damping * state.joint_velocity
    scale = limit["torque_limit"] / np.maximum(np.abs(torque), limit["torque_limit"])
    return JointCommand(target, scale * stiffness, scale * damping)
