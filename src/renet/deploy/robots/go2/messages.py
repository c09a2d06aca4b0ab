"""The Go2's DDS messages: one table of fields gives DDS type, memory layout and CRC.

Fields, their order and the CRC are those of unitree_sdk2 (BSD-3). The robot runs Cyclone DDS
0.10.2, which crashes on type information as newer versions make it: `types.json` holds what
0.10.2 itself announces of each type.
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

from renet.errors import RenetError

U1, U2, U4, I2, I4, F4 = "u1", "<u2", "<u4", "<i2", "<i4", "<f4"
IDL = {U1: types.uint8, U2: types.uint16, U4: types.uint32}
IDL |= {I2: types.int16, I4: types.int32, F4: types.float32}
MODULE = "unitree_go.msg.dds_"
TYPES = Path(__file__).with_name("types.json")
"""By type, 0.10.2's TypeInformation and TypeMapping (XTypes 1.3), zlib and base64."""
TYPES_SHA256 = "343432cdda6f245986f3cd7db5b4ffe75037185c3d6cec5885bf86f86e44eed7"

Fields = tuple[tuple[str, Any, int], ...]
"""Name, type (of NumPy, or name and fields of a struct) and count of each."""

HEAD: Fields = (
    ("head", U1, 2),
    ("level_flag", U1, 1),
    ("frame_reserve", U1, 1),
    ("sn", U4, 2),
    ("version", U4, 2),
    ("bandwidth", U2, 1),
)
MOTOR_CMD: Fields = (
    ("mode", U1, 1),
    ("q", F4, 1),
    ("dq", F4, 1),
    ("tau", F4, 1),
    ("kp", F4, 1),
    ("kd", F4, 1),
    ("reserve", U4, 3),
)
LOW_CMD: Fields = (
    *HEAD,
    ("motor_cmd", ("MotorCmd_", MOTOR_CMD), 20),
    ("bms_cmd", ("BmsCmd_", (("off", U1, 1), ("reserve", U1, 3))), 1),
    ("wireless_remote", U1, 40),
    ("led", U1, 12),
    ("fan", U1, 2),
    ("gpio", U1, 1),
    ("reserve", U4, 1),
    ("crc", U4, 1),
)
IMU_STATE: Fields = (
    ("quaternion", F4, 4),
    ("gyroscope", F4, 3),
    ("accelerometer", F4, 3),
    ("rpy", F4, 3),
    ("temperature", U1, 1),
)
MOTOR_STATE: Fields = (
    ("mode", U1, 1),
    ("q", F4, 1),
    ("dq", F4, 1),
    ("ddq", F4, 1),
    ("tau_est", F4, 1),
    ("q_raw", F4, 1),
    ("dq_raw", F4, 1),
    ("ddq_raw", F4, 1),
    ("temperature", U1, 1),
    ("lost", U4, 1),
    ("reserve", U4, 2),
)
BMS_STATE: Fields = (
    ("version_high", U1, 1),
    ("version_low", U1, 1),
    ("status", U1, 1),
    ("soc", U1, 1),
    ("current", I4, 1),
    ("cycle", U2, 1),
    ("bq_ntc", U1, 2),
    ("mcu_ntc", U1, 2),
    ("cell_vol", U2, 15),
)
LOW_STATE: Fields = (
    *HEAD,
    ("imu_state", ("IMUState_", IMU_STATE), 1),
    ("motor_state", ("MotorState_", MOTOR_STATE), 20),
    ("bms_state", ("BmsState_", BMS_STATE), 1),
    ("foot_force", I2, 4),
    ("foot_force_est", I2, 4),
    ("tick", U4, 1),
    ("wireless_remote", U1, 40),
    ("bit_flag", U1, 1),
    ("adc_reel", F4, 1),
    ("temperature_ntc1", U1, 1),
    ("temperature_ntc2", U1, 1),
    ("power_v", F4, 1),
    ("power_a", F4, 1),
    ("fan_frequency", U2, 4),
    ("reserve", U4, 1),
    ("crc", U4, 1),
)
CDR = b"\0\1\0\0"
"""Header of a payload: plain CDR, little-endian."""
MIRRORED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def memory_layout(fields: Fields) -> np.dtype:
    """The C struct of a message, over which its CRC is computed."""
    entries = []
    for name, kind, count in fields:
        part = np.dtype(kind) if isinstance(kind, str) else memory_layout(kind[1])
        entries.append((name, part, (count,)) if count > 1 else (name, part))
    return np.dtype(entries, align=True)


def _numbers(layout: np.dtype, start: int = 0) -> Iterator[tuple[int, int, int]]:
    """Offset, size and count of the numbers of a C struct, in order."""
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
    """For each byte of a message's CDR payload its byte in the C struct; -1 for padding.

    CDR aligns every number to its size, from the payload's start, and ends structs unpadded.
    """
    order: list[int] = []
    for offset, size, count in _numbers(layout):
        order += [-1] * (-len(order) % size)
        order += range(offset, offset + size * count)
    return np.array(order)


def _idl(name: str, fields: Fields) -> type:
    members = {}
    for field, kind, count in fields:
        part: Any = IDL[kind] if isinstance(kind, str) else _idl(*kind)
        members[field] = types.array[part, count] if count > 1 else part
    return make_idl_struct(name, f"{MODULE}.{name}", members)


def message_type(name: str, fields: Fields) -> Any:
    """A DDS type whose samples are C structs.

    A sample has `values`, a record with the table's fields, and `raw`, the same memory as bytes;
    both are None where the payload was not one of this type. Making one without arguments gives
    zeros. Serialising is one gather: the library's own costs a fifth of a 2 ms period.
    """
    layout = memory_layout(fields)
    order = payload_order(layout)
    (places,), size = np.nonzero(order >= 0), len(order)
    bytes_ = order[places]
    base = _idl(name, fields)

    def initialize(self: Any) -> None:
        self.raw = np.zeros(layout.itemsize, np.uint8)
        self.values = self.raw.view(layout)[0]

    def serialize(self: Any, *arguments: Any, **options: Any) -> bytes:
        payload = np.zeros(size, np.uint8)
        payload[places] = self.raw[bytes_]
        return CDR + payload.tobytes()

    def deserialize(data: bytes, *arguments: Any, **options: Any) -> Any:
        sample = base()
        if data[:2] != CDR[:2] or len(data) < len(CDR) + size:
            sample.raw = sample.values = None
            return sample
        sample.raw[bytes_] = np.frombuffer(data, np.uint8, size, len(CDR))[places]
        return sample

    def deserialize_key(*arguments: Any, **options: Any) -> None:
        """No type here has a key; the library asks for it when a writer leaves."""

    base.__init__ = initialize
    base.serialize, base.deserialize = serialize, staticmethod(deserialize)
    base.deserialize_key = staticmethod(deserialize_key)
    return base


def crc(raw: np.ndarray) -> int:
    """The vendor's checksum of a C struct, which goes into its last four bytes.

    CRC-32 of the little-endian words before them, most significant bit first, not inverted at the
    end: zlib's with the bits of every byte, and of the result, in the other order.
    """
    words = raw.view("<u4")[:-1].astype(">u4").tobytes()
    value = zlib.crc32(words.translate(MIRRORED)) ^ 0xFFFFFFFF
    return int(f"{value:032b}"[::-1], 2)


def read_types(path: Path = TYPES, sha256: str = TYPES_SHA256) -> dict[str, tuple[bytes, bytes]]:
    """Type information and mapping to announce, by type; raises RenetError for a changed file."""
    content = path.read_bytes()
    if hashlib.sha256(content).hexdigest() != sha256:
        raise RenetError(f"{path} is damaged: install renet again")
    entries = json.loads(content).items()
    return {
        name: (zlib.decompress(base64.b64decode(a)), zlib.decompress(base64.b64decode(b)))
        for name, (a, b) in entries
    }


LowCmd = message_type("LowCmd_", LOW_CMD)
"""To the robot: a target for each of 20 motors, of which 0 to 11 are the legs'."""
LowState = message_type("LowState_", LOW_STATE)
"""From the robot, at 500 Hz."""
