"""The limits of a run, and joint commands within them."""

import math
from dataclasses import dataclass

import numpy as np

from renet.bundle.manifest import RobotSpec
from renet.deploy.robots.base import JointCommand, RobotState, all_finite
from renet.deploy.teleop import TeleopCommand, Velocity
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

MAY_BE_ZERO = ("min_battery", "least_torque", "leg_test_seconds")
"""Limits that 0 switches off."""


@dataclass(frozen=True)
class SafetyCfg:
    """Limits beyond which a robot is damped, and limits of what it is told."""

    max_tilt: float = FALL_TILT
    """Largest angle between the base's z axis and up, rad."""
    max_state_age: float = 0.05
    """Oldest reading to act on, s."""
    max_gap: float = 0.1
    """Longest time between two control ticks, s."""
    max_late: int = 5
    """Late control ticks (over 1.5 periods) in a row."""
    joint_margin: float = JOINT_MARGIN
    """How far beyond its range a joint may be measured, rad."""
    max_joint_speed: float = MAX_JOINT_SPEED
    """rad/s"""
    max_turn_rate: float = MAX_BASE_RATE
    """Base angular velocity, rad/s, per axis."""
    target_rate: float = TARGET_RATE
    """Fastest change of a joint target, rad/s."""
    first_rate: float = 10.0
    """The same as a walk begins, rad/s; it grows to `target_rate` in `walk_in_seconds`."""
    walk_in_seconds: float = 1.0
    """Time in which a robot goes over from standing to walking."""
    damping: float = 3.0
    """Braking gain in DAMPING, N m s/rad."""
    stand_up_seconds: float = 2.0
    """Time from the pose at arming to the default pose."""
    leg_test_seconds: float = 0.0
    """Time before that in which each leg in turn pushes against the ground: the base must lean away
    from it, or legs are wired in another order. 0: no test."""
    max_stand_up_error: float = 0.5
    """Farthest that a joint may be from the default pose after standing up, rad. A standing Go1
    sags by 0.2; one that still lies, or whose motors obey nobody, is 0.9 away."""

    min_battery: float = 0.2
    """Charge, 0 to 1, below which a robot does not stand up; 0 for a robot that reports none."""
    max_temperature: float = 65.0
    """Motor temperature above which a robot does not stand up, °C."""
    least_torque: float = 0.12
    """Share of the torque asked for that a walking robot's motor must give at least, 0 to 1: ideal
    motors give all, and a network of a real Go1's, which answer late, 0.29 at least in 160 s of
    walks with pushes. 0 for a robot that is not to follow, as in a dry run."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            least = 0.0 if name in MAY_BE_ZERO else math.ulp(0.0)
            if not least <= value < math.inf:
                raise RenetError(f"the safety limit {name} must be positive, got {value}")
        if self.max_tilt > math.pi:
            raise RenetError(f"the safety limit max_tilt is in rad, got {self.max_tilt}")


def rate_after(walked: float, cfg: SafetyCfg) -> float:
    """Fastest change of a joint target, rad/s, some seconds after a walk began."""
    share = min(max(walked / cfg.walk_in_seconds, 0.0), 1.0)
    first = min(cfg.first_rate, cfg.target_rate)
    return first + share * (cfg.target_rate - first)


def limited_velocity(teleop: TeleopCommand) -> Velocity:
    """Velocity that an operator asks for, within the ranges of training."""
    return Velocity(
        min(max(float(teleop.forward), -MAX_REVERSE), MAX_SPEED),
        min(max(float(teleop.left), -MAX_SIDEWAYS), MAX_SIDEWAYS),
        min(max(float(teleop.turn_rate), -MAX_TURN), MAX_TURN),
    )


def limited_command(
    target: np.ndarray, previous: np.ndarray, state: RobotState, robot: RobotSpec, rate: float
) -> JointCommand:
    """Servo command for a joint target [12] rad within all limits; raises RenetError if not finite.

    The target moves at most at a rate, rad/s, and stays in the joints' ranges. Where the servo
    would ask for more torque than the motor gives, its gains shrink: at this instant that equals
    the saturation of training. Between two commands the motor's own limit is the last.
    """
    if not all_finite(target):
        raise RenetError("the joint target is not finite")
    limit, reach = robot.arrays, rate * CONTROL_DT
    target = np.minimum(np.maximum(target, previous - reach), previous + reach)
    target = np.minimum(np.maximum(target, limit["lower"]), limit["upper"])
    stiffness, damping = limit["stiffness"], limit["damping"]
    torque = stiffness * (target - state.joint_position) - damping * state.joint_velocity
    scale = limit["torque_limit"] / np.maximum(np.abs(torque), limit["torque_limit"])
    return JointCommand(target, scale * stiffness, scale * damping)
