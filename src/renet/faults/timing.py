"""Faults of time: good images that come late, twice or not at all."""

from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from renet.faults.base import FOREVER, Fault, Frames
from renet.interface import TICK_DT


class Frozen(Fault):
    """The same image is delivered as new; level is for how many seconds."""

    unit = "s"
    levels = (0.2, 0.5, 1.0, 3.0, FOREVER)
    level_is_duration = True
    _last: Frames | None = None

    def corrupt(self, frames: Frames, elapsed: np.ndarray) -> Frames:
        """Hold the last image from before the fault, with its holes."""
        if self._last is None:
            self._last = frames.copy()
        live = elapsed < 0
        self._last.write(live, frames.rows(live))
        return replace(self._last.copy(), fresh=frames.fresh, age=frames.age)


class Dropped(Fault):
    """Each frame is lost with a probability; level is that probability."""

    unit = "share"
    levels = (0.1, 0.3, 0.5, 0.7, 0.9)
    _held: Frames | None = None

    def missing(self, elapsed: np.ndarray) -> np.ndarray:
        """Draw a mask of robots without a frame at this tick, [n] bool."""
        lost = elapsed >= 0
        for i in np.flatnonzero(lost).tolist():
            lost[i] = self.rngs[i].random() < self.level
        return lost

    def corrupt(self, frames: Frames, elapsed: np.ndarray) -> Frames:
        """Keep the last frame delivered, which ages, where no new one comes."""
        if self._held is None:
            self._held = frames.copy()
        lost = self.missing(elapsed)
        self._held.age[lost] += TICK_DT
        self._held.fresh[lost] = False
        self._held.write(~lost, frames.rows(~lost))
        return self._held.copy()


class Unplugged(Dropped):
    """No frames at all; level is the seconds after which the camera is back."""

    unit = "s"
    levels = (1.0, 2.0, 5.0, 10.0, FOREVER)
    level_is_duration = True

    def missing(self, elapsed: np.ndarray) -> np.ndarray:
        return elapsed >= 0


class Latency(Fault):
    """Each frame is late by 0.5 to 1.5 times the level; the newest that came is used.

    The driver stamps frames on arrival.
    """

    unit = "ms"
    levels = (50, 100, 200, 300, 500)

    def __init__(self, level: float, rngs: Sequence[np.random.Generator]) -> None:
        super().__init__(level, rngs)
        depth = int(np.ceil(1.5e-3 * level / TICK_DT)) + 2
        self._past: deque[tuple[Frames, np.ndarray]] = deque(maxlen=depth)
        """Frames of the last ticks, newest first, and the times at which they arrive, [n] s."""
        self._held: Frames | None = None
        """Frames delivered last."""
        self._capture = np.zeros(len(rngs))
        """Times at which they were taken, [n] s."""
        self._arrival = np.zeros(len(rngs))
        """Times at which they arrived, [n] s."""
        self._now = 0.0

    def corrupt(self, frames: Frames, elapsed: np.ndarray) -> Frames:
        """Deliver the newest frame that has arrived by now."""
        # Store the new frames with the times at which they arrive; lost ones never do.
        self._now += TICK_DT
        delay = np.array([rng.uniform(0.5, 1.5) * self.level * 1e-3 for rng in self.rngs])
        live = elapsed < 0
        arrival = np.where(frames.fresh, self._now + delay, np.inf)
        self._past.appendleft((frames.copy(), np.where(live, self._now, arrival)))

        # Until the first frame arrives, it is shown already, since there was none before.
        fresh = np.zeros(len(elapsed), bool)
        if self._held is None:
            self._held = frames.copy()
            self._capture[:] = self._now
            self._arrival[:] = self._now
            fresh = frames.fresh.copy()

        # Find the newest one that has arrived, for each robot, if it is newer than the last.
        arrivals = np.stack([arrival for _, arrival in self._past])
        has_arrived = arrivals <= self._now + 1e-9
        ticks_ago = has_arrived.argmax(axis=0)
        capture = self._now - TICK_DT * ticks_ago
        is_newer = has_arrived.any(axis=0) & (capture > self._capture + 1e-9)
        for robot in np.flatnonzero(is_newer).tolist():
            row = np.array([robot])
            self._held.write(row, self._past[ticks_ago[robot]][0].rows(row))
            self._capture[robot] = capture[robot]
            self._arrival[robot] = arrivals[ticks_ago[robot], robot]
        fresh |= is_newer
        age = np.where(fresh, 0.0, self._now - self._arrival)
        return replace(
            self._held.copy(),
            fresh=np.where(live, frames.fresh, fresh),
            age=np.where(live, frames.age, age),
        )
