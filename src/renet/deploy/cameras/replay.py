"""A camera that shows the images of a run again, on another robot's clock."""

import math
from collections.abc import Callable

from renet.deploy.cameras.base import DepthFrame
from renet.deploy.recording import Recording
from renet.errors import RenetError


class ReplayCamera:
    """Shows each image as long after `start` as it came after the run's first; then none."""

    def __init__(self, run: Recording, now: Callable[[], float]) -> None:
        """Set up; raises RenetError if the run has no images.

        Args:
            run: from `read_recording`. now: the robot's clock.
        """
        if not run.images:
            raise RenetError("the recording holds no images: it was made without a camera")
        self._now = now
        self._begun = math.inf
        rows = sorted(run.images)
        first = float(run.ticks["now"][rows[0]])
        self._frames = []
        for row in rows:
            tick = run.ticks[row]
            since = float(tick["now"]) - first
            invalid = float(tick["frame_invalid"])
            self._frames.append((since, int(tick["frame_number"]), run.images[row], invalid))
        self._next = 0

    def start(self) -> None:
        """The first image is shown now."""
        self._begun, self._next = self._now(), 0

    def latest(self) -> DepthFrame | None:
        """Newest frame; None before the first."""
        since = self._now() - self._begun
        while self._next < len(self._frames) and self._frames[self._next][0] <= since + 1e-6:
            self._next += 1
        if self._next == 0:
            return None
        time, number, image, invalid = self._frames[self._next - 1]
        return DepthFrame(image, number, self._begun + time, invalid)

    def close(self) -> None:
        """Nothing to stop."""
