"""Gamepads made of a pipe, which answer the kernel's questions as two real drivers do."""

import array
import errno
import fcntl
import os
import struct
from pathlib import Path

import pytest

from renet.deploy.teleop import gamepad

CODES = {
    **{"ABS_X": 0, "ABS_Y": 1, "ABS_Z": 2, "ABS_RX": 3, "ABS_RY": 4, "ABS_RZ": 5},
    **{"ABS_HAT0X": 0x10, "ABS_HAT0Y": 0x11, "BTN_SOUTH": 0x130, "BTN_EAST": 0x131},
    **{"BTN_C": 0x132, "BTN_NORTH": 0x133, "BTN_WEST": 0x134, "BTN_Z": 0x135, "BTN_TL": 0x136},
    **{"BTN_TR": 0x137, "BTN_TL2": 0x138, "BTN_TR2": 0x139, "BTN_SELECT": 0x13A},
    **{"BTN_START": 0x13B, "BTN_MODE": 0x13C, "BTN_THUMBL": 0x13D, "BTN_THUMBR": 0x13E},
    **{"BTN_TRIGGER": 0x120, "BTN_THUMB": 0x121, "BTN_THUMB2": 0x122, "BTN_TOP": 0x123},
}
"""Of linux/input-event-codes.h."""
STICKS = ["ABS_X", "ABS_Y", "ABS_Z", "ABS_RX", "ABS_RY", "ABS_RZ", "ABS_HAT0X", "ABS_HAT0Y"]
FACES = ["BTN_SOUTH", "BTN_EAST", "BTN_NORTH", "BTN_WEST", "BTN_TL", "BTN_TR"]
ENDS = ["BTN_SELECT", "BTN_START", "BTN_MODE", "BTN_THUMBL", "BTN_THUMBR"]
XBOX = ("Microsoft X-Box 360 pad", STICKS, [*FACES, *ENDS])
"""What the driver xpad tells: name, sticks and buttons in the order of their numbers."""
PLAYSTATION = ("Sony DualSense", STICKS, [*FACES, "BTN_TL2", "BTN_TR2", *ENDS])
"""What hid-playstation tells."""
UNNAMED = ("Old USB stick", ["ABS_X", "ABS_Y", "ABS_Z"], ["BTN_TRIGGER", "BTN_THUMB", "BTN_THUMB2"])
"""What the kernel tells of a pad without a driver of its own."""


class Pad:
    """A gamepad whose events are written here."""

    def __init__(self, path: Path, title: str, axes: list[str], buttons: list[str]) -> None:
        os.mkfifo(path)
        self.path, self.title = path, title
        self.axes, self.buttons = axes, buttons
        # Open for both, so that opening it waits for no reader.
        self._writer = os.open(path, os.O_RDWR)

    def move(self, axis: str, value: int) -> None:
        self._write(value, 2, self.axes.index(axis))

    def press(self, button: str, value: int = 1, repeated: bool = False) -> None:
        self._write(value, 1 | 0x80 * repeated, self.buttons.index(button))

    def unplug(self) -> None:
        os.close(self._writer)

    def _write(self, value: int, kind: int, number: int) -> None:
        os.write(self._writer, struct.pack("<IhBB", 0, value, kind, number))

    def answer(self, request: int, buffer: array.array) -> None:
        """As joydev.c: numbers that a pad lacks stay zero."""
        direction, size = request >> 30, request >> 16 & 0x3FFF
        kind, number = chr(request >> 8 & 0xFF), request & 0xFF
        assert (direction, kind, size) == (2, "j", buffer.itemsize * len(buffer))
        answers = {
            0x11: [len(self.axes)],
            0x12: [len(self.buttons)],
            0x13: self.title.encode() + b"\0",
            0x32: [CODES[axis] for axis in self.axes],
            0x34: [CODES[button] for button in self.buttons],
        }
        for place, value in enumerate(answers[number]):
            buffer[place] = value


def plugged(folder: Path, monkeypatch: pytest.MonkeyPatch, *pads: tuple) -> Pad:
    """Plug pads in, as js0, js1 and so on; returns the last."""
    made = [Pad(folder / f"js{number}", *pad) for number, pad in enumerate(pads)]

    def ioctl(descriptor: int, request: int, buffer: array.array, mutate: bool) -> int:
        for pad in made:
            if os.path.sameopenfile(descriptor, pad._writer):
                pad.answer(request, buffer)
                return 0
        raise OSError(errno.ENOTTY, "Inappropriate ioctl for device")

    monkeypatch.setattr(gamepad, "DEVICES", str(folder / "js*"))
    monkeypatch.setattr(fcntl, "ioctl", ioctl)
    return made[-1]
