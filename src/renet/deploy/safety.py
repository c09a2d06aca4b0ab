"""The safety layer: when a robot may move, and how far one command may go.

    DAMPING --arm, nothing wrong--> STANDING_UP --joints followed--> WALKING
       ^                                 |                             |
       +------ any problem, or stop -----+-----------------------------+

DAMPING is the start and the end: joints are only braked, and it stays until the operator arms
again. Losing vision is no problem here: the selector falls back to OP within WALKING.
"""

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from renet.bundle.manifest import RobotSpec
from renet.deploy.cameras.base import DepthFrame
from renet.deploy.robots.base import VECTORS, JointCommand, RobotState, projected_gravity
from renet.deploy.teleop import TeleopCommand
from renet.errors import RenetError
from renet.interface import ACTION_SIZE, CONTROL_DT, MAX_SPEED


class Mode(StrEnum):
    """States of the safety machine."""

    DAMPING = "damping"
    STANDING_UP = "standing_up"
    WALKING = "walking"


@dataclass(frozen=True)
class SafetyCfg:
    """Limits beyond which a robot is damped, and limits of what it is told."""

    max_tilt: float = math.radians(70.0)
    """Largest angle between the base's z axis and up, rad."""
    max_state_age: float = 0.05
    """Oldest reading to act on, s."""
    max_gap: float = 0.1
    """Longest time between two control ticks, s."""
    max_late: int = 5
    """Late control ticks (over 1.5 periods) in a row."""
    joint_margin: float = 0.2
    """How far beyond its range a joint may be measured, rad."""
    max_joint_speed: float = 60.0
    """rad/s; twice what a Go1's motors reach: a sensor that reads more is wrong."""
    max_turn_rate: float = 30.0
    """Base angular velocity, rad/s, per axis."""
    target_rate: float = 40.0
    """Fastest change of a joint target, rad/s."""
    damping: float = 3.0
    """Braking gain in DAMPING, N m s/rad."""
    stand_up_seconds: float = 2.0
    """Time from the pose at arming to the default pose."""
    max_stand_up_error: float = 0.5
    """Farthest that a joint may be from the default pose after standing up, rad. A standing Go1
    sags by 0.2; one that still lies, or whose motors obey nobody, is 0.9 away."""

    min_battery: float = 0.2
    """Charge, 0 to 1, below which a robot does not stand up; 0 for a robot that reports none."""
    max_temperature: float = 65.0
    """Motor temperature above which a robot does not stand up, °C."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            least = 0.0 if name == "min_battery" else math.ulp(0.0)
            if not least <= value < math.inf:
                raise RenetError(f"the safety limit {name} must be positive, got {value}")
        if self.max_tilt > math.pi:
            raise RenetError(f"the safety limit max_tilt is in rad, got {self.max_tilt}")


EMPTY = 0.05
"""Charge below which a robot lies down while it still can."""
OVERHEATED = 20.0
"""°C above `max_temperature` at which a robot lies down before its motors fail."""
MAX_FRAME_AGE = 0.5
"""Age in seconds of the newest image above which a robot with a camera does not stand up."""
FUTURE = 0.01
"""Seconds by which a reading may seem to come from the future: clocks are read one by one."""


def clean_state(raw: RobotState, now: float) -> RobotState:
    """A reading as float arrays of its own; raises RenetError naming what cannot be one."""
    arrays = {}
    for name, size in VECTORS.items():
        try:
            value = np.array(getattr(raw, name), float)  # Drivers reuse their buffers.
        except (TypeError, ValueError) as error:
            raise RenetError(f"{name} is not made of numbers") from error
        if value.shape != (size,):
            raise RenetError(f"{name} has shape {value.shape}, expected ({size},)")
        if not all_finite(value):
            raise RenetError(f"{name} is not finite")
        arrays[name] = value
    if not math.isfinite(raw.time):
        raise RenetError("the state's time is not finite")
    if raw.time > now + FUTURE:
        raise RenetError("the state's time lies in the future")
    if abs(math.hypot(*arrays["quaternion"]) - 1.0) > 0.1:
        raise RenetError("the quaternion's length is not 1")
    return RobotState(float(raw.time), **arrays)


def all_finite(values: np.ndarray) -> bool:
    """Whether a few numbers are finite: for a dozen this is three times as fast as NumPy."""
    return all(map(math.isfinite, values.tolist()))


def state_problem(state: RobotState, robot: RobotSpec, cfg: SafetyCfg, now: float) -> str:
    """Why a clean reading forbids motion; empty if it does not."""
    if abs(now - state.time) > cfg.max_state_age:  # After a clock's jump back it is negative.
        return f"the state is {1000 * (now - state.time):.0f} ms old"
    if projected_gravity(state.quaternion)[2] > -math.cos(cfg.max_tilt):
        return f"tilted by more than {math.degrees(cfg.max_tilt):.0f} degrees"
    margin, angles = cfg.joint_margin, state.joint_position.tolist()
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
    """Why a robot that was told to stand up must not walk; empty if its joints followed."""
    error = np.abs(state.joint_position - np.asarray(robot.default_position))
    worst = int(np.argmax(error))
    if error[worst] <= cfg.max_stand_up_error:
        return ""
    return f"{robot.joints[worst]} did not follow: {error[worst]:.2f} rad are missing"


def teleop_problem(teleop: TeleopCommand) -> str:
    """Why an operator's teleop forbids motion; empty if it does not."""
    if teleop.stop:
        return "operator stop"
    if not (math.isfinite(teleop.speed) and math.isfinite(teleop.turn)):
        return "the operator's command is not finite"
    return ""


def limited_speed(speed: float) -> float:
    """An operator's speed within training's."""
    return min(max(float(speed), 0.0), MAX_SPEED)


def pre_arm_problem(
    state: RobotState | None,
    teleop: TeleopCommand,
    frame: DepthFrame | None,
    camera: bool,
    recorder: str,
    cfg: SafetyCfg,
    now: float,
) -> str:
    """Why the devices forbid standing up; empty if they do not.

    What the controller itself checks at every tick (joints within range, tilt, age of the
    reading) is not repeated here.

    Args:
        state: newest reading. teleop: the operator's command. frame: newest of the camera.
        camera: whether there is one. recorder: its problem. cfg: limits of battery and motors.
        now: seconds on the robot's clock.
    """
    speed = getattr(teleop, "speed", 0.0)
    if speed != 0.0:
        return f"the operator already asks for {speed:.2f} m/s: let go of the stick first"
    if problem := power_problem(state, cfg.min_battery, cfg.max_temperature):
        return problem
    if recorder:
        return recorder
    if camera and frame is None:
        return "the camera has sent no image: check it, or start without one (--camera none)"
    if camera and not now - getattr(frame, "time", -math.inf) < MAX_FRAME_AGE:
        return f"the camera's newest image is older than {MAX_FRAME_AGE:g} s"
    return ""


def power_problem(state: RobotState | None, battery: float, temperature: float) -> str:
    """Name the battery below a charge or the motor above a temperature in °C; empty if neither."""
    if getattr(state, "battery", math.nan) < battery:
        return f"the battery has less than {battery:.0%} left"
    if getattr(state, "temperature", math.nan) > temperature:
        return f"a motor has more than {temperature:.0f} °C"
    return ""


class SafetyMachine:
    """Decides the mode, tick by tick."""

    def __init__(self, cfg: SafetyCfg) -> None:
        self.cfg = cfg
        self.mode = Mode.DAMPING
        self.reason = "start"
        """Why the mode was entered."""
        self.refused = ""
        """Why the last tick's wish to stand up was not granted; empty if there was none."""
        self.since = -math.inf
        """Time at which the mode was entered, s on the robot's clock."""
        self._last: float | None = None
        self._late = 0
        self._armed = False

    def update(self, problem: str, teleop: TeleopCommand, now: float) -> Mode:
        """One control tick with the first problem found, or an empty text."""
        problem = self._clock_problem(now) or problem
        arm, self._armed = teleop.arm and not self._armed, teleop.arm
        self.refused = problem if arm and self.mode is Mode.DAMPING else ""
        if problem:
            self.trip(problem, now)
        elif self.mode is Mode.DAMPING and arm:
            self._enter(Mode.STANDING_UP, "armed", now)
        elif self.stood_up(now):
            self._enter(Mode.WALKING, "stood up", now)
        return self.mode

    def stood_up(self, now: float) -> bool:
        """Whether the time to stand up is over: the robot walks or must be damped."""
        return self.mode is Mode.STANDING_UP and now - self.since >= self.cfg.stand_up_seconds

    def trip(self, reason: str, now: float) -> None:
        """Go to DAMPING; the first reason is kept until the operator arms again."""
        if self.mode is not Mode.DAMPING:
            self._enter(Mode.DAMPING, reason, now)

    def _enter(self, mode: Mode, reason: str, now: float) -> None:
        self.mode, self.reason, self.since = mode, reason, now
        self._late = 0

    def _clock_problem(self, now: float) -> str:
        """Missed deadlines, or a clock that cannot be right."""
        if not math.isfinite(now):
            return "the clock is not finite"
        last, self._last = self._last, now
        if last is None:
            return ""
        if now <= last:
            return "the clock went backwards" if now < last else "the clock stands"
        if now - last > self.cfg.max_gap:
            return f"no control tick for {1000 * (now - last):.0f} ms"
        self._late = self._late + 1 if now - last > 1.5 * CONTROL_DT else 0
        return f"{self._late} late control ticks in a row" if self._late > self.cfg.max_late else ""


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
