"""Reader of recordings, which reads each as far as it is whole: up to an end that is torn or zeros.

The readers of the MCAP library need the index at the end of a file, or trust the lengths that it
states. Here every length is bounded before memory is allocated, and every chunk is checked.
"""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Annotated, Any, BinaryIO, TypedDict

import msgspec
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, McapRecord, Message, Schema
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC

from renet.deploy.cdr import payload_of
from renet.deploy.controller import Event
from renet.deploy.recording.channels import (
    LAST_SECOND,
    MAX_CHUNK,
    MESSAGE_TYPES,
    Topic,
    decode_event,
    decode_image,
)
from renet.deploy.recording.tick import BAD, MODES, POWER_DTYPE, TICK_DTYPE
from renet.errors import RenetError, reason
from renet.files import MEGABYTE, parse_json, require_regular

MAGIC = MCAP0_MAGIC
"""First bytes of every MCAP file."""
EARLIER = b"RENETLOG"
"""First bytes of recordings of renet 0.1, which were no MCAP files."""
RECORD = struct.Struct("<BQ")
"""Head of an MCAP record: opcode and length."""
_MAX_BYTES = 4000 * MEGABYTE
"""Largest recording, compressed, and most bytes of content that are read, for all of it is kept in
memory: those of 2.6 hours with a camera of 30 Hz, or of six with one of 10 Hz."""
FREE = 50 * MEGABYTE
"""Bytes that any recording may unpack to."""
_MAX_RATIO = 300
"""Bytes that it may unpack to besides, for each compressed byte. A walk has about 2, a simulated
robot that lies still with a covered camera up to 140; zeros have thousands."""
_MAX_DURATION = 1e6
"""Longest time from the first to the last tick, s."""
Number = Annotated[float, msgspec.Meta(gt=-1e15, lt=1e15)]
"""Number that a run may have written; NaN is refused."""


class Header(TypedDict, total=False):
    """Entries of a header that readers rely on, among others."""

    bundle: str | None
    bundle_sha256: str | None
    robot: str | None
    mode: str
    unseen: str
    told: str
    terrain: str | None
    level: Number | None
    dry_run: bool
    onsets: list[Number]
    fault: list[str]
    thresholds: dict[str, Number]


@dataclass(frozen=True)
class Recording:
    """Recorded run."""

    header: dict[str, Any]
    """Configuration of the run: bundle, limits, devices, faults."""
    ticks: np.ndarray
    """[T] of dtype `TICK_DTYPE`."""
    images: dict[int, np.ndarray]
    """Images [48, 64] float16, each by the tick at which it was new."""
    events: list[Event]
    """Transitions, in the order in which they were recorded."""
    complete: bool
    """True if the file is whole up to its end, and was read up to there."""
    power: np.ndarray = field(default_factory=lambda: np.zeros(0, POWER_DTYPE))
    """[N] of dtype `POWER_DTYPE`: temperatures, charge and voltage whenever one changed."""


def read_recording(path: Path | str) -> Recording:
    """Read a recording as far as it is whole, and at most 4 GB of its content.

    Raises:
        RenetError: The file is not a recording, has no header, or holds impossible values.
    """
    path = require_regular(Path(path), _MAX_BYTES, "recording")
    content = _Content()
    complete = False
    try:
        with path.open("rb") as file:
            _demand_mcap(file, path)
            for record in _records(file):
                complete = isinstance(record, DataEnd)
                content.take(record)
        return content.recording(complete)
    except OSError as error:
        raise RenetError(f"cannot read the recording {path}: {reason(error)}") from error
    except (ValueError, TypeError) as error:
        raise RenetError(
            f"the recording {path} is damaged, or of another version of renet: {error}"
        ) from error


def _demand_mcap(file: BinaryIO, path: Path) -> None:
    """Read the first bytes; raises RenetError for a file that is not MCAP."""
    magic = file.read(len(MAGIC))
    if magic == EARLIER:
        raise RenetError(f"{path} is a recording of renet 0.1: only that version reads it")
    if magic != MAGIC:
        raise RenetError(f"{path} is not a recording: give an MCAP file of `renet deploy`")


def _records(file: BinaryIO) -> Iterator[McapRecord]:
    """Yield schemas, channels and messages, up to one that is torn, damaged or too far on.

    The last record is a `DataEnd` if the file is whole up to its index.
    """
    packed = 0
    unpacked = 0
    while len(head := file.read(RECORD.size)) == RECORD.size:
        opcode, length = RECORD.unpack(head)
        data = file.read(min(length, MAX_CHUNK))
        # A power cut leaves zeros, or half a record.
        if opcode == 0 or len(data) < length:
            return
        if opcode == Opcode.DATA_END:
            yield DataEnd(0)
            return
        if opcode == Opcode.CHUNK:
            plain = _unpack(data)
            if plain is None:
                return
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
            plain = head + data
        else:
            continue
        # Indices between chunks, which do not compress, are not counted.
        packed += len(data)
        unpacked += len(plain)
        if unpacked > FREE + _MAX_RATIO * packed:
            raise ValueError("it unpacks to far more than its size")
        # The rest of a very long run is left out.
        if unpacked > _MAX_BYTES:
            return
        yield from _split(plain)


def _unpack(data: bytes) -> bytes | None:
    """Return the content of a chunk; None if it is damaged.

    Raises:
        ValueError: The chunk is larger than any of a run, or compressed in another way.
    """
    try:
        chunk = Chunk.read(ReadDataStream(BytesIO(data)))
        if chunk.compression not in ("", "zstd"):
            raise ValueError(f"its chunks are packed by {chunk.compression[:20]}, not zstd")
        if chunk.uncompressed_size > MAX_CHUNK:
            raise ValueError(f"a chunk unpacks to more than {MAX_CHUNK / MEGABYTE:g} MB")
        plain = chunk.data
        if chunk.compression:
            # A frame may state its own size, for which memory is allocated at once.
            stated = zstandard.frame_content_size(chunk.data)
            if stated not in (-1, chunk.uncompressed_size):
                return None
            limit = chunk.uncompressed_size
            plain = zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=limit)
    except (McapError, struct.error, UnicodeDecodeError, zstandard.ZstdError):
        return None
    whole = len(plain) == chunk.uncompressed_size
    # Zero stands for no checksum.
    intact = chunk.uncompressed_crc in (0, zlib.crc32(plain))
    return plain if whole and intact else None


def _split(plain: bytes) -> list[McapRecord]:
    """Split the content of a chunk into records; raises ValueError if it is none."""
    try:
        return breakup_chunk(Chunk("", plain, 0, 0, 0, len(plain)))
    except (McapError, struct.error, OverflowError) as error:
        raise ValueError("a chunk holds no whole records") from error


class _Content:
    """Collects the messages of a recording."""

    def __init__(self) -> None:
        self._types: dict[int, str] = {}
        """Topics whose messages schemas describe, by the schema's number."""
        self._topics: dict[int, str] = {}
        """Topics of channels, by the channel's number."""
        self._header: dict[str, Any] | None = None
        self._ticks: list[bytes] = []
        self._images: list[np.ndarray] = []
        self._events: list[tuple[int, str, str]] = []
        self._power: list[bytes] = []

    def take(self, record: McapRecord) -> None:
        """Add one record; raises ValueError for one that no run can have written."""
        if isinstance(record, Schema):
            self._types[record.id] = _topic_of(record)
        elif isinstance(record, Channel):
            # Topics of other programs may have any type.
            ours = record.topic in [*MESSAGE_TYPES]
            if ours and self._types.get(record.schema_id) != record.topic:
                raise ValueError(f"the messages of {record.topic} are of another type")
            self._topics[record.id] = record.topic
        elif isinstance(record, Message):
            if record.channel_id not in self._topics:
                raise ValueError(f"there is no channel {record.channel_id}")
            self._take_message(self._topics[record.channel_id], record.data)

    def _take_message(self, topic: str, message: bytes) -> None:
        """Add a message; a message of an unknown topic is left out."""
        if topic == Topic.RUN:
            self._header = _header(parse_json(message, "header"))
        elif topic == Topic.TICK:
            self._ticks.append(_record_of(message, TICK_DTYPE))
        elif topic == Topic.DEPTH:
            self._images.append(decode_image(message))
        elif topic == Topic.EVENTS:
            self._events.append(decode_event(message))
        elif topic == Topic.POWER:
            self._power.append(_record_of(message, POWER_DTYPE))

    def recording(self, complete: bool) -> Recording:
        """Assemble the run; raises ValueError for content that no run can have written."""
        if self._header is None:
            raise ValueError(
                "it has no readable header: another program wrote it, or nothing was saved"
            )
        # A view of a byte array can be changed, one of bytes cannot.
        ticks = np.frombuffer(bytearray().join(self._ticks), TICK_DTYPE)
        power = np.frombuffer(bytearray().join(self._power), POWER_DTYPE)
        _check(ticks, len(self._events))
        rows = np.flatnonzero(ticks["new_image"]).tolist()
        if not complete and len(self._images) == len(rows) + 1:
            # The file ends between the last image and its tick, which comes after it.
            self._images.pop()
        if len(rows) != len(self._images):
            raise ValueError(f"it has {len(self._images)} images in {len(rows)} ticks with one")
        images = dict(zip(rows, self._images, strict=True))
        events = _timed(self._events, ticks["now"])
        return Recording(self._header, ticks, images, events, complete, power)


def _topic_of(schema: Schema) -> str:
    """Return the topic whose messages a schema describes; empty for an unknown schema."""
    for topic, ours in MESSAGE_TYPES.items():
        if (schema.name, schema.data) == (ours.name, ours.definition.encode()):
            return topic
    return ""


def _record_of(message: bytes, layout: np.dtype) -> bytes:
    """Return the bytes of a record of `tick`; raises ValueError for a message of another size."""
    payload = payload_of(message)
    if len(payload) != layout.itemsize:
        raise ValueError(f"a message has {len(payload)} bytes in place of {layout.itemsize}")
    return payload


def _timed(events: list[tuple[int, str, str]], now: np.ndarray) -> list[Event]:
    """Return events with the exact times of their ticks.

    Args:
        events: Times in ns, names and reasons.
        now: Times of the ticks, [T] s.
    """
    stamps = np.rint(1e9 * np.clip(now, 0.0, LAST_SECOND)).astype(np.int64)
    timed = []
    for time, what, why in events:
        row = int(np.searchsorted(stamps, time))
        # A replay finds events by the exact time of their tick.
        of_tick = row < len(stamps) and stamps[row] == time
        seconds = float(now[row]) if of_tick else 1e-9 * time
        timed.append(Event(seconds, what, why))
    return timed


def _header(value: Any) -> dict[str, Any]:
    """Check a header; raises ValueError if an entry that readers rely on is of another type."""
    msgspec.convert(value, Header)
    return value


def _check(ticks: np.ndarray, events: int) -> None:
    """Raise ValueError for ticks, or a number of events, that no run can have written."""
    # Scores and replays rely on ascending times and on known codes.
    now = ticks["now"]
    if not np.isfinite(now).all() or (np.diff(now) < 0).any():
        raise ValueError("its times are not finite or run backwards")
    if len(now) and now[-1] - now[0] > _MAX_DURATION:
        raise ValueError(f"it lasts longer than {_MAX_DURATION:g} s")
    if (ticks["mode"] >= len(MODES)).any():
        raise ValueError(f"mode {ticks['mode'].max()} does not exist")
    if (ticks["state"] > BAD).any() or (ticks["frame"] > BAD).any():
        raise ValueError("a reading is neither absent, good nor bad")
    if events > 10 * len(ticks) + 1000:
        raise ValueError(f"it has {events} events in {len(ticks)} ticks")
