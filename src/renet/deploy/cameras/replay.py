"""A camera that shows the images of a flight again, on another robot's clock."""

from __future__ import annotations

import math
from collections.abc import Callable

from renet.deploy.cameras.base import DepthFrame
from renet.deploy.flight_log import Flight
from renet.errors import RenetError


class ReplayCamera:
    """Shows each image as long after `start` as it came after the flight's first; then none."""

    def __init__(self, flight: Flight, now: Callable[[], float]) -> None:
        """Set up; raises RenetError if the flight has no images.

        Args:
            flight: from `read_log`. now: the robot's clock.
        """
        if not flight.images:
            raise RenetError("the flight holds no images: it was flown without a camera")
        self._now = now
        self._begun = math.inf
        rows = sorted(flight.images)
        first = float(flight.ticks["now"][rows[0]])
        self._frames = []
        for row in rows:
            tick = flight.ticks[row]
            since = float(tick["now"]) - first
            invalid = float(tick["frame_invalid"])
            self._frames.append((since, int(tick["frame_number"]), flight.images[row], invalid))
        self._next = 0

    def start(self) -> None:
        """The first image is shown now."""
        self._begun, self._next = self._now(), 0

    def latest(self) -> DepthFrame | None:
        """See Camera.latest."""
        since = self._now() - self._begun
        while self._next < len(self._frames) and self._frames[self._next][0] <= since + 1e-6:
            self._next += 1
        if self._next == 0:
            return None
        time, number, image, invalid = self._frames[self._next - 1]
        return DepthFrame(image, number, self._begun + time, invalid)

    def close(self) -> None:
        """Nothing to stop."""
