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
    _last: np.ndarray | None = None

    def corrupt(self, frames: Frames, elapsed: np.ndarray) -> Frames:
        """Hold the last image from before the fault."""
        if self._last is None:
            self._last = frames.image.copy()
        live = elapsed < 0
        self._last[live] = frames.image[live]
        return replace(frames, image=self._last.copy())


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
        self._past: deque[tuple[np.ndarray, np.ndarray]] = deque(maxlen=depth)
        self._last_capture = np.full(len(rngs), -np.inf)
        self._now = 0.0

    def corrupt(self, frames: Frames, elapsed: np.ndarray) -> Frames:
        """Deliver the newest image that has arrived by now."""
        # Store the new images, newest first, with the times at which they arrive.
        self._now += TICK_DT
        delay = np.array([rng.uniform(0.5, 1.5) * self.level * 1e-3 for rng in self.rngs])
        arrival = np.where(elapsed >= 0, self._now + delay, self._now)
        self._past.appendleft((frames.image.copy(), arrival))

        # Find the newest one that has arrived, for each robot; until then show the oldest.
        arrivals = np.stack([arrival for _, arrival in self._past])
        has_arrived = arrivals <= self._now + 1e-9
        has_arrived[-1] = True
        ticks_ago = has_arrived.argmax(axis=0)
        images = []
        for robot, ticks in enumerate(ticks_ago.tolist()):
            images.append(self._past[ticks][0][robot])
        image = np.stack(images)

        # An image is fresh if it was captured after the one delivered last.
        capture = self._now - TICK_DT * ticks_ago
        fresh = capture > self._last_capture + 1e-9
        self._last_capture = capture
        age = np.where(fresh, 0.0, self._now - arrivals[ticks_ago, np.arange(len(ticks_ago))])
        return replace(frames, image=image, fresh=fresh, age=age)
