"""What motors say of themselves: that they no longer obey, or do not hear."""

import math

import numpy as np

from renet.deploy.robots.real.identity import IN_A_ROW
from renet.interface import JOINTS

BEGUN = 0.1
"""Seconds from the first command to when every motor says that it obeys."""
WINDOW = 0.1
"""Seconds over which lost messages are counted."""
MOST_LOST = 25
"""Messages that a motor may lose in that time, half of those that are sent."""
ABSURD = 1000
"""A count that grew by more is no count."""


class MotorTrouble:
    """Judges the mode and the lost messages that each motor reports.

    What the numbers mean is the vendor's secret in part. So a motor's mode is compared with its own
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
        """What is wrong; empty if nothing is.

        Args:
            modes: [12], of the motors. lost: [12] messages since the robot's start.
            commanded: when the newest command was given, s; -inf before the first. now: likewise.
        """
        if commanded == -math.inf:
            return ""
        self._first = min(self._first, now)
        if now - self._first < BEGUN:
            return ""
        if self._usual is None:
            self._usual = np.array(modes)
        self._changed = np.where(modes != self._usual, self._changed + 1, 0)
        if now - self._counted >= WINDOW:
            grown = lost.astype(float) - self._lost
            self._deaf = (grown >= MOST_LOST) & (grown <= ABSURD) & (self._counted > -math.inf)
            self._lost = lost.astype(float)
            self._counted = now
        for joint, changed, deaf in zip(JOINTS, self._changed, self._deaf, strict=True):
            if changed >= IN_A_ROW:
                return f"the motor of {joint} has left its mode"
            if deaf:
                return f"the motor of {joint} loses its commands"
        return ""
