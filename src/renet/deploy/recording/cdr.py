"""Common Data Representation (CDR), in which ROS 2 writes messages: little-endian, plain."""

import struct

ENCAPSULATION = b"\x00\x01\x00\x00"
"""First bytes of every message; alignment counts from their end."""


class CdrWriter:
    """Appends the fields of one message."""

    def __init__(self) -> None:
        self._payload = bytearray()

    def number(self, code: str, value: float) -> None:
        """Append a number of a format code of `struct`, aligned to its size."""
        size = struct.calcsize(code)
        self._payload += bytes(-len(self._payload) % size)
        self._payload += struct.pack(f"<{code}", value)

    def text(self, value: str) -> None:
        """Append a string, with its length and a closing zero."""
        self.octets(value.encode(errors="replace") + b"\x00")

    def octets(self, value: bytes) -> None:
        """Append a sequence of bytes, with its length."""
        self.number("I", len(value))
        self._payload += value

    def message(self) -> bytes:
        """The whole message."""
        return ENCAPSULATION + bytes(self._payload)


class CdrReader:
    """Reads the fields of one message in their order; raises ValueError where they end early."""

    def __init__(self, message: bytes) -> None:
        self._payload = payload_of(message)
        self._place = 0

    def number(self, code: str) -> int:
        """An integer of a format code of `struct`."""
        size = struct.calcsize(code)
        self._place += -self._place % size
        (value,) = struct.unpack(f"<{code}", self._take(size))
        return value

    def text(self) -> str:
        """A string."""
        return self.octets().removesuffix(b"\x00").decode()

    def octets(self) -> bytes:
        """A sequence of bytes."""
        return self._take(self.number("I"))

    def _take(self, size: int) -> bytes:
        taken = self._payload[self._place : self._place + size]
        if len(taken) < size:
            raise ValueError("a message ends early")
        self._place += size
        return taken


def payload_of(message: bytes) -> bytes:
    """A message without its encapsulation; raises ValueError for another representation."""
    if message[: len(ENCAPSULATION)] != ENCAPSULATION:
        raise ValueError("a message is not little-endian CDR")
    return message[len(ENCAPSULATION) :]
