"""Recorder of control ticks in an MCAP file, from which a run can be replayed bit by bit.

Each second of a run makes a chunk. A run that ends with the battery loses at most its last second.
"""

import os
import threading
from contextlib import suppress
from pathlib import Path
from queue import Full, Queue
from time import monotonic
from typing import Any, NamedTuple

import numpy as np

from renet.deploy.cameras.base import DepthFrame
from renet.deploy.controller import Decision, Event
from renet.deploy.recording.channels import ChannelWriter, DepthImage, Topic, encode
from renet.deploy.recording.tick import (
    BAD,
    DECIDED,
    GOOD,
    MODES,
    NONE,
    POWER_DTYPE,
    TICK_DTYPE,
    WISHES,
)
from renet.deploy.robots.base import VECTORS, RobotState
from renet.deploy.teleop.base import TeleopCommand
from renet.files import create
from renet.interface import DEPTH_SHAPE

_TICKS_PER_CHUNK = 50
"""Number of control ticks in a chunk: one second."""
MAX_CHUNKS = 20
"""Largest number of chunks, of one second each, that wait for the disk."""
DISK_SECONDS = 5.0
"""Longest wait of `close` for the disk, s."""


class _Entry(NamedTuple):
    """Message before it is encoded."""

    topic: str
    time: float
    """Seconds on the robot's clock."""
    value: Any


class Recorder:
    """Writes a recording; a thread of its own encodes, compresses and writes to disk.

    A disk that fails, hangs or does not keep up ends the recording, never the run.
    """

    def __init__(
        self, path: Path, header: dict[str, Any], patient: bool = False, time: float = 0.0
    ) -> None:
        """Create the file.

        Args:
            path: Path of the file, which must not exist.
            header: Configuration of the run, in JSON values.
            patient: Wait for a slow disk, at most `DISK_SECONDS` at a time: for runs on a simulated
                clock, with which no disk keeps up for long.
            time: Time on the robot's clock at which the run begins, s.

        Raises:
            RenetError: The file cannot be created.
        """
        self._patience = DISK_SECONDS if patient else 0.0
        self._file = create(path, "recording")
        self._chunks: Queue[list[_Entry] | None] = Queue(MAX_CHUNKS)
        self.path = path
        self.problem = ""
        """Reason why the recording ended early; empty as long as it did not."""
        self.hung = False
        """True if the disk still had not answered when the recording was closed."""
        # Handed over to the thread at each chunk.
        self._entries = [_Entry(Topic.RUN, time, header)]
        self._ticks = 0
        """Number of ticks since the last chunk."""
        self._last_frame: tuple[int, float] | None = None
        self._last_power = np.full((), np.nan, POWER_DTYPE)
        self._thread = threading.Thread(target=self._write, daemon=True)
        self._thread.start()
        # The header is a chunk of its own, so that a run killed in its first second has one.
        self._flush(self._patience)

    def event(self, event: Event) -> None:
        """Record a transition (`Controller.on_event`)."""
        self._entries.append(_Entry(Topic.EVENTS, event.time, event))

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
        """Record one control tick; never raises, whatever a driver returned.

        Args:
            state: Reading of the robot, as its driver returned it.
            frame: Newest depth frame, as the camera returned it.
            teleop: The operator's command.
            now: Time of the tick on the robot's clock, s.
            decision: The controller's decision.
            compute_ms: Duration of the controller's tick, ms.
            base_position: Position of the base in the world, [3] m; None for a real robot.
        """
        tick = np.zeros((), TICK_DTYPE)
        tick["now"] = now
        tick["compute_ms"] = compute_ms
        tick["base_position"] = np.nan if base_position is None else base_position
        tick["state"] = _store_state(tick, state)
        self._store_power(state, now)
        tick["frame"] = self._store_frame(tick, frame)
        _store_teleop(tick, teleop)
        tick["mode"] = MODES.index(decision.mode)
        for name in ("position", "stiffness", "damping"):
            tick[name] = getattr(decision.command, name)
        for name in DECIDED:
            tick[name] = getattr(decision, name)
        self._entries.append(_Entry(Topic.TICK, now, tick))
        self._ticks += 1
        if self._ticks == _TICKS_PER_CHUNK:
            self._flush(self._patience)

    def close(self) -> None:
        """Write the rest, for at most twice `DISK_SECONDS`; a second call does nothing."""
        if self._thread.is_alive():
            deadline = monotonic() + DISK_SECONDS
            # The run is over, and can wait until the disk has room for its last second.
            self._flush(DISK_SECONDS)
            with suppress(Full):
                self._chunks.put(None, timeout=max(deadline - monotonic(), 0.0))
            self._thread.join(DISK_SECONDS)
        self.hung = self._thread.is_alive()
        if self.hung:
            self.problem = self.problem or f"the recording {self.path} ends early: the disk hangs"
            # Closing the file would wait for the same disk.
            return
        # An error of the disk is known from `problem` already.
        with suppress(OSError):
            self._file.close()

    def _store_power(self, state: RobotState | None, now: float) -> None:
        """Record temperatures, charge and voltage if one of them changed."""
        power = np.zeros((), POWER_DTYPE)
        try:
            for name in ("temperature", "battery", "voltage"):
                power[name] = getattr(state, name)
        except Exception:
            # No reading, or a driver's object, which may fail in any way.
            return
        # Compared as bytes, in which NaN equals NaN.
        power["now"] = self._last_power["now"]
        if power.tobytes() != self._last_power.tobytes():
            power["now"] = now
            self._last_power = power
            self._entries.append(_Entry(Topic.POWER, now, power))

    def _store_frame(self, tick: np.ndarray, frame: DepthFrame | None) -> int:
        """Copy a frame, and record its image if it is new; returns `NONE`, `GOOD` or `BAD`."""
        if frame is None:
            return NONE
        try:
            tick["frame_number"] = frame.number
            tick["frame_time"] = frame.time
            tick["frame_invalid"] = frame.invalid
            key = (frame.number, frame.time)
            if key != self._last_frame:
                if np.shape(frame.image) != DEPTH_SHAPE:
                    return BAD
                # A copy in half precision, in which the policy sees it.
                with np.errstate(over="ignore"):
                    image = np.array(frame.image, np.float16)
                depth = DepthImage(float(frame.time), image)
                self._entries.append(_Entry(Topic.DEPTH, float(tick["now"]), depth))
                tick["new_image"] = True
                self._last_frame = key
        except Exception:  # A driver's object may fail in any way.
            return BAD
        return GOOD

    def _flush(self, patience: float) -> None:
        """Hand the entries since the last chunk to the writing thread.

        It waits at most `patience` seconds for the disk.
        """
        entries = self._entries
        self._entries = []
        self._ticks = 0
        if self.problem or not entries:
            return
        try:
            self._chunks.put(entries, timeout=patience)
        except Full:
            self.problem = f"the recording {self.path} ends early: the disk does not keep up"

    def _write(self) -> None:
        """Write chunks until None comes, then the index if there was no problem."""
        try:
            writer = ChannelWriter(self._file)
            while (entries := self._chunks.get()) is not None:
                for topic, time, value in entries:
                    writer.write(topic, time, encode(value))
                writer.flush()
                # The battery may be empty next.
                os.fsync(self._file.fileno())
            if not self.problem:
                writer.finish()
                self._file.flush()
                os.fsync(self._file.fileno())
        except Exception as error:
            # Whatever it is, the run goes on, and reports it.
            why = str(error) or type(error).__name__
            self.problem = f"the recording {self.path} ends early: {why}"


def _store_teleop(tick: np.ndarray, teleop: TeleopCommand) -> None:
    """Copy the operator's command; a malformed one is a stop, in the run as in a replay."""
    try:
        for name in WISHES:
            tick[name] = getattr(teleop, name)
    except Exception:  # A driver's object may fail in any way.
        tick["stop"] = True


def _store_state(tick: np.ndarray, state: RobotState | None) -> int:
    """Copy a reading; returns `NONE`, `GOOD` or `BAD`.

    A malformed one is stored as NaN, which the controller refuses in a replay, too.
    """
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
