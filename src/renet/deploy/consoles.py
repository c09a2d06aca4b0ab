"""Operators with hands: the terminal's keyboard, and a Linux joystick."""

from __future__ import annotations

import math
import os
import select
import struct
import sys
import termios
import tty
from contextlib import suppress
from pathlib import Path
from typing import Any

from renet.deploy.operator import MAX_SPEED, Request
from renet.errors import RenetError

SPEED_STEP, TURN_STEP = 0.1, 0.1
"""m/s and rad per key press."""
TURN_RATE = 1.0
"""rad/s at a joystick's full deflection."""
DEAD_ZONE = 0.1
FADE = 1.0
"""Seconds in which the speed falls to zero when nobody steers any more."""
KEYS = "w/s faster/slower, a/d left/right, r rise and walk, space stop, q quit"


class Deadman:
    """Notices that nobody steers: a joystick out of range or a dead link only falls silent."""

    def __init__(self, patience: float) -> None:
        """Set up with the seconds of silence that mean nothing."""
        self._patience = patience
        self._heard: float | None = None

    def grip(self, heard: bool, now: float) -> float:
        """Share of the speed that still counts: 1, after `patience` s of silence falling to 0."""
        if heard or self._heard is None:
            self._heard = now
        silent = now - self._heard - self._patience
        return min(max(1.0 - silent / FADE, 0.0), 1.0)


class KeyboardOperator:
    """Reads single keys from a terminal; see `KEYS`. Closing the terminal stops the robot."""

    def __init__(self, stream: Any = None, deadman: float = math.inf) -> None:
        """Take over the terminal; raises RenetError if there is none.

        Args:
            stream: of the terminal, standard input by default.
            deadman: seconds without any key after which the robot stands.
        """
        self._stream = sys.stdin if stream is None else stream
        try:
            self._descriptor = self._stream.fileno()
            self._before = termios.tcgetattr(self._descriptor)
            tty.setcbreak(self._descriptor)
        except (termios.error, OSError, ValueError) as error:
            raise RenetError(
                "the keyboard operator needs a terminal: run renet in one, or take a joystick"
            ) from error
        self.speed = self.turn = 0.0
        self._deadman = Deadman(deadman)
        self.quit = False
        """The operator wants to end the program."""

    def request(self, now: float) -> Request:
        """See Operator.request."""
        arm = stop = heard = False
        while select.select([self._descriptor], [], [], 0.0)[0]:
            key, heard = os.read(self._descriptor, 1), True
            if key == b"w":
                self.speed = min(self.speed + SPEED_STEP, MAX_SPEED)
            elif key == b"s":
                self.speed = max(self.speed - SPEED_STEP, 0.0)
            elif key == b"a":
                self.turn += TURN_STEP
            elif key == b"d":
                self.turn -= TURN_STEP
            elif key == b"r":
                arm, self.speed = True, 0.0
            elif key in (b" ", b"q", b""):  # The last is a lost terminal.
                stop, self.quit = True, key != b" "
                if self.quit:
                    break
        grip = self._deadman.grip(heard, now)
        if grip == 0.0:
            self.speed = 0.0
        return Request(grip * self.speed, self.turn, arm, stop or self.quit)

    def close(self) -> None:
        """Give the terminal back."""
        with suppress(termios.error):  # A terminal that is lost has nothing to be given back.
            termios.tcsetattr(self._descriptor, termios.TCSADRAIN, self._before)


class JoystickOperator:
    """Left stick up: speed. Right stick left and right: heading. Start arms; any of A, B stops."""

    EVENT = struct.Struct("<IhBB")
    BUTTON, AXIS, INITIAL = 1, 2, 0x80
    SPEED_AXIS, TURN_AXIS = 1, 3
    ARM_BUTTONS, STOP_BUTTONS = (7,), (0, 1)

    def __init__(self, device: Path = Path("/dev/input/js0"), deadman: float = math.inf) -> None:
        """Open the device; raises RenetError if there is none.

        Args:
            device: of the joystick. deadman: seconds without a move after which the robot stands.
        """
        try:
            self._device = os.open(device, os.O_RDONLY | os.O_NONBLOCK)
        except OSError as error:
            raise RenetError(f"no joystick at {device}: {error.strerror}") from error
        self._axes: dict[int, float] = {}
        self._turn, self._time = 0.0, None
        self._deadman = Deadman(deadman)
        self.quit = False

    def request(self, now: float) -> Request:
        """See Operator.request; an unplugged joystick stops the robot."""
        arm = stop = heard = False
        try:
            while True:
                event = os.read(self._device, self.EVENT.size)
                heard = True
                if len(event) < self.EVENT.size:
                    raise OSError("the joystick is gone")
                _, value, kind, number = self.EVENT.unpack(event)
                if kind & ~self.INITIAL == self.AXIS:
                    self._axes[number] = value / 32767.0
                elif kind == self.BUTTON and value:
                    arm |= number in self.ARM_BUTTONS
                    stop |= number in self.STOP_BUTTONS
        except BlockingIOError:  # Nothing new.
            pass
        except OSError:
            stop = True
        passed = 0.0 if self._time is None else max(now - self._time, 0.0)
        self._time = now
        grip = self._deadman.grip(heard, now)
        self._turn -= grip * TURN_RATE * self._axis(self.TURN_AXIS) * min(passed, 0.1)
        speed = grip * MAX_SPEED * max(-self._axis(self.SPEED_AXIS), 0.0)
        return Request(speed, self._turn, arm, stop)

    def close(self) -> None:
        """Close the device."""
        os.close(self._device)

    def _axis(self, number: int) -> float:
        value = self._axes.get(number, 0.0)
        return value if abs(value) > DEAD_ZONE else 0.0
