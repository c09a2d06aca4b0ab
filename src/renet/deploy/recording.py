"""Reads a recording back, whatever happened to its file."""

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from renet.deploy.controller import Event
from renet.deploy.recorder import (
    CHUNK,
    END,
    EVENTS,
    HEADER,
    IMAGES,
    MAGIC,
    MODES,
    TICK,
    TICKS,
)
from renet.errors import RenetError
from renet.files import MEGABYTE, decompress, parse_json, require_regular
from renet.interface import DEPTH_SHAPE

MAX_FILE = 4000 * MEGABYTE
"""Bytes of a recording: about eight hours."""
MAX_CHUNK = 4 * MEGABYTE
"""Bytes of one chunk, packed or not; a second of ticks has 0.1 MB."""
MAX_RATIO = 16
"""Bytes in memory for each byte of the file, after the first 50 MB; a run's own have about 2."""
LONGEST = 1e6
"""Seconds from the first to the last tick."""
TEXTS = ("bundle", "bundle_sha256", "robot", "selector", "terrain")


@dataclass(frozen=True)
class Recording:
    """A run that was read back."""

    header: dict[str, Any]
    """What ran: bundle, limits, devices, faults."""
    ticks: np.ndarray
    """[T] of dtype `TICK`."""
    images: dict[int, np.ndarray]
    """[48, 64] float16 by the tick at which it was new."""
    events: list[Event]
    """Transitions and their reasons."""
    complete: bool
    """False where the end is missing."""


def read_recording(path: Path) -> Recording:
    """Read a recording as far as it is whole.

    Raises:
        RenetError: not a recording, one without its header, or one whose values make no sense.
    """
    size = require_regular(path, MAX_FILE, "recording").stat().st_size
    header, ticks, images, events, complete = None, [], {}, [], False
    left = 50 * MEGABYTE + MAX_RATIO * size
    try:
        with path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise RenetError(f"{path} is not a recording of this renet")
            for tag, chunk in _chunks(file):
                left -= len(chunk)
                if left < 0:
                    raise RenetError(f"the recording {path} unpacks to far more than its size")
                if tag == HEADER:
                    header = _header(parse_json(chunk, "header"))
                elif tag == TICKS:
                    ticks.append(np.frombuffer(chunk, TICK))
                elif tag == IMAGES:
                    images |= _images(chunk)
                elif tag == EVENTS:
                    events += [_event(value) for value in parse_json(chunk, "events")]
                complete = tag == END
        if header is None:
            raise RenetError(f"{path} has no readable header: nothing of the run was saved")
        rows = np.concatenate(ticks) if ticks else np.zeros(0, TICK)
        _check(rows, images, events)
    except OSError as error:
        raise RenetError(f"cannot read the recording {path}: {error}") from error
    except (ValueError, TypeError) as error:
        raise RenetError(
            f"the recording {path} is damaged, or of another version of renet: {error}"
        ) from error
    return Recording(header, rows, images, events, complete)


def _chunks(file: BinaryIO) -> Iterator[tuple[bytes, bytes]]:
    """Whole chunks, up to the first that is torn or damaged."""
    while len(head := file.read(CHUNK.size)) == CHUNK.size:
        tag, length, check = CHUNK.unpack(head)
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


def _event(value: Any) -> Event:
    event = Event(**value)
    if not (_number(event.time) and isinstance(event.what, str) and isinstance(event.why, str)):
        raise ValueError("an event is not made of a time and two texts")
    return event


def _header(value: Any) -> dict[str, Any]:
    """The header, its values of the types that readers rely on."""
    if not isinstance(value, dict):
        raise TypeError(f"its header is a {type(value).__name__}")
    wrong = [name for name in TEXTS if not isinstance(value.get(name) or "", str)]
    wrong += [name for name in ("beta", "level") if not _number(value.get(name) or 0.0)]
    for name, fits in (("onsets", _number), ("fault", lambda item: isinstance(item, str))):
        items = value.get(name, [])
        if not isinstance(items, list) or not all(fits(item) for item in items):
            wrong.append(name)
    if wrong:
        raise ValueError(f"the header's {wrong[0]!r} is of the wrong type")
    return value


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and abs(value) < 1e15


def _check(ticks: np.ndarray, images: dict[int, np.ndarray], events: list[Event]) -> None:
    """Raise ValueError for what no run can have written."""
    now = ticks["now"]
    if not np.isfinite(now).all() or (np.diff(now) < 0).any():
        raise ValueError("its times are not finite or run backwards")
    if len(now) and now[-1] - now[0] > LONGEST:
        raise ValueError(f"it lasts longer than {LONGEST:g} s")
    if (ticks["mode"] >= len(MODES)).any():
        raise ValueError(f"mode {ticks['mode'].max()} does not exist")
    if ticks[["state", "frame"]].tolist() and max(ticks["state"].max(), ticks["frame"].max()) > 2:
        raise ValueError("a reading is neither absent, good nor bad")
    if max(images, default=-1) >= len(ticks):
        raise ValueError(f"an image belongs to tick {max(images)} of {len(ticks)}")
    if len(events) > 10 * len(ticks) + 1000:
        raise ValueError(f"it has {len(events)} events in {len(ticks)} ticks")
