"""Common Data Representation (CDR) of ROS 2 messages, in its plain little-endian form."""

import struct

ENCAPSULATION = b"\x00\x01\x00\x00"
"""First bytes of every message; alignment counts from their end."""


class CdrWriter:
    """Writes the fields of one message, one after the other."""

    def __init__(self) -> None:
        self._payload = bytearray()

    def number(self, code: str, value: float) -> None:
        """Append a number of a format code of `struct`, aligned to its size."""
        size = struct.calcsize(code)
        # Padding up to a multiple of the size.
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
        """Bytes of the whole message."""
        return ENCAPSULATION + bytes(self._payload)


class CdrReader:
    """Reads the fields of one message in their order; raises ValueError where it ends early."""

    def __init__(self, message: bytes) -> None:
        self._payload = payload_of(message)
        self._place = 0

    def number(self, code: str) -> int:
        """Read an integer of a format code of `struct`."""
        size = struct.calcsize(code)
        # Padding up to a multiple of the size.
        self._place += -self._place % size
        (value,) = struct.unpack(f"<{code}", self._take(size))
        return value

    def text(self) -> str:
        """Read a string."""
        return self.octets().removesuffix(b"\x00").decode()

    def octets(self) -> bytes:
        """Read a sequence of bytes."""
        return self._take(self.number("I"))

    def _take(self, size: int) -> bytes:
        taken = self._payload[self._place : self._place + size]
        if len(taken) < size:
            raise ValueError("a message ends early")
        self._place += size
        return taken


def payload_of(message: bytes) -> bytes:
    """Bytes of a message after its encapsulation; raises ValueError for another representation."""
    if message[: len(ENCAPSULATION)] != ENCAPSULATION:
        raise ValueError("a message is not little-endian CDR")
    return message[len(ENCAPSULATION) :]
