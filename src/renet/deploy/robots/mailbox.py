"""The newest value of a fixed layout in memory that two processes share."""

import mmap
import zlib

import numpy as np


class Mailbox:
    """One writer, one reader, no lock: a torn value fails its check and is no value.

    Whichever process dies or stops in the middle of a write or a read, the other goes on.
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
