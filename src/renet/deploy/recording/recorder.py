"""Records every control tick, so that a run can be replayed bit by bit, and reads it back.

File: magic, then chunks (tag, length, CRC-32, zlib data). One second of ticks makes a chunk, its
images another. A run that ends with the battery loses at most its last second; a file that is torn
or damaged is read up to there.
"""

import json
import os
import struct
import threading
import zlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from queue import Full, Queue
from typing import Annotated, Any, BinaryIO, TypedDict

import msgspec
import numpy as np

from renet.deploy.cameras.base import DepthFrame
from renet.deploy.controller import Decision, Event
from renet.deploy.robots.base import VECTORS, RobotState
from renet.deploy.safety.machine import Mode
from renet.deploy.teleop import TeleopCommand
from renet.errors import RenetError, reason
from renet.files import MEGABYTE, create, decompress, parse_json, require_regular
from renet.interface import ACTION_SIZE, DEPTH_SHAPE, LATENT

MAGIC = b"RENETLOG5\n"
EARLIER = {b"RENETLOG4\n": "0.1.x"}
"""Versions of renet that read earlier formats, by their magic."""
CHUNK = struct.Struct("<4sII")
HEADER, TICKS, IMAGES, EVENTS, END = b"HEAD", b"TICK", b"IMAG", b"EVNT", b"END."
POWER = b"POWR"
"""Its readers before renet knew it leave the chunk out, as any that they do not know."""
TICKS_PER_CHUNK = 50

NONE, GOOD, BAD = 0, 1, 2
"""Whether a reading or a frame was there at a tick, and whether it could be stored."""
MODES = tuple(Mode)

TICK_DTYPE = np.dtype(
    [
        ("now", "f8"),
        ("state", "u1"),
        ("state_time", "f8"),
        *((name, "f8", size) for name, size in VECTORS.items()),
        *((name, "f8") for name in ("forward", "left", "turn_rate")),
        *((name, "?") for name in ("arm", "stop")),
        ("frame", "u1"),
        ("frame_number", "i8"),
        *((name, "f8") for name in ("frame_time", "frame_invalid")),
        ("mode", "u1"),
        *((name, "?") for name in ("vision", "has_image")),
        ("map_error", "f4"),
        *((name, "?") for name in ("inferred", "fallback")),
        *((name, "f4") for name in ("probability", "anomaly", "variance", "frame_age")),
        ("action", "f4", ACTION_SIZE),
        *((name, "f8", ACTION_SIZE) for name in ("position", "stiffness", "damping")),
        ("latent", "f4", LATENT),
        ("told", "f4", 3),
        *((name, "f4", 3) for name in ("velocity_op", "velocity_vp")),
        ("compute_ms", "f4"),
        ("base_position", "f4", 3),
    ]
)
"""One control tick: what came in, what was decided, how long that took, and where the base was in
the world (NaN where nobody knows)."""
POWER_DTYPE = np.dtype([("tick", "<u4"), ("temperature", "<f4"), ("battery", "<f4")])
"""From which tick on a robot said something else: °C of its hottest motor, and charge, 0 to 1."""
WISHES = tuple(f.name for f in fields(TeleopCommand))
"""Fields of an operator's command, all of which are recorded."""
DECIDED = tuple(
    f.name for f in fields(Decision) if f.name in (TICK_DTYPE.names or ()) and f.name != "mode"
)
"""Fields of a `Decision` that are recorded as they are."""
MAX_WAITING = 60
"""Chunks that wait for the disk; two or three are written each second."""
CLOSING = 5.0
"""Seconds that `close` waits for the disk."""

MAX_FILE = 4000 * MEGABYTE
"""Bytes of a recording, packed or not; eight hours unpack to about as many."""
MAX_CHUNK = 4 * MEGABYTE
"""Bytes of one chunk, packed or not; a second of ticks has 0.1 MB."""
FREE, MAX_RATIO = 50 * MEGABYTE, 16
"""Bytes in memory, and more of them for each byte that was read; a run's own have about 2."""
LONGEST = 1e6
"""Seconds from the first to the last tick."""
Number = Annotated[float, msgspec.Meta(gt=-1e15, lt=1e15)]
"""A number that a run may have written; NaN is none."""


class Header(TypedDict, total=False):
    """Entries of a header that readers rely on; there are others."""

    bundle: str | None
    bundle_sha256: str | None
    robot: str | None
    selector: str | None
    terrain: str | None
    beta: Number | None
    level: Number | None
    onsets: list[Number]
    fault: list[str]
    thresholds: dict[str, Number]


class Recorder:
    """Writes a recording; compression and disk are left to a thread of its own.

    A disk that fails, hangs or does not keep up ends the recording, never the run.
    """

    def __init__(self, path: Path, header: dict[str, Any], patient: bool = False) -> None:
        """Create the file, with a header of JSON values; raises RenetError if that cannot be done.

        A patient recorder waits for a slow disk, at most `CLOSING` seconds at a time: for runs on
        a simulated clock, which no disk keeps up with for long.
        """
        self._patience = CLOSING / 3 if patient else 0.0  # A flush has three chunks.
        self._file = create(path, "recording")
        self._chunks: Queue[tuple[bytes, bytes] | None] = Queue(MAX_WAITING)
        self.path, self.problem = path, ""
        """Why the recording ended early; empty while it goes on."""
        self.hung = False
        """Whether the disk still had not answered when the recording was closed."""
        self._ticks: list[np.ndarray] = []
        self._images: list[tuple[int, np.ndarray]] = []
        self._events: list[Event] = []
        self._power: list[np.ndarray] = []
        self._last_power = np.array((0, np.nan, np.nan), POWER_DTYPE)
        self._count, self._last_frame = 0, None
        self._thread = threading.Thread(target=self._write, daemon=True)
        self._thread.start()
        self._put(HEADER, json.dumps(header).encode())

    def event(self, event: Event) -> None:
        """Record a transition (`Controller.on_event`)."""
        self._events.append(event)

    def append(
        self,
        state: RobotState | None,
        frame: DepthFrame | None,
        teleop: TeleopCommand,
        now: float,
        decision: Decision,
        compute_ms: float,
        base_position: np.ndarray | None = None,
    ) -> None:
        """Record one control tick; whatever it is given, it does not raise."""
        tick = np.zeros((), TICK_DTYPE)
        tick["now"], tick["compute_ms"] = now, compute_ms
        tick["base_position"] = np.nan if base_position is None else base_position
        tick["state"] = _store_state(tick, state)
        self._store_power(state)
        tick["frame"] = self._store_frame(tick, frame)
        _store_teleop(tick, teleop)
        tick["mode"] = MODES.index(decision.mode)
        for name in ("position", "stiffness", "damping"):
            tick[name] = getattr(decision.command, name)
        for name in DECIDED:
            tick[name] = getattr(decision, name)
        self._ticks.append(tick)
        self._count += 1
        if len(self._ticks) == TICKS_PER_CHUNK:
            self._flush()

    def close(self) -> None:
        """Write what is left, for at most twice `CLOSING` seconds; safe to call twice."""
        if self._thread.is_alive():
            self._flush()
            self._put(END, b"")
            with suppress(Full):
                self._chunks.put(None, timeout=CLOSING)
            self._thread.join(CLOSING)
        self.hung = self._thread.is_alive()
        if self.hung:
            self.problem = self.problem or f"the recording {self.path} ends early: the disk hangs"
            return  # Closing the file would wait for the same disk.
        with suppress(OSError):  # Already told as `problem`.
            self._file.close()

    def _store_power(self, state: RobotState | None) -> None:
        """Keep temperature and charge where they are not what they were before."""
        try:
            said = np.array((self._count, state.temperature, state.battery), POWER_DTYPE)
        except Exception:  # No reading, or a driver's object, which may fail in any way.
            return
        if said.tobytes()[4:] != self._last_power.tobytes()[4:]:
            self._last_power = said
            self._power.append(said)

    def _store_frame(self, tick: np.ndarray, frame: DepthFrame | None) -> int:
        if frame is None:
            return NONE
        try:
            tick["frame_number"], tick["frame_time"] = frame.number, frame.time
            tick["frame_invalid"] = frame.invalid
            key = (frame.number, frame.time)
            if key != self._last_frame:
                if np.shape(frame.image) != DEPTH_SHAPE:
                    return BAD
                with np.errstate(over="ignore"):
                    image = np.asarray(frame.image, np.float16)
                self._images.append((self._count, image))
                self._last_frame = key
        except Exception:  # A driver's object may fail in any way.
            return BAD
        return GOOD

    def _flush(self) -> None:
        if self._ticks:
            self._put(TICKS, np.stack(self._ticks).tobytes())
        if self._images:
            rows = np.array([row for row, _ in self._images], np.uint32)
            pictures = np.stack([image for _, image in self._images])
            self._put(IMAGES, rows.tobytes() + pictures.tobytes())
        if self._events:
            self._put(EVENTS, json.dumps([asdict(event) for event in self._events]).encode())
        if self._power:
            self._put(POWER, np.stack(self._power).tobytes())
        self._ticks, self._images, self._events, self._power = [], [], [], []

    def _put(self, tag: bytes, data: bytes) -> None:
        if self.problem:
            return
        try:
            self._chunks.put((tag, data), self._patience > 0.0, self._patience)
        except Full:
            self.problem = f"the recording {self.path} ends early: the disk does not keep up"

    def _write(self) -> None:
        magic = MAGIC
        while (chunk := self._chunks.get()) is not None:
            tag, data = chunk
            try:
                packed = zlib.compress(data, 1)
                self._file.write(magic + CHUNK.pack(tag, len(packed), zlib.crc32(packed)) + packed)
                self._file.flush()
                os.fsync(self._file.fileno())  # The battery may go next.
            except Exception as error:  # Whatever it is: the run goes on, and is told.
                why = str(error) or type(error).__name__
                self.problem = f"the recording {self.path} ends early: {why}"
                return
            magic = b""


def _store_teleop(tick: np.ndarray, teleop: TeleopCommand) -> None:
    """Copy the operator's command; what is none stops the robot, now as in a replay."""
    try:
        for name in WISHES:
            tick[name] = getattr(teleop, name)
    except Exception:  # A driver's object may fail in any way.
        tick["stop"] = True


def _store_state(tick: np.ndarray, state: RobotState | None) -> int:
    """Copy a reading; one that is malformed leaves NaN, which a replay refuses alike."""
    if state is None:
        return NONE
    try:
        tick["state_time"] = state.time
        for name, size in VECTORS.items():
            value = np.asarray(getattr(state, name), float)
            if value.shape != (size,):
                raise ValueError(name)
            tick[name] = value
    except Exception:  # A driver's object may fail in any way.
        for name in VECTORS:
            tick[name] = np.nan
        return BAD
    return GOOD


@dataclass(frozen=True)
class Recording:
    """A run that was read back."""

    header: dict[str, Any]
    """What ran: bundle, limits, devices, faults."""
    ticks: np.ndarray
    """[T] of dtype `TICK_DTYPE`."""
    images: dict[int, np.ndarray]
    """[48, 64] float16 by the tick at which it was new."""
    events: list[Event]
    complete: bool
    """False where the end is missing."""
    power: np.ndarray = field(default_factory=lambda: np.zeros(0, POWER_DTYPE))
    """Of dtype `POWER_DTYPE`: what changed of temperature and charge, and when."""


def read_recording(path: Path | str) -> Recording:
    """Read a recording as far as it is whole: up to a torn end, or one of zeros.

    Raises:
        RenetError: not a recording, one without its header, or one whose values make no sense.
    """
    path = require_regular(Path(path), MAX_FILE, "recording")
    header, ticks, images, events, complete = None, [], {}, [], False
    power: list[np.ndarray] = []
    unpacked = 0
    try:
        with path.open("rb") as file:
            magic = file.read(len(MAGIC))
            if magic in EARLIER:
                raise RenetError(
                    f"{path} is a recording of renet {EARLIER[magic]}: only that version reads it"
                )
            if magic != MAGIC:
                raise RenetError(f"{path} is not a recording of this renet")
            for tag, chunk in _chunks(file):
                unpacked += len(chunk)
                if unpacked > min(FREE + MAX_RATIO * file.tell(), MAX_FILE):
                    raise RenetError(f"the recording {path} unpacks to far more than its size")
                if tag == HEADER:
                    header = _header(chunk)
                elif tag == TICKS:
                    ticks.append(np.frombuffer(chunk, TICK_DTYPE))
                elif tag == IMAGES:
                    images |= _images(chunk)
                elif tag == EVENTS:
                    events += _events(chunk)
                elif tag == POWER:
                    power.append(np.frombuffer(chunk, POWER_DTYPE))
                complete = tag == END
        if header is None:
            raise RenetError(f"{path} has no readable header: nothing of the run was saved")
        rows = np.concatenate(ticks) if ticks else np.zeros(0, TICK_DTYPE)
        _check(rows, images, events)
    except OSError as error:
        raise RenetError(f"cannot read the recording {path}: {reason(error)}") from error
    except (ValueError, TypeError) as error:
        raise RenetError(
            f"the recording {path} is damaged, or of another version of renet: {error}"
        ) from error
    changes = np.concatenate(power) if power else np.zeros(0, POWER_DTYPE)
    return Recording(header, rows, images, events, complete, changes)


def _chunks(file: BinaryIO) -> Iterator[tuple[bytes, bytes]]:
    """Whole chunks, up to the first that is torn or damaged."""
    while len(head := file.read(CHUNK.size)) == CHUNK.size:
        tag, length, check = CHUNK.unpack(head)
        if length == 0:  # No chunk is: a power cut leaves zeros.
            return
        packed = file.read(min(length, MAX_CHUNK))
        if len(packed) < length or zlib.crc32(packed) != check:
            return
        yield tag, decompress(packed, MAX_CHUNK, "chunk")


def _images(chunk: bytes) -> dict[int, np.ndarray]:
    size = 4 + 2 * DEPTH_SHAPE[0] * DEPTH_SHAPE[1]
    count = len(chunk) // size
    rows = np.frombuffer(chunk, np.uint32, count)
    pictures = np.frombuffer(chunk, np.float16, offset=4 * count).reshape(-1, *DEPTH_SHAPE)
    return {int(row): picture for row, picture in zip(rows, pictures, strict=True)}


def _events(chunk: bytes) -> list[Event]:
    """Read a chunk of events; raises ValueError unless they are made of a time and two texts."""
    events = msgspec.convert(parse_json(chunk, "events"), list[Event])
    for event in events:
        msgspec.convert(event.time, Number)
    return events


def _header(chunk: bytes) -> dict[str, Any]:
    """Read the header; raises ValueError if what readers rely on is of another type."""
    value = parse_json(chunk, "header")
    msgspec.convert(value, Header)
    return value


def _check(ticks: np.ndarray, images: dict[int, np.ndarray], events: list[Event]) -> None:
    """Raise ValueError for what no run can have written."""
    now = ticks["now"]
    if not np.isfinite(now).all() or (np.diff(now) < 0).any():
        raise ValueError("its times are not finite or run backwards")
    if len(now) and now[-1] - now[0] > LONGEST:
        raise ValueError(f"it lasts longer than {LONGEST:g} s")
    if (ticks["mode"] >= len(MODES)).any():
        raise ValueError(f"mode {ticks['mode'].max()} does not exist")
    if (ticks["state"] > BAD).any() or (ticks["frame"] > BAD).any():
        raise ValueError("a reading is neither absent, good nor bad")
    if max(images, default=-1) >= len(ticks):
        raise ValueError(f"an image belongs to tick {max(images)} of {len(ticks)}")
    if len(events) > 10 * len(ticks) + 1000:
        raise ValueError(f"it has {len(events)} events in {len(ticks)} ticks")
