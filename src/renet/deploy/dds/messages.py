"""DDS messages: one table of fields gives DDS type and memory layout.

A Go2 runs Cyclone DDS 0.10.2, which crashes on type information as newer versions make it:
`types.json` holds what 0.10.2 itself announces of each type. That of `TwistStamped_` is made by
11.0.1, whose `Twist_` is 0.10.2's to the byte: the two versions differ in numbers of eight bits,
which neither has.
"""

import base64
import hashlib
import json
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from cyclonedds.idl import make_idl_struct, types

from renet.deploy.cdr import ENCAPSULATION
from renet.errors import RenetError

IDL = {"u1": types.uint8, "<u2": types.uint16, "<u4": types.uint32}
IDL |= {"<i2": types.int16, "<i4": types.int32, "<f4": types.float32, "<f8": types.float64}
TYPES_FILE = Path(__file__).with_name("types.json")
"""By type, TypeInformation and TypeMapping (XTypes 1.3), zlib and base64."""
TYPES_SHA256 = "1218d16d00de7d36ffa4eb66a308ac2495f8313d16a45489db4b227b34a5bf95"

Fields = tuple[tuple[str, Any, int], ...]
"""Name, type (of NumPy, or name and fields of a struct) and count of each field."""


def parse_fields(text: str, **structs: Fields) -> Fields:
    """Parse fields from their types, names and counts, as C writes them; types may be `structs`."""
    fields = []
    for kind, name, *count in map(str.split, text.replace("[", " ").replace("]", "").split(",")):
        part = (kind, structs[kind]) if kind in structs else np.dtype(f"<{kind}").str.lstrip("|")
        fields.append((name, part, int(*count or (1,))))
    return tuple(fields)


def memory_layout(fields: Fields) -> np.dtype:
    """Return the C struct of a message, over which its CRC is computed."""
    entries = []
    for name, kind, count in fields:
        part = np.dtype(kind) if isinstance(kind, str) else memory_layout(kind[1])
        entries.append((name, part, (count,)) if count > 1 else (name, part))
    return np.dtype(entries, align=True)


def _numbers(layout: np.dtype, start: int = 0) -> Iterator[tuple[int, int, int]]:
    """Yield offset, size and count of the numbers of a C struct, in order."""
    for name in layout.names or ():
        part, offset = layout.fields[name][:2]  # type: ignore[index]
        element, shape = part.subdtype or (part, (1,))
        at = start + offset
        if element.names is None:
            yield at, element.itemsize, shape[0]
            continue
        for n in range(shape[0]):
            yield from _numbers(element, at + n * element.itemsize)


def payload_order(layout: np.dtype) -> np.ndarray:
    """Return, for each byte of a message's CDR payload, its byte in the C struct; -1 is padding.

    CDR aligns every number to its size, from the payload's start, and ends structs unpadded.
    """
    order: list[int] = []
    for offset, size, count in _numbers(layout):
        order += [-1] * (-len(order) % size)
        order += range(offset, offset + size * count)
    return np.array(order)


def _idl(name: str, fields: Fields, module: str) -> type:
    members = {}
    for field, kind, count in fields:
        part: Any = IDL[kind] if isinstance(kind, str) else _idl(kind[0], kind[1], module)
        members[field] = types.array[part, count] if count > 1 else part
    return make_idl_struct(name, f"{module}.{name}", members)


def message_type(name: str, fields: Fields, module: str) -> Any:
    """Make a DDS type whose samples are C structs.

    A sample has `values`, a record with the table's fields, and `raw`, the same memory as bytes.
    Both are None if the payload was none of this type. A new sample is all zeros. Samples are
    serialised by one gather, because the library's own way costs a fifth of a 2 ms period.
    """
    layout = memory_layout(fields)
    order = payload_order(layout)
    size = len(order)
    (places,) = np.nonzero(order >= 0)
    bytes_ = order[places]
    base = _idl(name, fields, module)

    def initialize(self: Any) -> None:
        self.raw = np.zeros(layout.itemsize, np.uint8)
        self.values = self.raw.view(layout)[0]

    def serialize(self: Any, *arguments: Any, **options: Any) -> bytes:
        payload = np.zeros(size, np.uint8)
        payload[places] = self.raw[bytes_]
        return ENCAPSULATION + payload.tobytes()

    def deserialize(data: bytes, *arguments: Any, **options: Any) -> Any:
        sample = base()
        # Another encoding, or a payload that was cut.
        if data[:2] != ENCAPSULATION[:2] or len(data) < len(ENCAPSULATION) + size:
            sample.raw = sample.values = None
            return sample
        sample.raw[bytes_] = np.frombuffer(data, np.uint8, size, len(ENCAPSULATION))[places]
        return sample

    def deserialize_key(*arguments: Any, **options: Any) -> None:
        """No type here has a key; the library asks for it when a writer leaves."""

    base.__init__ = initialize
    base.serialize = serialize
    base.deserialize = staticmethod(deserialize)
    base.deserialize_key = staticmethod(deserialize_key)
    return base


def read_types(path: Path = TYPES_FILE) -> dict[str, tuple[bytes, bytes]]:
    """Read the type information and mapping to announce, by type; raises RenetError if damaged."""
    content = path.read_bytes()
    if hashlib.sha256(content).hexdigest() != TYPES_SHA256:
        raise RenetError(f"{path} is damaged: install renet again")
    found = {}
    for name, (information, mapping) in json.loads(content).items():
        found[name] = (
            zlib.decompress(base64.b64decode(information)),
            zlib.decompress(base64.b64decode(mapping)),
        )
    return found
