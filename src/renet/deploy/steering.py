"""Commands of policies from the velocity that an operator asks for.

A policy is told the velocity of its base, or a speed and the angle to a heading (`interface.TOLD`).
"""

import math
from abc import ABC, abstractmethod

from renet.deploy.teleop.base import Velocity
from renet.interface import CONTROL_DT, MAX_TURN, TURN_GAIN, Told

MAX_LEAD = math.pi / 2
"""Largest angle from the robot's heading to the wished one, rad, as in training."""
FORWARD_ONLY = "this policy cannot walk backward or sideways; go1-driven and go2-driven can"
"""Reason of a refusal."""


class Steering(ABC):
    """Turns velocities into a policy's commands, one at each control step of a walk."""

    def __init__(self) -> None:
        self.refused = ""
        """Reason for which a part of the last velocity was left out; empty if none was."""
        self.followed = Velocity()
        """Last velocity without the part that was left out."""
        self._wished = 0.0
        """Heading that the robot is to have, rad."""

    def start(self, heading: float) -> None:
        """Begin a walk at the robot's heading, rad."""
        self._wished = heading

    @abstractmethod
    def command(self, velocity: Velocity, heading: float) -> tuple[float, float, float]:
        """Return the policy's command for a velocity within limits and the robot's heading, rad."""

    @abstractmethod
    def slow(self, command: tuple[float, float, float]) -> None:
        """Take over, into `followed`, the speed of the last command as the pilot has slowed it."""


class HeadingSteering(Steering):
    """Steering of policies that are told (c_x, sin e, cos e), e the angle to the wished heading."""

    def command(self, velocity: Velocity, heading: float) -> tuple[float, float, float]:
        """Return (c_x, sin e, cos e), c_x in m/s; such policies only walk ahead."""
        backward_or_sideways = velocity.forward < 0.0 or velocity.left != 0.0
        self.refused = FORWARD_ONLY if backward_or_sideways else ""
        self.followed = Velocity(forward=max(velocity.forward, 0.0), turn_rate=velocity.turn_rate)
        error = _lead(self._wished + CONTROL_DT * velocity.turn_rate, heading)
        self._wished = heading + error
        return self.followed.forward, math.sin(error), math.cos(error)

    def slow(self, command: tuple[float, float, float]) -> None:
        """Take over c_x."""
        self.followed = self.followed._replace(forward=command[0])


class TwistSteering(Steering):
    """Steering of policies that are told the velocity itself; it keeps the heading.

    A policy that is told not to turn still drifts by some hundredths of a radian a second, which
    nobody corrects from a keyboard. So when the operator's turn ends, the heading of that moment is
    kept, with the feedback by which training leads robots to their goals. There is no dead band: it
    would leave the robot off by its width, the policy knows small turn rates, and the wobble of a
    walk averages out. If the robot swings on after a turn, it turns back.

    A standing robot is not corrected: training never tells one to turn a little on the spot, and
    noise or the drift of its attitude would make it step for ever. Its next walk keeps the heading
    that it has then, even if it was turned by hand.
    """

    def command(self, velocity: Velocity, heading: float) -> tuple[float, float, float]:
        """Return (v_x, v_y, omega_z), m/s and rad/s."""
        self.followed = velocity
        forward, left, turn_rate = velocity
        stands = forward == 0.0 and left == 0.0
        # While the operator turns or the robot stands, nothing is corrected.
        if turn_rate != 0.0 or stands:
            self._wished = heading
            return forward, left, turn_rate
        error = _lead(self._wished, heading)
        self._wished = heading + error
        return forward, left, min(max(TURN_GAIN * error, -MAX_TURN), MAX_TURN)

    def slow(self, command: tuple[float, float, float]) -> None:
        """Take over v_x and v_y."""
        self.followed = self.followed._replace(forward=command[0], left=command[1])


STEERINGS: dict[Told, type[Steering]] = {
    "heading": HeadingSteering,
    "twist": TwistSteering,
}
"""Steering of each form of command."""


def _lead(wished: float, heading: float) -> float:
    """Return the angle from a heading to the wished one, rad, at most `MAX_LEAD` either way."""
    lead = math.remainder(wished - heading, math.tau)
    return min(max(lead, -MAX_LEAD), MAX_LEAD)
