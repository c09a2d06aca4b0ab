"""Comparison of the torque that each motor gives with the torque that was asked of it."""

import numpy as np

from renet.deploy.robots.base import JointCommand, RobotState
from renet.interface import JOINTS

SHORT_WINDOW = 15
"""Number of readings, 0.3 s, over which motors that give next to nothing, or too much, are found.
"""
LONG_WINDOW = 50
"""Number of readings, 1 s, over which motors that give too little are found."""
_WEAK_RATIO = 3.0
"""Multiple of the least share of the torque asked for, below which a motor is weak over the long
window. There a network of a real Go1's motors gave a share of at least 0.53 in 300 s of walks with
pushes on all terrains, and ideal motors gave all of it."""
_MIN_ASKED = 3.0
"""Root mean square of the torque asked for, N m, from which a motor can be judged."""
_MAX_ERROR = 18.0
"""Largest root mean square, N m, of the difference between the torques given and asked for: at most
11 in 160 s of walks with pushes on a network of a real Go1's motors, which answer late; none on
ideal ones."""
_MAX_COUNTED = 30.0
"""Largest torque, N m, with which one reading counts: a single odd one must not be enough."""
_ABSURD_RATIO = 3.0
"""Multiple of a motor's limit that no motor can give."""
ABSURD_READINGS = 3
"""Number of readings in a row with more than that, which are no transmission error."""


class MotorWatch:
    """Compares commands with the torques in the readings that follow them.

    Nothing is compared before the first torque that is not zero: a robot that measures no torque
    always reports zero.
    """

    def __init__(self, torque: np.ndarray, speed: np.ndarray, least: float) -> None:
        """Watch the motors of one robot.

        Args:
            torque: Limits of the motors, [12] N m.
            speed: Speeds beyond which a driver only brakes a joint, [12] rad/s.
            least: Least share of the torque asked for that each motor must give, 0 to 1.
        """
        self._least = least
        self._torque = torque
        self._speed = speed
        self.start_over()

    def start_over(self) -> None:
        """Forget the past, in which the robot did something else."""
        self._window = np.zeros((LONG_WINDOW, 4, len(JOINTS)))
        """Torques of each of the last readings, N² m²: square of the torque asked for, square of
        the torque given, product of both (negative if the motor works against its command), and
        square of their difference. The newest row is `_next - 1`."""
        self._next = 0
        self._absurd = 0
        """Number of readings in a row with a torque that no motor gives."""
        self._command: JointCommand | None = None
        self._measured = False
        self._fast = np.zeros(len(JOINTS), bool)
        """True for joints that were beyond their speed limit at the last reading, [12]."""

    def told(self, command: JointCommand) -> None:
        """Keep a command, whose effect the next reading shows."""
        self._command = command

    def problem(self, state: RobotState) -> str:
        """Name a motor that does not follow its commands; empty if all do."""
        command = self._command
        given = state.joint_torque
        self._measured = self._measured or bool(given.any())
        if command is None or not self._measured:
            return ""
        # A torque that no motor gives is an error of the sensor or of the transmission.
        absurd = np.flatnonzero(np.abs(given) > _ABSURD_RATIO * self._torque)
        self._absurd = self._absurd + 1 if len(absurd) else 0
        if self._absurd >= ABSURD_READINGS:
            joint = absurd[0]
            return f"{JOINTS[joint]} says {given[joint]:.3g} N m, which no motor of it gives"
        self._remember(command, state)
        return self._compare()

    def _remember(self, command: JointCommand, state: RobotState) -> None:
        """Add the torques of a reading to the window; zeros for joints beyond their speed limit."""
        given = state.joint_torque
        asked = command.stiffness * (command.position - state.joint_position)
        asked = asked - command.damping * state.joint_velocity
        asked = np.clip(asked, -self._torque, self._torque)
        # Beyond its speed limit a joint is braked, whatever was asked for then or since.
        now = np.abs(state.joint_velocity) > 0.9 * self._speed
        fast = now | self._fast
        self._fast = now
        apart = np.minimum(np.abs(given - asked), _MAX_COUNTED)
        given = np.clip(given, -_MAX_COUNTED, _MAX_COUNTED)
        row = np.stack((asked**2, given**2, given * asked, apart**2))
        self._window[self._next % LONG_WINDOW] = np.where(fast, 0.0, row)
        self._next += 1

    def _compare(self) -> str:
        """Name a motor that did not give the torques asked for in a window; empty if none."""
        if self._next < SHORT_WINDOW:
            return ""
        # The short window: a motor that gives no torque, or another one.
        soon = np.arange(self._next - SHORT_WINDOW, self._next) % LONG_WINDOW
        asked, given, _, apart = self._window[soon].mean(axis=0)
        dead = (asked > _MIN_ASKED**2) & (given < self._least**2 * asked)
        if dead.any():
            return f"{JOINTS[int(dead.argmax())]} does not obey: its motor gives no torque"
        if (apart > _MAX_ERROR**2).any():
            joint = int(apart.argmax())
            return f"{JOINTS[joint]} does not obey: it gives another torque than asked for"
        if self._next < LONG_WINDOW:
            return ""
        # The long window: a motor that gives a part of the torque.
        asked, _, obeyed, _ = self._window.mean(axis=0)
        share = _WEAK_RATIO * self._least
        weak = (asked > _MIN_ASKED**2) & (obeyed < share * asked)
        if weak.any():
            return f"{JOINTS[int(weak.argmax())]} is too weak: its motor gives little torque"
        return ""
