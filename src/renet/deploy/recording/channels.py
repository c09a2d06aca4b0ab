"""Channels of a recording: topics, message types, and the encoding of values.

Messages are those of ROS 2 (`ros2msg` schemas, CDR), which Foxglove and rerun read without a
plug-in, and which keep NaN and every bit of a number, as JSON would not. Only the header is JSON.
"""

import json
import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import CompressionType, IndexType, Writer

from renet.deploy.cdr import ENCAPSULATION, CdrReader, CdrWriter
from renet.deploy.controller import Event
from renet.deploy.recording import tick
from renet.files import MEGABYTE
from renet.interface import DEPTH_SHAPE
from renet.selector.selector import REMEMBERS, SEES

MAX_CHUNK = 4 * MEGABYTE
"""Largest chunk that the reader accepts, bytes, compressed or not."""
CHUNK_SIZE = MEGABYTE
"""Size, bytes, at which the writer ends a chunk, after the message that exceeds it: a chunk has at
most `CHUNK_SIZE` and one message, well below `MAX_CHUNK`. A second of a run has 0.2 to 0.7 MB."""
_MAX_MESSAGE = MEGABYTE
"""Largest message, bytes; an image has 12 kB."""
MAX_REASON = 2000
"""Most characters of an event's reason; a driver's own errors may be of any length."""
LAST_SECOND = 2**31 - 1
"""Latest time that ROS 2 can express, s."""
_PIXEL_FORMAT = "32FC1"
"""Name in ROS 2 of images with one float32 a pixel."""
_INFO = 20
"""Level of normal events in `rcl_interfaces/msg/Log`."""
_WARN = 30
"""Level of warnings."""
_NORMAL_EVENTS = ("standing_up", "walking", SEES, REMEMBERS)
"""Events that are not recorded as warnings."""

_TIME_TYPE = """================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_IMAGE_TYPE = f"""std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_TIME_TYPE}"""
_LOG_TYPE = f"""builtin_interfaces/Time stamp
uint8 level
string name
string msg
string file
string function
uint32 line
{_TIME_TYPE}"""


class Topic(StrEnum):
    """Topics of a recording."""

    RUN = "/run"
    """Header: configuration of the run, as JSON without a schema."""
    TICK = "/tick"
    """Records of `tick.TICK_FIELDS`, one for each control tick."""
    DEPTH = "/depth"
    """Images, each before the tick at which it was new."""
    POWER = "/power"
    """Records of `tick.POWER_FIELDS`, wherever one of their values changed."""
    EVENTS = "/events"
    """Transitions, with their reasons."""


class MessageType(NamedTuple):
    """ROS 2 type of a topic's messages."""

    name: str
    definition: str


MESSAGE_TYPES = {
    Topic.TICK: MessageType("renet_msgs/msg/Tick", tick.definition(tick.TICK_FIELDS)),
    Topic.DEPTH: MessageType("sensor_msgs/msg/Image", _IMAGE_TYPE),
    Topic.POWER: MessageType("renet_msgs/msg/Power", tick.definition(tick.POWER_FIELDS)),
    Topic.EVENTS: MessageType("rcl_interfaces/msg/Log", _LOG_TYPE),
}


@dataclass(frozen=True)
class DepthImage:
    """Depth image as the policy sees it."""

    time: float
    """Time at which it was taken, s on the robot's clock."""
    image: np.ndarray
    """[48, 64] depth divided by the camera's range, 0 to 1."""


def nanoseconds(seconds: float) -> int:
    """Convert a time, s, to whole nanoseconds within the range of ROS 2; 0 for NaN."""
    if math.isnan(seconds):
        return 0
    return round(1e9 * min(max(seconds, 0.0), LAST_SECOND))


def encode(value: Any) -> bytes:
    """Encode a header (a dict), a record of `tick`, a `DepthImage` or an `Event`."""
    if isinstance(value, dict):
        return json.dumps(value).encode()
    if isinstance(value, DepthImage):
        return _encode_image(value)
    if isinstance(value, Event):
        return _encode_event(value)
    return ENCAPSULATION + value.tobytes()


def _encode_image(depth: DepthImage) -> bytes:
    """Encode a depth image as `sensor_msgs/msg/Image`."""
    height, width = DEPTH_SHAPE
    message = CdrWriter()
    _put_time(message, depth.time)
    message.text("camera")
    message.number("I", height)
    message.number("I", width)
    message.text(_PIXEL_FORMAT)
    # Little-endian.
    message.number("B", 0)
    message.number("I", 4 * width)
    message.octets(depth.image.astype("<f4").tobytes())
    return message.message()


def decode_image(message: bytes) -> np.ndarray:
    """Decode a depth image, [48, 64] float16; raises ValueError for another kind or size."""
    fields = CdrReader(message)
    _take_time(fields)
    fields.text()
    height = fields.number("I")
    width = fields.number("I")
    encoding = fields.text()
    big_endian = fields.number("B")
    fields.number("I")
    data = fields.octets()
    if (height, width) != DEPTH_SHAPE or encoding != _PIXEL_FORMAT or big_endian:
        raise ValueError(f"an image has {width} x {height} pixels {encoding}")
    if len(data) != 4 * height * width:
        raise ValueError(f"an image of {width} x {height} pixels has {len(data)} bytes")
    # Values beyond half precision become infinite, and are refused by the controller.
    with np.errstate(over="ignore"):
        return np.frombuffer(data, "<f4").reshape(DEPTH_SHAPE).astype(np.float16)


def _encode_event(event: Event) -> bytes:
    """Encode an event as `rcl_interfaces/msg/Log`."""
    message = CdrWriter()
    _put_time(message, event.time)
    message.number("B", _INFO if event.what in _NORMAL_EVENTS else _WARN)
    message.text(event.what)
    message.text(event.why[:MAX_REASON])
    # File, function and line of a program, which an event does not have.
    message.text("")
    message.text("")
    message.number("I", 0)
    return message.message()


def decode_event(message: bytes) -> tuple[int, str, str]:
    """Decode an event into time, ns, name and reason; raises ValueError for another message."""
    fields = CdrReader(message)
    time = _take_time(fields)
    fields.number("B")
    what = fields.text()
    why = fields.text()
    return time, what, why


def _put_time(message: CdrWriter, seconds: float) -> None:
    """Append a time, s, as `builtin_interfaces/Time`."""
    whole, rest = divmod(nanoseconds(seconds), 1_000_000_000)
    message.number("i", whole)
    message.number("I", rest)


def _take_time(fields: CdrReader) -> int:
    """Read a time, ns."""
    whole = fields.number("i")
    return 1_000_000_000 * whole + fields.number("I")


class ChannelWriter:
    """Writes messages into MCAP, in chunks that end at each `flush`."""

    def __init__(self, stream: BinaryIO) -> None:
        """Begin a file; raises OSError if it cannot be written."""
        self._mcap = Writer(
            stream,
            chunk_size=CHUNK_SIZE,
            compression=CompressionType.ZSTD,
            index_types=IndexType.CHUNK | IndexType.MESSAGE,
        )
        self._mcap.start()
        # The header needs no schema; each other topic has its own.
        run = self._mcap.register_channel(Topic.RUN, MessageEncoding.JSON, 0)
        self._channels: dict[str, int] = {Topic.RUN: run}
        for topic, message_type in MESSAGE_TYPES.items():
            text = message_type.definition.encode()
            number = self._mcap.register_schema(message_type.name, SchemaEncoding.ROS2, text)
            channel = self._mcap.register_channel(topic, MessageEncoding.CDR, number)
            self._channels[topic] = channel

    def write(self, topic: str, time: float, message: bytes) -> None:
        """Add a message, which reaches the stream with its chunk, at the latest at `flush`.

        Args:
            topic: Name of the message's topic.
            time: Time on the robot's clock, s.
            message: Bytes as returned by `encode`.

        Raises:
            ValueError: The message is larger than the reader accepts.
            OSError: The stream cannot be written.
        """
        if len(message) > _MAX_MESSAGE:
            raise ValueError(f"a message of {topic} has more than {_MAX_MESSAGE / MEGABYTE:g} MB")
        stamp = nanoseconds(time)
        self._mcap.add_message(self._channels[topic], stamp, message, stamp)

    def flush(self) -> None:
        """Write a chunk of the messages since the last one; raises OSError."""
        self._mcap.flush()

    def finish(self) -> None:
        """Write the index that viewers need to jump in time; raises OSError."""
        self._mcap.finish()
