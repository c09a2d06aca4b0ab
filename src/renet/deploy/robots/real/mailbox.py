"""Memory that a controller and the process that talks to its robot share."""

import mmap
import time
import zlib

import numpy as np

from renet.deploy.robots.base import VECTORS
from renet.interface import ACTION_SIZE

ALIVE = np.dtype([("time", "f8")])
COMMAND = np.dtype(
    [("time", "f8"), ("position", "f8", 12), ("stiffness", "f8", 12), ("damping", "f8", 12)]
)
NUMBERS = [
    ("time", "f8"),
    *((name, "f8", size) for name, size in VECTORS.items()),
    ("temperature", "f8", ACTION_SIZE),
    ("battery", "f8"),
    ("voltage", "f8"),
]
"""Fields of a `RobotState` that are numbers."""
VALUES = tuple(entry[0] for entry in NUMBERS)
TEXTS = [("fault", "S100"), ("problem", "S400"), ("refused", "S400")]
READING = np.dtype([("valid", "?"), *NUMBERS, *TEXTS])
SIZE = 4096


def clock() -> float:
    """Seconds, the same in all processes; they go on while the computer sleeps."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


class Mailbox:
    """The newest value of a fixed layout in memory that two processes share.

    One writer, one reader, no lock: a torn value fails its check and is no value. Whichever process
    dies or stops in the middle of a write or a read, the other goes on.
    """

    def __init__(self, memory: mmap.mmap, offset: int, layout: np.dtype) -> None:
        self._memory, self._offset, self._layout = memory, offset, layout
        self.end = offset + layout.itemsize + 4
        """First byte after it."""
        self._value: np.ndarray | None = None

    def write(self, value: np.ndarray) -> None:
        """Replace the value, a scalar array of the layout."""
        data = value.tobytes()
        self._memory[self._offset : self.end] = data + zlib.crc32(data).to_bytes(4, "little")

    def read(self) -> np.ndarray | None:
        """The newest whole value; None before the first."""
        for _ in range(3):
            raw = self._memory[self._offset : self.end]
            if zlib.crc32(raw[:-4]) == int.from_bytes(raw[-4:], "little"):
                self._value = np.frombuffer(raw, self._layout, 1)[0]
                break
        return self._value


def mailboxes(memory: mmap.mmap) -> tuple[Mailbox, Mailbox, Mailbox]:
    """Signs of life and commands of the controller, readings of the sender."""
    alive = Mailbox(memory, 0, ALIVE)
    commands = Mailbox(memory, alive.end, COMMAND)
    return alive, commands, Mailbox(memory, commands.end, READING)
