"""Checks before a robot may move: each returns the reason against it, or an empty string."""

import math

import numpy as np

from renet.bundle.manifest import RobotSpec
from renet.deploy.cameras.base import DepthFrame
from renet.deploy.robots.base import VECTORS, RobotState, all_finite, projected_gravity
from renet.deploy.safety.limits import SafetyCfg
from renet.deploy.teleop.base import TeleopCommand
from renet.errors import RenetError

EMPTY = 0.05
"""Charge, 0 to 1, below which a robot lies down while it still can."""
OVERHEATED = 20.0
"""°C above `max_temperature` at which a robot lies down before its motors fail."""
MAX_FRAME_AGE = 0.5
"""Age of the newest image, s, above which a robot with a camera does not stand up."""
_MAX_AHEAD = 0.01
"""Time, s, by which a reading may lie ahead of the clock, which is read at another moment."""


def clean_state(raw: RobotState, now: float) -> RobotState:
    """Copy a reading as float arrays; raises RenetError with the name of a value that is wrong."""
    arrays = {}
    for name, size in VECTORS.items():
        try:
            # A copy: drivers reuse their buffers.
            value = np.array(getattr(raw, name), float)
        except (TypeError, ValueError) as error:
            raise RenetError(f"{name} is not made of numbers") from error
        if value.shape != (size,):
            raise RenetError(f"{name} has shape {value.shape}, expected ({size},)")
        if not all_finite(value):
            raise RenetError(f"{name} is not finite")
        arrays[name] = value
    if not math.isfinite(raw.time):
        raise RenetError("the state's time is not finite")
    if raw.time > now + _MAX_AHEAD:
        raise RenetError("the state's time lies in the future")
    if abs(math.hypot(*arrays["quaternion"].tolist()) - 1.0) > 0.1:
        raise RenetError("the quaternion's length is not 1")
    return RobotState(float(raw.time), **arrays)


def state_problem(state: RobotState, robot: RobotSpec, cfg: SafetyCfg, now: float) -> str:
    """Return why a clean reading forbids motion; empty if it does not."""
    # After the clock jumped back the age is negative.
    if abs(now - state.time) > cfg.max_state_age:
        return f"the state is {1000 * (now - state.time):.0f} ms old"
    if projected_gravity(state.quaternion)[2] > -math.cos(cfg.max_tilt):
        return f"tilted by more than {math.degrees(cfg.max_tilt):.0f} degrees"
    margin = cfg.joint_margin
    angles = state.joint_position.tolist()
    for joint, angle, low, high in zip(robot.joints, angles, robot.lower, robot.upper, strict=True):
        if not low - margin <= angle <= high + margin:
            return f"{joint} is out of its range"
    for joint, speed in zip(robot.joints, state.joint_velocity.tolist(), strict=True):
        if abs(speed) > cfg.max_joint_speed:
            return f"{joint} is too fast"
    if max(map(abs, state.angular_velocity.tolist())) > cfg.max_turn_rate:
        return "the base turns too fast"
    return ""


def stand_up_problem(state: RobotState, robot: RobotSpec, cfg: SafetyCfg) -> str:
    """Return why a robot that stood up must not walk; empty if its joints followed."""
    error = np.abs(state.joint_position - np.asarray(robot.default_position))
    worst = int(np.argmax(error))
    if error[worst] <= cfg.max_stand_up_error:
        return ""
    return f"{robot.joints[worst]} did not follow: {error[worst]:.2f} rad are missing"


def teleop_problem(teleop: TeleopCommand) -> str:
    """Return why the operator's command forbids motion; empty if it does not."""
    if teleop.stop:
        return "operator stop"
    if not all(map(math.isfinite, (teleop.forward, teleop.left, teleop.turn_rate))):
        return "the operator's command is not finite"
    return ""


def pre_arm_problem(
    state: RobotState | None,
    teleop: TeleopCommand,
    frame: DepthFrame | None,
    camera: bool,
    recorder: str,
    cfg: SafetyCfg,
    now: float,
) -> str:
    """Return why the devices forbid standing up; empty if they do not.

    The checks that the controller makes at every tick (joints within range, tilt, age of the
    reading) are not repeated here.

    Args:
        state: Newest reading of the robot.
        teleop: The operator's command.
        frame: Newest depth frame.
        camera: True if the run has a camera.
        recorder: Problem of the recorder; empty if it has none.
        cfg: Limits of the run.
        now: Time on the robot's clock, s.
    """
    # A stick that is already held would start the walk at once.
    for name, unit in (("forward", "m/s"), ("left", "m/s"), ("turn_rate", "rad/s")):
        asked = getattr(teleop, name, 0.0)
        if asked != 0.0:
            return f"the operator already asks for {asked:.2f} {unit}: let go of the stick first"
    if problem := battery_problem(state, cfg.min_battery):
        return problem
    if problem := temperature_problem(state, cfg.max_temperature):
        return problem
    if fault := getattr(state, "fault", ""):
        return fault
    if recorder:
        return recorder
    if camera and frame is None:
        return "the camera has sent no image: check it, or start without one (--camera none)"
    if camera and not now - getattr(frame, "time", -math.inf) < MAX_FRAME_AGE:
        return f"the camera's newest image is older than {MAX_FRAME_AGE:g} s"
    return ""


def battery_problem(state: RobotState | None, least: float) -> str:
    """Name the battery if its charge, 0 to 1, is below a limit; empty if it is not."""
    if getattr(state, "battery", math.nan) < least:
        return f"the battery has less than {least:.0%} left"
    return ""


def temperature_problem(state: RobotState | None, most: float) -> str:
    """Say that a motor is above a temperature, °C; empty if none is."""
    if np.any(np.greater(getattr(state, "temperature", math.nan), most)):
        return f"a motor has more than {most:.0f} °C"
    return ""
