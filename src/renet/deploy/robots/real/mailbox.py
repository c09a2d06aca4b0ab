"""Shared memory of a controller and the process that talks to its robot."""

import mmap
import time
import zlib

import numpy as np

from renet.deploy.robots.base import VECTORS
from renet.interface import ACTION_SIZE

ALIVE_LAYOUT = np.dtype([("time", "f8")])
"""Sign of life of the controller."""
COMMAND_LAYOUT = np.dtype(
    [("time", "f8"), ("position", "f8", 12), ("stiffness", "f8", 12), ("damping", "f8", 12)]
)
"""Command of the controller."""
_NUMBERS = [
    ("time", "f8"),
    *((name, "f8", size) for name, size in VECTORS.items()),
    ("temperature", "f8", ACTION_SIZE),
    ("battery", "f8"),
    ("voltage", "f8"),
]
"""Fields of a `RobotState` that are numbers."""
VALUES = tuple(entry[0] for entry in _NUMBERS)
"""Names of these fields."""
_TEXTS = [("fault", "S100"), ("problem", "S400"), ("refused", "S400")]
READING_LAYOUT = np.dtype([("valid", "?"), *_NUMBERS, *_TEXTS])
"""Reading and problems of the sender."""
SIZE = 4096
"""Size of the shared memory, bytes."""


def clock() -> float:
    """Return the time of a clock that all processes share and that goes on during sleep, s."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


class Mailbox:
    """Newest value of a fixed layout in memory that two processes share.

    It has one writer, one reader and no lock, so that one process goes on if the other dies or
    stops in the middle of a write or read. A value that is half written fails its checksum.
    """

    def __init__(self, memory: mmap.mmap, offset: int, layout: np.dtype) -> None:
        """Use `memory` from the byte `offset` on."""
        self._memory = memory
        self._offset = offset
        self._layout = layout
        # A CRC of four bytes follows the value.
        self.end = offset + layout.itemsize + 4
        """First byte after the mailbox."""
        self._value: np.ndarray | None = None

    def write(self, value: np.ndarray) -> None:
        """Replace the value by a scalar array of the layout."""
        data = value.tobytes()
        self._memory[self._offset : self.end] = data + zlib.crc32(data).to_bytes(4, "little")

    def read(self) -> np.ndarray | None:
        """Return the newest whole value; None before the first."""
        for _ in range(3):
            # The writer may be in the middle of a write, which does not take long.
            raw = self._memory[self._offset : self.end]
            if zlib.crc32(raw[:-4]) == int.from_bytes(raw[-4:], "little"):
                self._value = np.frombuffer(raw, self._layout, 1)[0]
                break
        return self._value


def mailboxes(memory: mmap.mmap) -> tuple[Mailbox, Mailbox, Mailbox]:
    """Lay out mailboxes for the controller's signs of life and commands, and for readings."""
    alive = Mailbox(memory, 0, ALIVE_LAYOUT)
    commands = Mailbox(memory, alive.end, COMMAND_LAYOUT)
    return alive, commands, Mailbox(memory, commands.end, READING_LAYOUT)
