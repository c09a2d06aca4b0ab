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
"""m/s that a key adds to a speed."""
TURN_STEP = 0.2
"""rad/s that a key adds to the turn rate."""
DEAD_ZONE = 0.1
"""Share of its range that a stick must leave its middle to steer, and move to show that somebody
holds it: noise is smaller."""
FADE = 1.0
"""Seconds in which the velocity falls to zero when nobody steers any more."""


class Velocity(NamedTuple):
    """Velocity of the base in its own frame, as ROS's `Twist` names it: x ahead, y left, z up."""

    forward: float = 0.0
    """m/s; negative: backward."""
    left: float = 0.0
    """m/s; negative: to the right."""
    turn_rate: float = 0.0
    """rad/s; positive: to the left."""


@dataclass(frozen=True)
class TeleopCommand:
    """What the operator asks for at one control step."""

    forward: float = 0.0
    """As in `Velocity`; not limited yet."""
    left: float = 0.0
    turn_rate: float = 0.0
    arm: bool = False
    """Leave damping: stand up and walk."""
    stop: bool = False
    """Go to damping at once; wins over everything else."""


class Teleop(Protocol):
    """A source of commands that never makes its caller wait.

    One whose `problem` changes has it told to the operator; one whose `quit` is true ends the run.
    """

    controls: str
    """How to steer, in one line."""
    attended: bool
    """Whether somebody can arm the robot again once it is braked."""

    def command(self, now: float) -> TeleopCommand:
        """The newest command at a time in seconds on the robot's clock."""
        ...

    def drain(self, now: float) -> None:
        """Forget what was asked for before a run begins."""


@dataclass(frozen=True)
class TeleopCfg:
    """An operator's device that `renet deploy --teleop NAME` listens to; its fields are options."""

    silence: ClassVar[float | None] = None
    """Seconds without a sign of the operator after which the robot stands; None: it depends on the
    robot."""

    def check(self) -> None:
        """Raise RenetError for options that cannot work."""

    def build(self, deadman: float, simulated: bool) -> Teleop:
        """Open the device.

        Args:
            deadman: seconds without a sign of the operator after which the robot stands.
            simulated: whether the robot is; nobody can be hurt by it.

        Raises:
            RenetError: the device is missing or cannot steer.
        """
        raise NotImplementedError


@dataclass
class ScriptedTeleop:
    """Arms at once and walks straight ahead."""

    speed: float
    controls: str = "walks straight ahead"
    attended: bool = False
    _armed: bool = False

    def command(self, now: float) -> TeleopCommand:
        """To arm at the first call, the speed from then on."""
        arm, self._armed = not self._armed, True
        return TeleopCommand(arm=True) if arm else TeleopCommand(forward=self.speed)

    def drain(self, now: float) -> None:
        """Nothing is asked for before."""


@dataclass
class Deadman:
    """Takes the velocity away when an operator gives no sign for too long.

    A gamepad out of range or a broken link sends nothing: it cannot be told from a still hand.
    """

    timeout: float
    """Seconds of silence after which nobody steers."""
    _heard: float | None = None

    def authority(self, heard: bool, now: float) -> float:
        """Share of the velocity that counts: 1, and 0 once `timeout` + `FADE` s were silent."""
        if heard or self._heard is None:
            self._heard = now
        silent = now - self._heard - self.timeout
        return min(max(1.0 - silent / FADE, 0.0), 1.0)


@dataclass(frozen=True)
class Axis:
    """One component of the velocity, which keys change in steps."""

    step: float
    least: float
    greatest: float

    def value(self, steps: int) -> float:
        """Velocity after so many steps; exactly zero after none."""
        return self.step * steps

    def limited(self, steps: int) -> int:
        """Steps within the range of commands."""
        return min(max(steps, round(self.least / self.step)), round(self.greatest / self.step))


AXES = (
    Axis(SPEED_STEP, -MAX_REVERSE, MAX_SPEED),
    Axis(SPEED_STEP, -MAX_SIDEWAYS, MAX_SIDEWAYS),
    Axis(TURN_STEP, -MAX_TURN, MAX_TURN),
)
"""Those of `Velocity`, in its order."""
KEYS = {"w": (0, 1), "s": (0, -1), "j": (1, 1), "l": (1, -1), "a": (2, 1), "d": (2, -1)}
"""Component that a key changes, and by how many steps. q is to quit, and z is elsewhere on a German
keyboard; j and l are at the same place on English, German and French ones."""
STAND_KEY = "x"
ARM_KEY = "r"


class KeyboardTeleop:
    """Reads keys from a terminal. Closing the terminal stops the robot."""

    controls = (
        "w/s forward/backward, a/d turn left/right, j/l sideways left/right, x stand still, "
        "r stand up and walk, space stop, q quit"
    )
    attended = True

    def __init__(self, deadman: float) -> None:
        """Take over standard input; raises RenetError if that is no terminal.

        The robot stands after `deadman` seconds without any key.
        """
        try:
            self._descriptor = sys.stdin.fileno()
            self._before = termios.tcgetattr(self._descriptor)
            tty.setcbreak(self._descriptor)
        except (termios.error, OSError, ValueError, AttributeError) as error:  # None: closed.
            raise RenetError(
                "the operator's keys need a terminal: run renet in one, or take --teleop joystick"
            ) from error
        self._steps = [0, 0, 0]
        self._armed = -math.inf
        self._deadman = Deadman(deadman)
        self.quit = False

    def command(self, now: float) -> TeleopCommand:
        """All keys pressed since the last call; a stop among them wins."""
        keys = b""
        if select.select([self._descriptor], [], [], 0.0)[0]:
            keys = os.read(self._descriptor, MAX_INPUT)
            self.quit |= not keys or b"q" in keys  # No keys: the terminal is gone.
        arm = False
        for key in map(chr, keys):
            if key in KEYS:
                component, steps = KEYS[key]
                wished = self._steps[component] + steps
                self._steps[component] = AXES[component].limited(wished)
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
        velocity = [authority * axis.value(n) for axis, n in zip(AXES, self._steps, strict=True)]
        return TeleopCommand(*velocity, arm=arm, stop=b" " in keys or self.quit)

    def drain(self, now: float) -> None:
        """Forget the keys that were pressed, except a wish to quit."""
        self.command(now)

    def close(self) -> None:
        """Give the terminal back."""
        with suppress(termios.error):  # A terminal that is lost has nothing to be given back.
            termios.tcsetattr(self._descriptor, termios.TCSADRAIN, self._before)


class GamepadTeleop:
    """Reads a gamepad whose sticks and buttons the kernel names."""

    controls = (
        "left stick forward/backward and sideways, right stick turns, Start or Options stands up "
        "and walks, A, B, cross or circle stops"
    )
    FORWARD, LEFT, TURN = "ABS_Y", "ABS_X", "ABS_RX"
    ARM_BUTTONS, STOP_BUTTONS = ("BTN_START",), ("BTN_SOUTH", "BTN_EAST")
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
        """Where the sticks are; an unplugged gamepad stops the robot."""
        arm = stop = heard = False
        try:
            for event in self._pad.events():
                # The kernel repeats the state of all after its queue ran over: no sign of a hand.
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
        # Sticks count to the right and towards the operator.
        ahead = -self._stick(self.FORWARD)
        return TeleopCommand(
            forward=authority * ahead * (MAX_SPEED if ahead > 0.0 else MAX_REVERSE),
            left=authority * -self._stick(self.LEFT) * MAX_SIDEWAYS,
            turn_rate=authority * -self._stick(self.TURN) * MAX_TURN,
            arm=arm,
            stop=stop,
        )

    def drain(self, now: float) -> None:
        """Forget the buttons that were pressed; learn where the sticks are."""
        self.command(now)

    def close(self) -> None:
        """Close the device."""
        self._pad.close()

    def _moved(self, name: str, value: float) -> bool:
        """Note where a stick is; returns whether it moved since it last did."""
        self._sticks[name] = value
        moved = abs(value - self._held[name]) >= DEAD_ZONE
        if moved:
            self._held[name] = value
        return moved

    def _stick(self, name: str) -> float:
        value = self._sticks[name]
        return value if abs(value) > DEAD_ZONE else 0.0
