"""The newest depth images of N robots, and how old they are."""

from dataclasses import dataclass

import numpy as np

OLDEST = 1e3
"""Age in seconds of an image that never came."""


@dataclass(frozen=True)
class Images:
    """The newest images that N cameras have delivered by a control step."""

    image: np.ndarray | None
    """[N, 48, 64] planar depth divided by the range, in [0, 1]; None before the first."""
    fresh: np.ndarray
    """[N] bool: delivered since the last control step."""
    age: np.ndarray
    """[N] seconds since it was taken."""
    invalid: np.ndarray
    """[N] share of its pixels without a measurement, before holes were filled."""
    broken: np.ndarray | bool = False
    """[N] bool: what the camera delivered last cannot be read, and its score is infinite."""


class ImageHolder:
    """Keeps the newest image of cameras that all deliver at once."""

    def __init__(self, num_robots: int) -> None:
        self._image: np.ndarray | None = None
        self._taken = -np.inf
        self._num_robots = num_robots

    def hold(self, image: np.ndarray | None, now: float) -> Images:
        """The newest images at `now`, s, where `image` [N, 48, 64] has just been taken, if any."""
        robots = self._num_robots
        if image is not None:
            self._image = image
            self._taken = now
        # After a clock's jump back, the seconds until then.
        age = min(abs(now - self._taken), OLDEST)
        return Images(
            image=self._image,
            fresh=np.full(robots, image is not None),
            age=np.full(robots, age),
            invalid=np.zeros(robots),
        )
