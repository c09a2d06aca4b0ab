"""Where a policy is told to go, from the velocity that an operator asks for.

Policies are told a velocity of their base, or a speed and the angle to a heading
(`interface.TOLD`).
"""

import math
from typing import Protocol

from renet.deploy.teleop import Velocity
from renet.interface import CONTROL_DT, MAX_TURN, TURN_GAIN, Told

MAX_LEAD = math.pi / 2
"""rad; farthest that the wished heading is from the robot's, as in training."""
FORWARD_ONLY = "this policy cannot walk backward or sideways"


class Steering(Protocol):
    """Turns velocities into a policy's commands, one at each control step of a walk."""

    refused: str
    """Why a part of the last velocity was left out; empty if none was."""

    def start(self, heading: float) -> None:
        """Begin a walk in the direction in which the robot looks, rad."""

    def command(self, velocity: Velocity, heading: float) -> tuple[float, float, float]:
        """Command for a velocity within limits, while the robot looks towards `heading`, rad."""
        ...


class HeadingSteering:
    """For policies that are told (c_x, sin e, cos e), e the angle to the wished heading."""

    def __init__(self) -> None:
        self.refused = ""
        self._wished = 0.0

    def start(self, heading: float) -> None:
        """Begin a walk."""
        self._wished = heading

    def command(self, velocity: Velocity, heading: float) -> tuple[float, float, float]:
        """(c_x, sin e, cos e); such policies only walk ahead."""
        backward_or_sideways = velocity.forward < 0.0 or velocity.left != 0.0
        self.refused = FORWARD_ONLY if backward_or_sideways else ""
        error = _lead(self._wished + CONTROL_DT * velocity.turn_rate, heading)
        self._wished = heading + error
        return max(velocity.forward, 0.0), math.sin(error), math.cos(error)


class TwistSteering:
    """For policies that are told the velocity itself; it keeps the heading on straight ways.

    A policy that is told not to turn still drifts by some hundredths of a radian a second, and
    nobody corrects that from a keyboard. So once the operator's turn has ended, the heading of that
    moment is kept, with the feedback by which training tells goals. Hence without a dead band: the
    policy knows small turn rates, a walking robot's wobble averages out, and a band would leave the
    robot off by as much as its width. What it swings on after a turn, it turns back.

    A robot that stands is not corrected: training never tells one to turn a little on the spot, and
    noise or the drift of its attitude would make it step for ever. It walks on towards where it
    looks then, and so does one that was turned by hand.
    """

    def __init__(self) -> None:
        self.refused = ""
        self._kept = 0.0

    def start(self, heading: float) -> None:
        """Begin a walk."""
        self._kept = heading

    def command(self, velocity: Velocity, heading: float) -> tuple[float, float, float]:
        """(v_x, v_y, omega_z)."""
        forward, left, turn_rate = velocity
        stands = forward == 0.0 and left == 0.0
        if turn_rate != 0.0 or stands:
            self._kept = heading
            return forward, left, turn_rate
        error = _lead(self._kept, heading)
        self._kept = heading + error
        return forward, left, min(max(TURN_GAIN * error, -MAX_TURN), MAX_TURN)


STEERINGS: dict[Told, type[HeadingSteering] | type[TwistSteering]] = {
    "heading": HeadingSteering,
    "twist": TwistSteering,
}


def _lead(wished: float, heading: float) -> float:
    """Angle from a heading to the wished one, rad; a robot that cannot follow lags no farther."""
    lead = math.remainder(wished - heading, math.tau)
    return min(max(lead, -MAX_LEAD), MAX_LEAD)
