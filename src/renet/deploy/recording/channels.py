"""Channels of a recording: its topics, the types of their messages, and how values become bytes.

Messages are ROS 2's (`ros2msg` schemas, CDR), which Foxglove and rerun read without a plug-in and
which hold NaN and every bit of a number, as JSON would not. Only the header is JSON.
"""

import json
import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import CompressionType, IndexType, Writer

from renet.deploy.controller import Event
from renet.deploy.recording import tick
from renet.deploy.recording.cdr import ENCAPSULATION, CdrReader, CdrWriter
from renet.files import MEGABYTE
from renet.interface import DEPTH_SHAPE
from renet.selector.selector import REMEMBERS, SEES

MAX_CHUNK = 4 * MEGABYTE
"""Bytes of a chunk that the reader accepts, packed or not."""
CHUNK_SIZE = MEGABYTE
"""Bytes at which the writer ends a chunk: after the message that passes it, so that a chunk has at
most `CHUNK_SIZE` and one message, well below `MAX_CHUNK`. A second of a run has 0.2 to 0.7 MB."""
MAX_MESSAGE = MEGABYTE
"""Bytes of a message; an image has 12 kB."""
MAX_TEXT = 2000
"""Characters of an event's reason; a driver's own errors may be of any length."""
LAST_SECOND = 2**31 - 1
"""Of the times that ROS 2 can express."""
PIXELS = "32FC1"
"""ROS 2's name of images of one float32 a pixel."""
INFO, WARN = 20, 30
"""Levels of `rcl_interfaces/msg/Log`."""
QUIET = ("standing_up", "walking", SEES, REMEMBERS)
"""Events that are no warning."""

TIME = """================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
IMAGE_DEFINITION = f"""std_msgs/Header header
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
{TIME}"""
LOG_DEFINITION = f"""builtin_interfaces/Time stamp
uint8 level
string name
string msg
string file
string function
uint32 line
{TIME}"""


class Topic(StrEnum):
    """Topics of a recording."""

    RUN = "/run"
    """Header: what ran, as JSON without a schema."""
    TICK = "/tick"
    """Records of `tick.TICK_FIELDS`, one a control tick."""
    DEPTH = "/depth"
    """Images, each before the tick with which it came."""
    POWER = "/power"
    """Records of `tick.POWER_FIELDS`, wherever one of their values changed."""
    EVENTS = "/events"
    """Transitions, with their reasons."""


class MessageType(NamedTuple):
    """Type of a topic's messages in ROS 2."""

    name: str
    definition: str


MESSAGE_TYPES = {
    Topic.TICK: MessageType("renet_msgs/msg/Tick", tick.definition(tick.TICK_FIELDS)),
    Topic.DEPTH: MessageType("sensor_msgs/msg/Image", IMAGE_DEFINITION),
    Topic.POWER: MessageType("renet_msgs/msg/Power", tick.definition(tick.POWER_FIELDS)),
    Topic.EVENTS: MessageType("rcl_interfaces/msg/Log", LOG_DEFINITION),
}


@dataclass(frozen=True)
class DepthImage:
    """A depth image as the policy sees it."""

    time: float
    """Seconds on the robot's clock at which it was taken."""
    image: np.ndarray
    """[48, 64] depth divided by the camera's range, 0 to 1."""


def nanoseconds(seconds: float) -> int:
    """Time in whole nanoseconds, from 0 to the last that ROS 2 can express; 0 for NaN."""
    if math.isnan(seconds):
        return 0
    return round(1e9 * min(max(seconds, 0.0), LAST_SECOND))


def encode(value: Any) -> bytes:
    """Message of a header (a dict), a record of `tick`, a `DepthImage` or an `Event`."""
    if isinstance(value, dict):
        return json.dumps(value).encode()
    if isinstance(value, DepthImage):
        return _encode_image(value)
    if isinstance(value, Event):
        return _encode_event(value)
    return ENCAPSULATION + value.tobytes()


def _encode_image(depth: DepthImage) -> bytes:
    height, width = DEPTH_SHAPE
    message = CdrWriter()
    _put_time(message, depth.time)
    message.text("camera")
    message.number("I", height)
    message.number("I", width)
    message.text(PIXELS)
    message.number("B", 0)  # Little-endian.
    message.number("I", 4 * width)
    message.octets(depth.image.astype("<f4").tobytes())
    return message.message()


def decode_image(message: bytes) -> np.ndarray:
    """Image [48, 64] float16 of a message; raises ValueError for one of another kind or size."""
    fields = CdrReader(message)
    _take_time(fields)
    fields.text()
    height = fields.number("I")
    width = fields.number("I")
    encoding = fields.text()
    big_endian = fields.number("B")
    fields.number("I")
    data = fields.octets()
    if (height, width) != DEPTH_SHAPE or encoding != PIXELS or big_endian:
        raise ValueError(f"an image has {width} x {height} pixels {encoding}")
    if len(data) != 4 * height * width:
        raise ValueError(f"an image of {width} x {height} pixels has {len(data)} bytes")
    with np.errstate(over="ignore"):
        return np.frombuffer(data, "<f4").reshape(DEPTH_SHAPE).astype(np.float16)


def _encode_event(event: Event) -> bytes:
    message = CdrWriter()
    _put_time(message, event.time)
    message.number("B", INFO if event.what in QUIET else WARN)
    message.text(event.what)
    message.text(event.why[:MAX_TEXT])
    # No place in a program.
    message.text("")
    message.text("")
    message.number("I", 0)
    return message.message()


def decode_event(message: bytes) -> tuple[int, str, str]:
    """Time of an event in ns, what happened and why; raises ValueError for no event."""
    fields = CdrReader(message)
    time = _take_time(fields)
    fields.number("B")
    what = fields.text()
    why = fields.text()
    return time, what, why


def _put_time(message: CdrWriter, seconds: float) -> None:
    whole, rest = divmod(nanoseconds(seconds), 1_000_000_000)
    message.number("i", whole)
    message.number("I", rest)


def _take_time(fields: CdrReader) -> int:
    """Nanoseconds."""
    whole = fields.number("i")
    return 1_000_000_000 * whole + fields.number("I")


class ChannelWriter:
    """Writes messages into MCAP, in chunks that end at each `flush`."""

    def __init__(self, stream: BinaryIO) -> None:
        """Begin a file; raises OSError where it cannot be written."""
        self._mcap = Writer(
            stream,
            chunk_size=CHUNK_SIZE,
            compression=CompressionType.ZSTD,
            index_types=IndexType.CHUNK | IndexType.MESSAGE,
        )
        self._mcap.start()
        run = self._mcap.register_channel(Topic.RUN, MessageEncoding.JSON, 0)
        self._channels: dict[str, int] = {Topic.RUN: run}
        for topic, message_type in MESSAGE_TYPES.items():
            text = message_type.definition.encode()
            number = self._mcap.register_schema(message_type.name, SchemaEncoding.ROS2, text)
            channel = self._mcap.register_channel(topic, MessageEncoding.CDR, number)
            self._channels[topic] = channel

    def write(self, topic: str, time: float, message: bytes) -> None:
        """Add a message; it reaches the stream with its chunk, at the latest at `flush`.

        Args:
            topic: of the message.
            time: seconds on the robot's clock.
            message: as `encode` returns it.

        Raises:
            ValueError: the message is larger than the reader accepts.
            OSError: the stream cannot be written.
        """
        if len(message) > MAX_MESSAGE:
            raise ValueError(f"a message of {topic} has more than {MAX_MESSAGE / MEGABYTE:g} MB")
        stamp = nanoseconds(time)
        self._mcap.add_message(self._channels[topic], stamp, message, stamp)

    def flush(self) -> None:
        """Write a chunk of all messages since the last one; raises OSError."""
        self._mcap.flush()

    def finish(self) -> None:
        """Write the index that viewers need to jump in time; raises OSError."""
        self._mcap.finish()
