"""Whether motors do what they are told: the torque that each gives against the one asked of it."""

import numpy as np

from renet.deploy.robots.base import JointCommand, RobotState
from renet.interface import JOINTS

SOON = 15
"""Readings, 0.3 s, over which a motor is compared that gives next to nothing, or too much."""
LATER = 100
"""Readings, 2 s, over which one is compared that gives too little."""
WEAK = 3.0
"""Times the least share of the torque asked for, below which a motor is weak for so long."""
ASKED = 3.0
"""N m that must have been asked for, in the mean square, to tell."""
DISOBEYS = 18.0
"""N m by which given and asked for may differ, in the mean square: 11 at most in 160 s of walks
with pushes on a network of a real Go1's motors, which answer late; none on ideal ones."""
MOST_APART = 30.0
"""N m that one reading counts at most: a single odd one must not be enough."""
ABSURD = 3.0
"""Times a motor's limit that it cannot give."""
IN_A_ROW = 3
"""Readings of such a torque that are no mistake."""


class MotorWatch:
    """Compares commands with the torques in the readings that follow them.

    Robots that measure no torque say zero for all joints, always: nothing is compared then.
    """

    def __init__(self, torque: np.ndarray, speed: np.ndarray, least: float) -> None:
        """Watch motors of given limits [12], N m and rad/s; beyond the speed drivers only brake.

        `least` is the share of the torque asked for that each must give at least.
        """
        self._least = least
        self._torque = torque
        self._speed = speed
        self.start_over()

    def start_over(self) -> None:
        """Forget what was compared: the robot did something else meanwhile."""
        self._asked = np.zeros((LATER, len(JOINTS)))
        self._given = np.zeros((LATER, len(JOINTS)))
        self._apart = np.zeros((LATER, len(JOINTS)))
        """Squares of torques, N² m²; the newest is at `_next - 1`."""
        self._next = 0
        self._absurd = 0
        self._command: JointCommand | None = None
        self._measured = False

    def told(self, command: JointCommand) -> None:
        """Keep the command that the next reading shows the effect of."""
        self._command = command

    def problem(self, state: RobotState) -> str:
        """Which motor does not do what it was told; empty if all do."""
        command = self._command
        given = state.joint_torque
        self._measured = self._measured or bool(given.any())
        if command is None or not self._measured:
            return ""
        absurd = np.flatnonzero(np.abs(given) > ABSURD * self._torque)
        self._absurd = self._absurd + 1 if len(absurd) else 0
        if self._absurd >= IN_A_ROW:
            joint = absurd[0]
            return f"{JOINTS[joint]} says {given[joint]:.3g} N m, which no motor of it gives"
        asked = command.stiffness * (command.position - state.joint_position)
        asked = asked - command.damping * state.joint_velocity
        asked = np.minimum(np.maximum(asked, -self._torque), self._torque)
        fast = np.abs(state.joint_velocity) > 0.9 * self._speed
        place = self._next % LATER
        self._asked[place] = np.where(fast, 0.0, asked**2)
        self._given[place] = np.where(fast, 0.0, np.minimum(np.abs(given), MOST_APART) ** 2)
        apart = np.minimum(np.abs(given - asked), MOST_APART)
        self._apart[place] = np.where(fast, 0.0, apart**2)
        self._next += 1
        return self._compare()

    def _compare(self) -> str:
        """Name the motor whose torques of the last readings are not those asked for."""
        if self._next < SOON:
            return ""
        soon = np.arange(self._next - SOON, self._next) % LATER
        asked = self._asked[soon].mean(axis=0)
        given = self._given[soon].mean(axis=0)
        dead = (asked > ASKED**2) & (given < self._least**2 * asked)
        if dead.any():
            return f"{JOINTS[int(dead.argmax())]} does not obey: its motor gives no torque"
        apart = np.sqrt(self._apart[soon].mean(axis=0))
        if (apart > DISOBEYS).any():
            joint = int(apart.argmax())
            return f"{JOINTS[joint]} does not obey: it gives another torque than asked for"
        if self._next < LATER:
            return ""
        asked = self._asked.mean(axis=0)
        least = (WEAK * self._least) ** 2 * asked
        weak = (asked > ASKED**2) & (self._given.mean(axis=0) < least)
        if weak.any():
            return f"{JOINTS[int(weak.argmax())]} is too weak: its motor gives little torque"
        return ""
