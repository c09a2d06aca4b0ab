"""What a human asks of a robot, whatever the device."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

MAX_SPEED = 1.0
"""Fastest forward command of training, m/s (paper)."""


@dataclass(frozen=True)
class Request:
    """The operator's wishes at one control tick."""

    speed: float = 0.0
    """Forward speed c_x, m/s."""
    turn: float = 0.0
    """Sum of all turns asked for, rad, left positive. Only its changes count, and what they ask for
    is never more than a quarter turn from the robot's heading."""
    arm: bool = False
    """Leave damping: stand up and walk."""
    stop: bool = False
    """Go to damping at once; wins over everything else."""


class Operator(Protocol):
    """A source of requests that never makes its caller wait."""

    def request(self, now: float) -> Request:
        """The newest wishes at a time on the robot's clock."""
        ...


class ScriptedOperator:
    """Arms at once and walks straight ahead."""

    def __init__(self, speed: float) -> None:
        self.speed = speed
        self._armed = False

    def request(self, now: float) -> Request:
        """See Operator.request."""
        arm, self._armed = not self._armed, True
        return Request(arm=True) if arm else Request(speed=self.speed)
