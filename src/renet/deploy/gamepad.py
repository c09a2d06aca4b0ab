"""Gamepads by the kernel's names of their sticks and buttons, through Linux' joystick interface.

Every pad numbers its buttons in its own order: number 7 starts an Xbox pad and is a PlayStation
pad's trigger. Drivers also say which stick or button of `linux/input-event-codes.h` each number is.
"""

import array
import fcntl
import os
import struct
from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass
from glob import glob

from renet.errors import RenetError, printable

DEVICES = "/dev/input/js*"
AXES = {0x00: "ABS_X", 0x01: "ABS_Y", 0x03: "ABS_RX", 0x04: "ABS_RY"}
"""Names of the sticks by their codes."""
BUTTONS = {0x130: "BTN_SOUTH", 0x131: "BTN_EAST", 0x13B: "BTN_START"}
"""Names of the buttons in use by their codes."""
EVENT = struct.Struct("<IhBB")
"""Time, value, kind and number: `struct js_event` of `linux/joystick.h`."""
BUTTON, AXIS, REPEATED = 0x01, 0x02, 0x80
FULL = 32767.0
"""A stick's value at its end; the kernel scales all pads to it."""
MAX_INPUT = 4096
"""Bytes of keys or events read in one control step; the rest waits for the next."""
FIRST_BUTTON, LAST_BUTTON, ALL_AXES = 0x100, 0x2FF, 0x40
NAME_SIZE = 128


def _read_request(number: int, size: int) -> int:
    """An ioctl's request by which the kernel writes `size` bytes: `_IOR('j', number, …)`."""
    return 2 << 30 | size << 16 | ord("j") << 8 | number


AXIS_COUNT = _read_request(0x11, 1)
BUTTON_COUNT = _read_request(0x12, 1)
NAME = _read_request(0x13, NAME_SIZE)
AXIS_MAP = _read_request(0x32, ALL_AXES)
BUTTON_MAP = _read_request(0x34, 2 * (LAST_BUTTON - FIRST_BUTTON + 1))


@dataclass(frozen=True)
class PadEvent:
    """A stick that moved, or a button."""

    name: str
    """The kernel's; empty for what is of no use here."""
    axis: bool
    value: float
    """-1 to 1 of a stick; 1 of a button that is pressed, 0 of one that is let go."""
    repeated: bool
    """The kernel tells where it is, as at the start: nobody may have touched it."""


class Gamepad:
    """An open gamepad."""

    def __init__(self, path: str) -> None:
        """Open a device; raises OSError if that fails or it is no joystick."""
        self._device = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        try:
            self.title = self._ask(NAME, "B").tobytes().split(b"\0")[0].decode(errors="replace")
            axes = self._ask(AXIS_MAP, "B")[: self._ask(AXIS_COUNT, "B")[0]]
            buttons = self._ask(BUTTON_MAP, "H")[: self._ask(BUTTON_COUNT, "B")[0]]
        except OSError:
            self.close()
            raise
        self._axes = [AXES.get(code, "") for code in axes]
        self._buttons = [BUTTONS.get(code, "") for code in buttons]

    @staticmethod
    def find(names: Collection[str]) -> "Gamepad":
        """Open the first that has sticks and buttons of all these names.

        Raises:
            RenetError: there is none, or none has them all.
        """
        problem = f"no gamepad at {DEVICES}: connect one (in a container, pass it /dev/input)"
        for path in sorted(glob(DEVICES)):
            try:
                pad = Gamepad(path)
            except OSError as error:
                problem = f"cannot read the gamepad {path}: {error.strerror}"
                continue
            missing = pad.missing(names)
            if not missing:
                return pad
            pad.close()
            problem = (
                f"{path} ({printable(pad.title)}) has no {', '.join(missing)}: take a pad whose "
                "driver names its buttons, such as an Xbox or a PlayStation pad"
            )
        raise RenetError(problem)

    def missing(self, names: Collection[str]) -> list[str]:
        """Those of the names that no stick or button of this one has."""
        return [name for name in names if name not in self._axes + self._buttons]

    def events(self) -> Iterator[PadEvent]:
        """What happened since the last call; raises OSError once the pad is gone."""
        data = b""
        with suppress(BlockingIOError):  # Nothing new.
            data = os.read(self._device, MAX_INPUT // EVENT.size * EVENT.size)
            if not data or len(data) % EVENT.size:
                raise OSError("the gamepad is gone")
        for _, value, kind, number in EVENT.iter_unpack(data):
            axis = kind & ~REPEATED == AXIS
            known = self._axes if axis else self._buttons
            name = known[number] if number < len(known) else ""
            yield PadEvent(name, axis, value / FULL if axis else value, bool(kind & REPEATED))

    def close(self) -> None:
        """Close the device."""
        os.close(self._device)

    def _ask(self, request: int, kind: str) -> array.array:
        """Numbers of a kind of the module `array` that the kernel writes for a request."""
        size = request >> 16 & 0x3FFF
        answer = array.array(kind, bytes(size))
        fcntl.ioctl(self._device, request, answer, True)
        return answer
