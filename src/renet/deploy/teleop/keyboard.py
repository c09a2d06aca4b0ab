"""Keyboard of a terminal as an operator's device."""

import math
import os
import select
import sys
import termios
import tty
from contextlib import suppress
from dataclasses import dataclass

from renet.deploy.teleop.base import MAX_INPUT, Deadman, TeleopCommand
from renet.errors import RenetError
from renet.interface import MAX_REVERSE, MAX_SIDEWAYS, MAX_SPEED, MAX_TURN

SPEED_STEP = 0.1
"""Change of a speed by one key, m/s."""
TURN_STEP = 0.2
"""Change of the turn rate by one key, rad/s."""


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
