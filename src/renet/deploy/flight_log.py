"""A compact record of every control tick, from which a flight can be replayed bit by bit.

File: magic, then chunks (tag, length, CRC-32, zlib data). One second of ticks makes a chunk, its
images another. A flight that ends with the battery loses at most its last second.
"""

from __future__ import annotations

import json
import os
import struct
import threading
import zlib
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import Any, BinaryIO

import numpy as np

from renet.deploy.cameras.base import DepthFrame
from renet.deploy.controller import Decision, Event
from renet.deploy.operator import Request
from renet.deploy.robots.base import RobotState
from renet.deploy.safety import VECTORS, Mode
from renet.errors import RenetError
from renet.interface import ACTION_SIZE, DEPTH_SHAPE, LATENT

MAGIC = b"RENETLOG1\n"
CHUNK = struct.Struct("<4sII")
HEADER, TICKS, IMAGES, EVENTS, END = b"HEAD", b"TICK", b"IMAG", b"EVNT", b"END."
TICKS_PER_CHUNK = 50

NONE, GOOD, BAD = 0, 1, 2
"""Whether a reading or a frame was there at a tick, and whether it could be stored."""
MODES = tuple(Mode)

READING: list[tuple[str, Any, Any]] = [(name, "f8", size) for name, size in VECTORS.items()]
TICK = np.dtype(
    [
        ("now", "f8"),
        ("state", "u1"),
        ("state_time", "f8"),
        *READING,
        ("speed", "f8"),
        ("turn", "f8"),
        ("arm", "?"),
        ("stop", "?"),
        ("frame", "u1"),
        ("frame_number", "i8"),
        ("frame_time", "f8"),
        ("frame_invalid", "f8"),
        ("mode", "u1"),
        ("vision", "?"),
        ("perceived", "?"),
        ("fallback", "?"),
        ("probability", "f4"),
        ("anomaly", "f4"),
        ("frame_age", "f4"),
        ("action", "f4", ACTION_SIZE),
        ("position", "f8", ACTION_SIZE),
        ("stiffness", "f8", ACTION_SIZE),
        ("damping", "f8", ACTION_SIZE),
        ("latent", "f4", LATENT),
        ("velocity_op", "f4", 3),
        ("velocity_vp", "f4", 3),
        ("compute_ms", "f4"),
        ("base_position", "f4", 3),
    ]
)
"""One control tick: what came in, what was decided, how long that took, and, for judges, where the
base was in the world; NaN where nobody knows."""


class FlightLog:
    """Writes a flight; compression and disk are left to a thread of its own."""

    def __init__(self, path: Path, header: dict[str, Any]) -> None:
        """Create the file; raises RenetError if that cannot be done.

        Args:
            path: of the log. header: JSON values, such as the bundle's hash.
        """
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file: BinaryIO = path.open("wb")
            self._file.write(MAGIC)
        except OSError as error:
            raise RenetError(f"cannot write the flight log {path}: {error}") from error
        self.path, self.problem = path, ""
        """What went wrong with the disk; the flight goes on without its log."""
        self._ticks: list[np.ndarray] = []
        self._images: list[tuple[int, np.ndarray]] = []
        self._events: list[Event] = []
        self._count, self._last_frame = 0, None
        self._chunks: SimpleQueue[tuple[bytes, bytes] | None] = SimpleQueue()
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
        request: Request,
        now: float,
        decision: Decision,
        compute_ms: float,
        base_position: np.ndarray | None = None,
    ) -> None:
        """Record one control tick; whatever it is given, it does not raise."""
        tick = np.zeros((), TICK)
        tick["now"], tick["compute_ms"] = now, compute_ms
        tick["base_position"] = np.nan if base_position is None else base_position
        tick["state"] = _store_state(tick, state)
        tick["frame"] = self._store_frame(tick, frame)
        _store_request(tick, request)
        tick["mode"] = MODES.index(decision.mode)
        for name in ("position", "stiffness", "damping"):
            tick[name] = getattr(decision.command, name)
        for name in ("vision", "perceived", "fallback", "probability", "anomaly", "frame_age"):
            tick[name] = getattr(decision, name)
        for name in ("action", "latent", "velocity_op", "velocity_vp"):
            tick[name] = getattr(decision, name)
        self._ticks.append(tick)
        self._count += 1
        if len(self._ticks) == TICKS_PER_CHUNK:
            self._flush()

    def close(self) -> None:
        """Write what is left; safe to call twice."""
        if self._thread.is_alive():
            self._flush()
            self._put(END, b"")
            self._chunks.put(None)
            self._thread.join()
        with suppress(OSError):  # Already told as `problem`.
            self._file.close()

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
        self._ticks, self._images, self._events = [], [], []

    def _put(self, tag: bytes, data: bytes) -> None:
        if not self.problem:  # Nobody takes chunks any more: do not let them pile up.
            self._chunks.put((tag, data))

    def _write(self) -> None:
        while (chunk := self._chunks.get()) is not None:
            tag, data = chunk
            packed = zlib.compress(data, 1)
            try:
                self._file.write(CHUNK.pack(tag, len(packed), zlib.crc32(packed)) + packed)
                self._file.flush()
                os.fsync(self._file.fileno())  # The battery may go next.
            except (OSError, ValueError) as error:
                self.problem = f"the flight log {self.path} ends early: {error}"
                return


def _store_request(tick: np.ndarray, request: Request) -> None:
    """Copy the operator's wishes; what is none stops the robot, now as in a replay."""
    try:
        for name in ("speed", "turn", "arm", "stop"):
            tick[name] = getattr(request, name)
    except Exception:  # As above.
        tick["stop"] = True


def _store_state(tick: np.ndarray, state: RobotState | None) -> int:
    """Copy a reading; one that is malformed leaves NaN, which a replay refuses alike."""
    if state is None:
        return NONE
    try:
        tick["state_time"] = state.time
        for name, _, size in READING:
            value = np.asarray(getattr(state, name), float)
            if value.shape != (size,):
                raise ValueError(name)
            tick[name] = value
    except Exception:  # As above.
        for name, _, _ in READING:
            tick[name] = np.nan
        return BAD
    return GOOD


@dataclass(frozen=True)
class Flight:
    """A flight that was read back."""

    header: dict[str, Any]
    ticks: np.ndarray
    """[T] of dtype `TICK`."""
    images: dict[int, np.ndarray]
    """[48, 64] float16 by the tick at which it was new."""
    events: list[Event]
    complete: bool
    """False for a flight whose end is missing."""


def read_log(path: Path) -> Flight:
    """Read a flight as far as it is whole.

    Raises:
        RenetError: not a flight log, or one without its header.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise RenetError(f"cannot read the flight log {path}: {error}") from error
    if not data.startswith(MAGIC):
        raise RenetError(f"{path} is not a flight log of this renet")
    header, ticks, images, events, complete = None, [], {}, [], False
    try:
        for tag, chunk in _chunks(data, len(MAGIC)):
            if tag == HEADER:
                header = json.loads(chunk)
                if not isinstance(header, dict):
                    raise TypeError(f"its header is a {type(header).__name__}")
            elif tag == TICKS:
                ticks.append(np.frombuffer(chunk, TICK))
            elif tag == IMAGES:
                images |= _images(chunk)
            elif tag == EVENTS:
                events += [Event(**event) for event in json.loads(chunk)]
            complete = tag == END
    except (ValueError, TypeError) as error:
        raise RenetError(f"{path} was written by another version of renet: {error}") from error
    if header is None:
        raise RenetError(f"{path} has no readable header: nothing of the flight was saved")
    rows = np.concatenate(ticks) if ticks else np.zeros(0, TICK)
    return Flight(header, rows, images, events, complete)


def _chunks(data: bytes, start: int):
    """Whole chunks, up to the first that is torn or damaged."""
    while start + CHUNK.size <= len(data):
        tag, length, check = CHUNK.unpack_from(data, start)
        start += CHUNK.size
        packed = data[start : start + length]
        if len(packed) < length or zlib.crc32(packed) != check:
            return
        try:
            yield tag, zlib.decompress(packed)
        except zlib.error:
            return
        start += length


def _images(chunk: bytes) -> dict[int, np.ndarray]:
    size = 4 + 2 * DEPTH_SHAPE[0] * DEPTH_SHAPE[1]
    count = len(chunk) // size
    rows = np.frombuffer(chunk, np.uint32, count)
    pictures = np.frombuffer(chunk, np.float16, offset=4 * count).reshape(-1, *DEPTH_SHAPE)
    return {int(row): picture for row, picture in zip(rows, pictures, strict=True)}
