"""Displays of control steps in the terminal: the status of a walk, and a dry run's commands."""

import math
from collections.abc import Callable

import numpy as np

from renet.deploy.controller import Decision
from renet.deploy.robots.base import JointCommand, RobotState
from renet.deploy.safety.machine import Mode
from renet.deploy.teleop.base import Velocity
from renet.interface import CONTROL_DT, JOINTS
from renet.selector.selector import BLIND, REMEMBERS, SEES

SHOW_EVERY = 10
"""Number of control steps from one line to the next, 0.2 s."""
PRINT_EVERY = 25
"""Number of control steps from one printed command of a dry run to the next, 0.5 s."""
_SMOOTHING = 0.5
"""Time constant of the low-pass filter of the robot's velocity, s; a gait swings faster."""


class CommandDisplay:
    """Lines with what a dry run would command."""

    def __init__(self, say: Callable[[str], None]) -> None:
        """Print lines by calling `say`."""
        self._say = say
        self._steps = 0
        self._said = ""

    def step(self, command: JointCommand) -> None:
        """Count a control step, and print every 25th command, if it is another than before."""
        if self._steps % PRINT_EVERY == 0:
            line = _command_text(command)
            if line != self._said:
                self._say(line)
            self._said = line
        self._steps += 1


class VelocityDisplay:
    """Line of status: sight, the velocity that the policy is to follow, and the robot's own."""

    def __init__(self, show: Callable[[str], None]) -> None:
        """Show lines by calling `show`."""
        self._show = show
        self._walked = np.zeros(3)
        self._steps = 0

    def step(self, decision: Decision, state: RobotState | None) -> None:
        """Update with one control step's decision and the reading before it."""
        walking = decision.mode is Mode.WALKING
        self._walked = self._smoothed(decision, state) if walking else np.zeros(3)
        if self._steps % SHOW_EVERY == 0:
            self._show(self._line(decision) if walking else str(decision.mode))
        self._steps += 1

    def _smoothed(self, decision: Decision, state: RobotState | None) -> np.ndarray:
        """Filter velocity [3]: that of the estimator that drives, and the gyroscope's turn rate."""
        estimate = decision.velocity_vp if decision.vision else decision.velocity_op
        turn_rate = self._walked[2] if state is None else state.angular_velocity[2]
        newest = np.array([estimate[0], estimate[1], turn_rate], float)
        # First-order low-pass filter.
        share = 1.0 - math.exp(-CONTROL_DT / _SMOOTHING)
        smoothed = self._walked + share * (newest - self._walked)
        return np.where(np.isfinite(smoothed), smoothed, 0.0)

    def _line(self, decision: Decision) -> str:
        walked = Velocity(*self._walked.tolist())
        return f"{_state(decision)}; told {_text(decision.followed)}; walks {_text(walked)}"


def _command_text(command: JointCommand) -> str:
    """Write the target, rad, and Kp of each joint."""
    parts = []
    for name, position, stiffness in zip(JOINTS, command.position, command.stiffness, strict=True):
        parts.append(f"{name.removesuffix('_joint')} {position:+.2f} (Kp {stiffness:.0f})")
    return "  ".join(parts)


def _state(decision: Decision) -> str:
    """Name the state of the selector in which a step was walked."""
    if not decision.vision:
        return BLIND
    return SEES if decision.has_image else REMEMBERS


def _text(velocity: Velocity) -> str:
    forward, left, turn_rate = velocity
    return f"{forward:+.2f} ahead {left:+.2f} left m/s {turn_rate:+.2f} rad/s"
