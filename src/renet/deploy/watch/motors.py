"""Comparison of the torque that each motor gives with the torque that was asked of it."""

import numpy as np

from renet.deploy.robots.base import JointCommand, RobotState
from renet.interface import JOINTS

SHORT_WINDOW = 15
"""Readings, 0.3 s, over which motors that give next to nothing, or too much, are found."""
LONG_WINDOW = 50
"""Readings, 1 s, over which motors that give too little are found."""
_WEAK_RATIO = 3.0
"""Multiple of the least share of the torque asked for, below which a motor is weak over the long
window: there a network of a real Go1's motors gave at least 0.53 of it in 300 s of walks with
pushes on all terrains, ideal motors all of it."""
_MIN_ASKED = 3.0
"""Root mean square of the torque asked for, N m, from which a motor can be judged."""
_MAX_ERROR = 18.0
"""Largest root mean square, N m, of the difference between the torques given and asked for: at most
11 in 160 s of walks with pushes on a network of a real Go1's motors, which answer late; none on
ideal ones."""
_MAX_COUNTED = 30.0
"""Most torque, N m, that one reading counts for: a single odd one must not be enough."""
_ABSURD_RATIO = 3.0
"""Multiple of a motor's limit that it cannot give."""
ABSURD_READINGS = 3
"""Readings in a row with such a torque that are no transmission error."""


class MotorWatch:
    """Compares commands with the torques in the readings that follow them.

    Robots that measure no torque always report zero for all joints: nothing is compared then.
    """

    def __init__(self, torque: np.ndarray, speed: np.ndarray, least: float) -> None:
        """Watch the motors of one robot.

        Args:
            torque: [12] N m, limits of the motors.
            speed: [12] rad/s, beyond which a driver only brakes a joint.
            least: share of the torque asked for that each motor must give.
        """
        self._least = least
        self._torque = torque
        self._speed = speed
        self.start_over()

    def start_over(self) -> None:
        """Forget the past, in which the robot did something else."""
        self._asked = np.zeros((LONG_WINDOW, len(JOINTS)))
        self._given = np.zeros((LONG_WINDOW, len(JOINTS)))
        self._obeyed = np.zeros((LONG_WINDOW, len(JOINTS)))
        """Products of both: a torque against the one asked for counts less than none."""
        self._apart = np.zeros((LONG_WINDOW, len(JOINTS)))
        """Squares of differences, N² m². The newest row of all four is `_next - 1`."""
        self._next = 0
        self._absurd = 0
        """Readings in a row with a torque that no motor gives."""
        self._command: JointCommand | None = None
        self._measured = False
        self._fast = np.zeros(len(JOINTS), bool)
        """Joints [12] that were beyond their speed limit at the last reading."""

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
        """Add the torques of a reading, asked for and given, to the window."""
        given = state.joint_torque
        asked = command.stiffness * (command.position - state.joint_position)
        asked = asked - command.damping * state.joint_velocity
        asked = np.minimum(np.maximum(asked, -self._torque), self._torque)
        # Beyond its speed limit a joint is braked, whatever was asked for then or since.
        now = np.abs(state.joint_velocity) > 0.9 * self._speed
        fast = now | self._fast
        self._fast = now
        counted = np.minimum(np.maximum(given, -_MAX_COUNTED), _MAX_COUNTED)
        place = self._next % LONG_WINDOW
        self._asked[place] = np.where(fast, 0.0, asked**2)
        self._given[place] = np.where(fast, 0.0, counted**2)
        self._obeyed[place] = np.where(fast, 0.0, counted * asked)
        apart = np.minimum(np.abs(given - asked), _MAX_COUNTED)
        self._apart[place] = np.where(fast, 0.0, apart**2)
        self._next += 1

    def _compare(self) -> str:
        """Name a motor whose torques in the windows are not those asked for; empty if none."""
        if self._next < SHORT_WINDOW:
            return ""
        # The short window: a motor that gives no torque, or another one.
        soon = np.arange(self._next - SHORT_WINDOW, self._next) % LONG_WINDOW
        asked = self._asked[soon].mean(axis=0)
        given = self._given[soon].mean(axis=0)
        dead = (asked > _MIN_ASKED**2) & (given < self._least**2 * asked)
        if dead.any():
            return f"{JOINTS[int(dead.argmax())]} does not obey: its motor gives no torque"
        apart = np.sqrt(self._apart[soon].mean(axis=0))
        if (apart > _MAX_ERROR).any():
            joint = int(apart.argmax())
            return f"{JOINTS[joint]} does not obey: it gives another torque than asked for"
        if self._next < LONG_WINDOW:
            return ""
        # The long window: a motor that gives a part of it.
        asked = self._asked.mean(axis=0)
        share = _WEAK_RATIO * self._least
        weak = (asked > _MIN_ASKED**2) & (self._obeyed.mean(axis=0) < share * asked)
        if weak.any():
            return f"{JOINTS[int(weak.argmax())]} is too weak: its motor gives little torque"
        return ""
