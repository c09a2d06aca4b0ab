"""Trouble that motors report: that they no longer obey, or lose commands."""

import math

import numpy as np

from renet.deploy.robots.real.identity import IN_A_ROW
from renet.interface import JOINTS

BEGUN = 0.1
"""Time from the first command until every motor reports that it obeys, s."""
_WINDOW = 0.1
"""Time over which lost messages are counted, s."""
_MOST_LOST = 25
"""Number of lost messages in that time that is trouble, half of those that are sent."""
_ABSURD = 1000
"""Largest believable growth of a count."""


class MotorTrouble:
    """Judges the mode and the lost messages that each motor reports.

    The vendors do not document all of these numbers. So a motor's mode is compared with its own
    when commands began, and the lost messages with those shortly before.
    """

    def __init__(self) -> None:
        self._usual: np.ndarray | None = None
        self._changed = np.zeros(len(JOINTS), int)
        self._lost = np.zeros(len(JOINTS))
        self._deaf = np.zeros(len(JOINTS), bool)
        self._counted = -math.inf
        self._first = math.inf

    def look(self, modes: np.ndarray, lost: np.ndarray, commanded: float, now: float) -> str:
        """Return the trouble in a line; empty if there is none.

        Args:
            modes: [12] modes of the motors.
            lost: [12] numbers of messages lost since the robot's start.
            commanded: Time of the newest command, s; -inf before the first.
            now: Time, s.
        """
        if commanded == -math.inf:
            return ""
        self._first = min(self._first, now)
        # Motors change their mode some time after the first command.
        if now - self._first < BEGUN:
            return ""
        if self._usual is None:
            self._usual = np.array(modes)
        self._changed = np.where(modes != self._usual, self._changed + 1, 0)
        if now - self._counted >= _WINDOW:
            grown = lost.astype(float) - self._lost
            self._deaf = (grown >= _MOST_LOST) & (grown <= _ABSURD) & (self._counted > -math.inf)
            self._lost = lost.astype(float)
            self._counted = now
        for joint, changed, deaf in zip(JOINTS, self._changed, self._deaf, strict=True):
            if changed >= IN_A_ROW:
                return f"the motor of {joint} has left its mode"
            if deaf:
                return f"the motor of {joint} loses its commands"
        return ""
