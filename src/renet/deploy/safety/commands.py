"""Joint commands within the limits: braking, standing up, and the policy's."""

import numpy as np

from renet.bundle.manifest import RobotSpec
from renet.deploy.robots.base import JointCommand, RobotState
from renet.deploy.safety.checks import all_finite
from renet.deploy.safety.limits import SafetyCfg
from renet.errors import RenetError
from renet.interface import ACTION_SIZE, CONTROL_DT, MAX_SPEED


def limited_speed(speed: float) -> float:
    """An operator's speed within training's."""
    return min(max(float(speed), 0.0), MAX_SPEED)


def damping_command(robot: RobotSpec, cfg: SafetyCfg) -> JointCommand:
    """Brake only; needs no reading."""
    brake = np.full(ACTION_SIZE, cfg.damping)
    return JointCommand(np.asarray(robot.default_position), np.zeros(ACTION_SIZE), brake)


def stand_up_target(start: np.ndarray, robot: RobotSpec, share: float) -> np.ndarray:
    """Joint positions [12] between the pose at arming and the default pose, smooth at both ends."""
    share = min(max(share, 0.0), 1.0)
    smooth = share * share * (3.0 - 2.0 * share)
    return start + smooth * (np.asarray(robot.default_position) - start)


def limited_command(
    target: np.ndarray, previous: np.ndarray, state: RobotState, robot: RobotSpec, cfg: SafetyCfg
) -> JointCommand:
    """Servo command for a joint target [12] rad, within all limits.

    The target moves at most `target_rate` and stays in the joints' ranges. Where the servo would
    ask for more torque than the motor gives, its gains shrink: at this instant that equals the
    saturation of training. Between two commands the motor's own limit is the last.

    Raises:
        RenetError: the target is not finite.
    """
    if not all_finite(target):
        raise RenetError("the joint target is not finite")
    limit, reach = robot.arrays, cfg.target_rate * CONTROL_DT
    target = np.minimum(np.maximum(target, previous - reach), previous + reach)
    target = np.minimum(np.maximum(target, limit["lower"]), limit["upper"])
    stiffness, damping = limit["stiffness"], limit["damping"]
    torque = stiffness * (target - state.joint_position) - damping * state.joint_velocity
    scale = limit["torque_limit"] / np.maximum(np.abs(torque), limit["torque_limit"])
    return JointCommand(target, scale * stiffness, scale * damping)
