"""State machine of a run: when a robot may move, how it brakes, and how it stands up.

    DAMPING --arm, nothing wrong--> STANDING_UP --joints followed--> WALKING
       ^                                 |                             |
       +------ any problem, or stop -----+-----------------------------+

A run starts and ends in DAMPING, in which joints are only braked, and stays there until the
operator arms again. A loss of vision is no problem here: the selector falls back to OP within
WALKING.
"""

import math
from enum import StrEnum

import numpy as np

from renet.bundle.manifest import RobotSpec
from renet.deploy.robots.base import JointCommand
from renet.deploy.safety.limits import SafetyCfg
from renet.deploy.teleop.base import TeleopCommand
from renet.interface import ACTION_SIZE, CONTROL_DT

REFUSED = "the robot takes no commands"
"""Reason for damping a robot whose driver fails."""
EXHAUSTED = "the robot lies down"
"""Reason for damping a robot whose battery is empty or whose motors are too hot."""
ENDED = "the run ends"
"""Reason for damping at the end of a run."""


class Mode(StrEnum):
    """States of the safety machine."""

    DAMPING = "damping"
    STANDING_UP = "standing_up"
    WALKING = "walking"


class SafetyMachine:
    """Decides the mode at every control tick."""

    def __init__(self, cfg: SafetyCfg) -> None:
        self.cfg = cfg
        self.mode = Mode.DAMPING
        self.reason = "start"
        """Reason for the mode."""
        self.refused = ""
        """Reason why the last tick's request to stand up was refused; empty if there was none."""
        self.since = -math.inf
        """Time at which the mode was entered, s on the robot's clock."""
        self._last: float | None = None
        self._late = 0
        """Number of late control ticks in a row."""
        self._armed = False

    def update(self, problem: str, teleop: TeleopCommand, now: float) -> Mode:
        """Advance by one control tick.

        Args:
            problem: First problem found at this tick; empty if there is none.
            teleop: The operator's command.
            now: Time on the robot's clock, s.

        Returns:
            The mode in which this tick is commanded.
        """
        problem = self._clock_problem(now) or problem
        # A button that is held arms once.
        arm = teleop.arm and not self._armed
        self._armed = teleop.arm
        self.refused = problem if arm and self.mode is Mode.DAMPING else ""
        if problem:
            self.trip(problem, now)
        elif self.mode is Mode.DAMPING and arm:
            self._enter(Mode.STANDING_UP, "armed", now)
        elif self.stood_up(now):
            self._enter(Mode.WALKING, "stood up", now)
        return self.mode

    def stood_up(self, now: float) -> bool:
        """True once the time to stand up is over: the robot walks or must be damped."""
        return self.mode is Mode.STANDING_UP and now - self.since >= self.rising

    @property
    def rising(self) -> float:
        """Time from arming to the end of standing up, s."""
        return self.cfg.leg_test_seconds + self.cfg.stand_up_seconds

    def trip(self, reason: str, now: float) -> None:
        """Enter DAMPING; the first reason is kept until the operator arms again."""
        if self.mode is not Mode.DAMPING:
            self._enter(Mode.DAMPING, reason, now)

    def _enter(self, mode: Mode, reason: str, now: float) -> None:
        self.mode = mode
        self.reason = reason
        self.since = now
        self._late = 0

    def _clock_problem(self, now: float) -> str:
        """Return why the time of a tick forbids motion; empty if it does not.

        A deadline was missed, or the clock is wrong.
        """
        if not math.isfinite(now):
            return "the clock is not finite"
        last = self._last
        self._last = now
        if last is None:
            return ""
        if now <= last:
            return "the clock went backwards" if now < last else "the clock stands"
        if now - last > self.cfg.max_gap:
            return f"no control tick for {1000 * (now - last):.0f} ms"
        # One late tick does no harm; a row of them is a computer that is too slow.
        self._late = self._late + 1 if now - last > 1.5 * CONTROL_DT else 0
        return f"{self._late} late control ticks in a row" if self._late > self.cfg.max_late else ""


def damping_command(robot: RobotSpec, cfg: SafetyCfg) -> JointCommand:
    """Return the command that only brakes the joints; it needs no reading."""
    brake = np.full(ACTION_SIZE, cfg.damping)
    return JointCommand(np.asarray(robot.default_position), np.zeros(ACTION_SIZE), brake)


def stand_up_target(start: np.ndarray, robot: RobotSpec, share: float) -> np.ndarray:
    """Return joint positions [12], rad, at a share, 0 to 1, of the way to the default pose."""
    return start + smooth_step(share) * (np.asarray(robot.default_position) - start)


def smooth_step(share: float) -> float:
    """Return the cubic from 0 at 0 to 1 at 1 whose slope is zero at both; constant beyond them."""
    share = min(max(share, 0.0), 1.0)
    return share * share * (3.0 - 2.0 * share)
