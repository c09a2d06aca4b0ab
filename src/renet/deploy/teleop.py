"""Sources of an operator's commands: the terminal's keyboard, a gamepad, or a script."""

import math
import os
import select
import sys
import termios
import tty
from contextlib import suppress
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Protocol

from renet.deploy.gamepad import MAX_INPUT, Gamepad
from renet.errors import RenetError
from renet.interface import MAX_REVERSE, MAX_SIDEWAYS, MAX_SPEED, MAX_TURN

SPEED_STEP = 0.1
"""Change of a speed by one key, m/s."""
TURN_STEP = 0.2
"""Change of the turn rate by one key, rad/s."""
DEAD_ZONE = 0.1
"""Share of its range by which a stick must be off its middle to steer, and by which it must move to
show that somebody holds it. Noise is smaller."""
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
class ScriptedTeleop:
    """Script that arms at once and walks straight ahead at `speed`, m/s."""

    speed: float
    controls: str = "walks straight ahead"
    attended: bool = False
    _armed: bool = False

    def command(self, now: float) -> TeleopCommand:
        """Return a wish to arm at the first call, and the speed from then on."""
        if not self._armed:
            self._armed = True
            return TeleopCommand(arm=True)
        return TeleopCommand(forward=self.speed)

    def drain(self, now: float) -> None:
        """Do nothing: nothing was asked for before."""


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


@dataclass(frozen=True)
class _Component:
    """Component of the velocity, m/s or rad/s, which keys change in steps."""

    step: float
    least: float
    greatest: float

    def value(self, steps: int) -> float:
        """Return the velocity after a number of steps; exactly zero after none."""
        return self.step * steps

    def limited(self, steps: int) -> int:
        """Return the nearest number of steps whose velocity is in the range of commands."""
        return min(max(steps, round(self.least / self.step)), round(self.greatest / self.step))


_COMPONENTS = (
    _Component(SPEED_STEP, -MAX_REVERSE, MAX_SPEED),
    _Component(SPEED_STEP, -MAX_SIDEWAYS, MAX_SIDEWAYS),
    _Component(TURN_STEP, -MAX_TURN, MAX_TURN),
)
"""Components of `Velocity`, in its order."""
KEYS = {"w": (0, 1), "s": (0, -1), "j": (1, 1), "l": (1, -1), "a": (2, 1), "d": (2, -1)}
"""Component that a key changes, and the number of steps. Beside a and d, q is for quitting and z is
elsewhere on a German keyboard; j and l are in the same place on English, German and French ones."""
STAND_KEY = "x"
"""Key that sets the velocity to zero."""
ARM_KEY = "r"
"""Key that arms the robot."""


class KeyboardTeleop:
    """Reads keys from a terminal. Closing the terminal stops the robot."""

    _OTHERS = "x stand still, r stand up and walk, space brake, q quit"
    controls = f"w/s forward/backward, a/d turn left/right, j/l sideways left/right, {_OTHERS}"
    controls_ahead = f"w/s faster/slower ahead, a/d turn left/right, {_OTHERS}"
    attended = True

    def __init__(self, deadman: float) -> None:
        """Take over standard input; raises RenetError if it is no terminal.

        The robot stands after `deadman` seconds without any key.
        """
        # Standard input is None where it is closed.
        try:
            self._descriptor = sys.stdin.fileno()
            self._before = termios.tcgetattr(self._descriptor)
            # Keys arrive at once and without an echo, and Ctrl-C still works.
            tty.setcbreak(self._descriptor)
        except (termios.error, OSError, ValueError, AttributeError) as error:
            raise RenetError(
                "the operator's keys need a terminal: run renet in one, or take --teleop joystick"
            ) from error
        self._steps = [0, 0, 0]
        self._armed = -math.inf
        self._deadman = Deadman(deadman)
        self.quit = False

    def command(self, now: float) -> TeleopCommand:
        """Return the command of all keys since the last call; a stop among them wins."""
        keys = b""
        if select.select([self._descriptor], [], [], 0.0)[0]:
            keys = os.read(self._descriptor, MAX_INPUT)
            # A terminal that is ready without keys is gone.
            self.quit |= not keys or b"q" in keys
        arm = False
        for key in map(chr, keys):
            if key in KEYS:
                component, steps = KEYS[key]
                wished = self._steps[component] + steps
                self._steps[component] = _COMPONENTS[component].limited(wished)
            if key in (STAND_KEY, ARM_KEY):
                self._steps = [0, 0, 0]
            if key == ARM_KEY:
                # Terminals repeat a held key, which must be released before it arms again, and
                # send a pasted text at once, which is no wish to rise.
                arm = keys == ARM_KEY.encode() and now - self._armed > 1.0
                self._armed = now
        authority = self._deadman.authority(bool(keys), now)
        if authority == 0.0:
            self._steps = [0, 0, 0]
        velocity = []
        for component, steps in zip(_COMPONENTS, self._steps, strict=True):
            velocity.append(authority * component.value(steps))
        return TeleopCommand(*velocity, arm=arm, stop=b" " in keys or self.quit)

    def drain(self, now: float) -> None:
        """Forget the keys that were pressed, except for a wish to quit."""
        self.command(now)

    def close(self) -> None:
        """Give the terminal back."""
        # A terminal that is lost cannot be given back.
        with suppress(termios.error):
            termios.tcsetattr(self._descriptor, termios.TCSADRAIN, self._before)


class GamepadTeleop:
    """Reads a gamepad whose sticks and buttons the kernel names."""

    _OTHERS = (
        "right stick turns, Start or Options stands up and walks, A, B, cross or circle brakes"
    )
    controls = f"left stick forward/backward and sideways, {_OTHERS}"
    controls_ahead = f"left stick ahead, {_OTHERS}"
    FORWARD = "ABS_Y"
    LEFT = "ABS_X"
    TURN = "ABS_RX"
    ARM_BUTTONS = ("BTN_START",)
    STOP_BUTTONS = ("BTN_SOUTH", "BTN_EAST")
    attended = True

    def __init__(self, deadman: float) -> None:
        """Open the first gamepad that can steer; raises RenetError if there is none.

        The robot stands after `deadman` seconds without a move of stick or button.
        """
        sticks = (self.FORWARD, self.LEFT, self.TURN)
        self._pad = Gamepad.find((*sticks, *self.ARM_BUTTONS, *self.STOP_BUTTONS))
        self._sticks: dict[str, float] = {name: 0.0 for name in sticks}
        self._held = dict(self._sticks)
        self._deadman = Deadman(deadman)

    def command(self, now: float) -> TeleopCommand:
        """Return the command of sticks and buttons; an unplugged gamepad stops the robot."""
        arm = stop = heard = False
        try:
            for event in self._pad.events():
                # After an overflow of its queue, the kernel repeats all states without a hand.
                by_hand = not event.repeated
                if event.name in self._sticks:
                    heard |= self._moved(event.name, event.value) and by_hand
                elif not event.axis:
                    heard |= by_hand
                    pressed = event.value > 0.0
                    arm |= pressed and by_hand and event.name in self.ARM_BUTTONS
                    stop |= pressed and event.name in self.STOP_BUTTONS
        except OSError:
            stop = True
        authority = self._deadman.authority(heard, now)
        # The kernel counts sticks positive to the right and towards the operator.
        ahead = -self._stick(self.FORWARD)
        return TeleopCommand(
            forward=authority * ahead * (MAX_SPEED if ahead > 0.0 else MAX_REVERSE),
            left=authority * -self._stick(self.LEFT) * MAX_SIDEWAYS,
            turn_rate=authority * -self._stick(self.TURN) * MAX_TURN,
            arm=arm,
            stop=stop,
        )

    def drain(self, now: float) -> None:
        """Forget the buttons that were pressed, and learn where the sticks are."""
        self.command(now)

    def close(self) -> None:
        """Close the device."""
        self._pad.close()

    def _moved(self, name: str, value: float) -> bool:
        """Note where a stick is; returns True if it moved since the last time that it did."""
        self._sticks[name] = value
        moved = abs(value - self._held[name]) >= DEAD_ZONE
        if moved:
            self._held[name] = value
        return moved

    def _stick(self, name: str) -> float:
        """Return the position of a stick, -1 to 1, with a dead zone."""
        value = self._sticks[name]
        return value if abs(value) > DEAD_ZONE else 0.0
