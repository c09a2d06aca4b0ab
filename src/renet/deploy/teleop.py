"""Sources of an operator's commands: the terminal's keyboard, a Linux joystick, or a script."""

import math
import os
import select
import struct
import sys
import termios
import tty
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

from renet.errors import RenetError
from renet.interface import MAX_SPEED

SPEED_KEYS, TURN_KEYS = {"w": 0.1, "s": -0.1}, {"a": 0.1, "d": -0.1}
"""m/s and rad per key press."""
JOYSTICK = "/dev/input/js0"
TURN_RATE = 1.0
"""rad/s at a joystick's full deflection."""
DEAD_ZONE = 0.1
"""Share of its range that a stick must leave its middle to steer, and move to show that somebody
holds it: noise is smaller."""
FADE = 1.0
"""Seconds in which the speed falls to zero when nobody steers any more."""
MAX_INPUT = 4096
"""Bytes of keys or joystick events read in one control step; the rest waits for the next."""


@dataclass(frozen=True)
class TeleopCommand:
    """What the operator asks for at one control step."""

    speed: float = 0.0
    """Forward speed c_x, m/s."""
    turn: float = 0.0
    """Sum of all turns asked for, rad, left positive. Only its changes count, and what they ask for
    is never more than a quarter turn from the robot's heading."""
    arm: bool = False
    """Leave damping: stand up and walk."""
    stop: bool = False
    """Go to damping at once; wins over everything else."""


class Teleop(Protocol):
    """A source of commands that never makes its caller wait."""

    def command(self, now: float) -> TeleopCommand:
        """The newest command at a time in seconds on the robot's clock."""
        ...


@dataclass
class ScriptedTeleop:
    """Arms at once and walks straight ahead."""

    speed: float
    _armed: bool = False

    def command(self, now: float) -> TeleopCommand:
        """To arm at the first call, the speed from then on."""
        arm, self._armed = not self._armed, True
        return TeleopCommand(arm=True) if arm else TeleopCommand(speed=self.speed)


@dataclass
class Deadman:
    """Takes the speed away when an operator gives no sign for too long.

    A joystick out of range or a broken link sends nothing: it cannot be told from a still hand.
    """

    timeout: float
    """Seconds of silence after which nobody steers."""
    _heard: float | None = None

    def authority(self, heard: bool, now: float) -> float:
        """Share of the speed that still counts: 1, and 0 once `timeout` + `FADE` s were silent."""
        if heard or self._heard is None:
            self._heard = now
        silent = now - self._heard - self.timeout
        return min(max(1.0 - silent / FADE, 0.0), 1.0)


class KeyboardTeleop:
    """Reads keys from a terminal. Closing the terminal stops the robot."""

    CONTROLS = "w/s faster/slower, a/d left/right, r stand up and walk, space stop, q quit"

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
                "--teleop keyboard needs a terminal: run renet in one, or take a joystick"
            ) from error
        self.speed = self.turn = 0.0
        self._armed = -math.inf
        self._deadman = Deadman(deadman)
        self.quit = False

    def command(self, now: float) -> TeleopCommand:
        """All keys pressed since the last call; a stop among them wins."""
        arm, keys = False, b""
        if select.select([self._descriptor], [], [], 0.0)[0]:
            keys = os.read(self._descriptor, MAX_INPUT)
            self.quit |= not keys or b"q" in keys  # No keys: the terminal is gone.
        for key in map(chr, keys):
            self.speed = min(max(self.speed + SPEED_KEYS.get(key, 0.0), 0.0), MAX_SPEED)
            self.turn += TURN_KEYS.get(key, 0.0)
            if key == "r":
                # Terminals repeat a held key, which must be released before it arms again, and
                # send a pasted text at once, which is no wish to rise.
                arm = keys == b"r" and now - self._armed > 1.0
                self.speed, self._armed = 0.0, now
        authority = self._deadman.authority(bool(keys), now)
        if authority == 0.0:
            self.speed = 0.0
        return TeleopCommand(authority * self.speed, self.turn, arm, b" " in keys or self.quit)

    def close(self) -> None:
        """Give the terminal back."""
        with suppress(termios.error):  # A terminal that is lost has nothing to be given back.
            termios.tcsetattr(self._descriptor, termios.TCSADRAIN, self._before)


class JoystickTeleop:
    """Reads a joystick with the numbers of an Xbox pad."""

    CONTROLS = "left stick up speed, right stick turn, Start stand up and walk, A or B stop"
    EVENT = struct.Struct("<IhBB")
    BUTTON, AXIS, INITIAL = 1, 2, 0x80
    SPEED_AXIS, TURN_AXIS = 1, 3
    ARM_BUTTONS, STOP_BUTTONS = (7,), (0, 1)

    def __init__(self, deadman: float) -> None:
        """Open `JOYSTICK`; raises RenetError if there is none.

        The robot stands after `deadman` seconds without a move of stick or button.
        """
        try:
            self._device = os.open(JOYSTICK, os.O_RDONLY | os.O_NONBLOCK)
        except OSError as error:
            raise RenetError(f"no joystick at {JOYSTICK}: {error.strerror}") from error
        self._axes: dict[int, float] = {}
        self._held: dict[int, float] = {}
        self._turn, self._time = 0.0, None
        self._deadman = Deadman(deadman)

    def command(self, now: float) -> TeleopCommand:
        """Where the sticks are; an unplugged joystick stops the robot."""
        arm = stop = heard = False
        try:
            data = os.read(self._device, MAX_INPUT // self.EVENT.size * self.EVENT.size)
            if not data or len(data) % self.EVENT.size:
                raise OSError("the joystick is gone")
            for _, value, kind, number in self.EVENT.iter_unpack(data):
                # The kernel repeats the state of all after its queue ran over: no sign of a hand.
                initial, kind = bool(kind & self.INITIAL), kind & ~self.INITIAL
                if kind == self.AXIS:
                    heard |= self._moved(number, value / 32767.0) and not initial
                elif kind == self.BUTTON:
                    heard |= not initial
                    arm |= bool(value) and number in self.ARM_BUTTONS and not initial
                    stop |= bool(value) and number in self.STOP_BUTTONS
        except BlockingIOError:  # Nothing new.
            pass
        except OSError:
            stop = True
        passed = 0.0 if self._time is None else max(now - self._time, 0.0)
        self._time = now
        authority = self._deadman.authority(heard, now)
        self._turn -= authority * TURN_RATE * self._axis(self.TURN_AXIS) * min(passed, 0.1)
        speed = authority * MAX_SPEED * max(-self._axis(self.SPEED_AXIS), 0.0)
        return TeleopCommand(speed, self._turn, arm and not self._axis(self.TURN_AXIS), stop)

    def close(self) -> None:
        """Close the device."""
        os.close(self._device)

    def _moved(self, number: int, value: float) -> bool:
        """Note an axis; returns whether one that steers moved since it last did."""
        self._axes[number] = value
        steers = number in (self.SPEED_AXIS, self.TURN_AXIS)
        moved = steers and abs(value - self._held.get(number, 0.0)) >= DEAD_ZONE
        if moved:
            self._held[number] = value
        return moved

    def _axis(self, number: int) -> float:
        value = self._axes.get(number, 0.0)
        return value if abs(value) > DEAD_ZONE else 0.0
