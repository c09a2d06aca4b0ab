"""Interface of an operator's device, whose commands steer a robot, stand it up and stop it."""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Protocol

MAX_INPUT = 4096
"""Most bytes of keys or events read in one control step; the rest waits for the next."""
FADE = 1.0
"""Time in which the velocity falls to zero when nobody steers any more, s."""


class Velocity(NamedTuple):
    """Velocity of the base in its own frame: x ahead, y left, z up, as in ROS's `Twist`."""

    forward: float = 0.0
    """m/s; negative: backward."""
    left: float = 0.0
    """m/s; negative: to the right."""
    turn_rate: float = 0.0
    """rad/s; positive: to the left."""


@dataclass(frozen=True)
class TeleopCommand:
    """The operator's command at one control step."""

    forward: float = 0.0
    """As in `Velocity`; not limited yet."""
    left: float = 0.0
    turn_rate: float = 0.0
    arm: bool = False
    """Leave damping, stand up and walk."""
    stop: bool = False
    """Go to damping at once, whatever else is asked for."""


class Teleop(Protocol):
    """Source of commands that never makes its caller wait.

    It may have an attribute `problem`, which is told to the operator when it changes, an attribute
    `quit`, which ends the run when it is true, and an attribute `controls_ahead`: the instructions
    for a policy that only walks ahead and turns.
    """

    controls: str
    """Instructions for the operator, in one line."""
    attended: bool
    """True if somebody can arm the robot again once it is braked."""

    def command(self, now: float) -> TeleopCommand:
        """Return the newest command at the time `now` on the robot's clock, s."""
        ...

    def drain(self, now: float) -> None:
        """Forget what was asked for before the run."""


@dataclass(frozen=True)
class TeleopCfg:
    """Operator's device of `renet deploy --teleop NAME`; its fields are options of the command."""

    silence: ClassVar[float | None] = None
    """Time without a sign of the operator after which the robot stands, s; None leaves it to the
    robot."""

    def check(self) -> None:
        """Raise RenetError for options that cannot work."""

    def build(self, deadman: float, simulated: bool) -> Teleop:
        """Open the device.

        Args:
            deadman: Time without a sign of the operator after which the robot stands, s.
            simulated: The robot is simulated, and can hurt nobody.

        Raises:
            RenetError: The device is missing or cannot steer.
        """
        raise NotImplementedError


@dataclass
class Deadman:
    """Fades the velocity when an operator gives no sign for too long.

    A gamepad out of range sends nothing, as a gamepad in a still hand does.
    """

    timeout: float
    """Time of silence after which nobody steers, s."""
    _heard: float | None = None

    def authority(self, heard: bool, now: float) -> float:
        """Return the share of the velocity that counts: 1, and 0 after `timeout` + `FADE` s."""
        if heard or self._heard is None:
            self._heard = now
        silent = now - self._heard - self.timeout
        return min(max(1.0 - silent / FADE, 0.0), 1.0)
