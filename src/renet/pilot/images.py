"""Newest depth images of N robots, and their ages."""

from dataclasses import dataclass

import numpy as np

OLDEST = 1e3
"""Largest age of an image, s, and that of one that never came."""


@dataclass(frozen=True)
class Images:
    """The newest images that N cameras have delivered by a control step."""

    image: np.ndarray | None
    """Planar depth divided by the range, [N, 48, 64] in [0, 1]; None before the first image."""
    fresh: np.ndarray
    """True for images delivered since the last control step, [N] bool."""
    age: np.ndarray
    """Time since the image was taken, [N] s."""
    invalid: np.ndarray
    """Share of its pixels without a measurement, before holes were filled, [N]."""
    broken: np.ndarray | bool = False
    """True where the newest image cannot be read, so that its score is infinite, [N] bool."""


class ImageHolder:
    """Newest image of N cameras that all deliver at the same time."""

    def __init__(self, num_robots: int) -> None:
        self._image: np.ndarray | None = None
        self._taken = -np.inf
        self._num_robots = num_robots

    def hold(self, image: np.ndarray | None, now: float) -> Images:
        """Keep an image, and return the newest images.

        Args:
            image: Images that have just been taken, [N, 48, 64]; None if there are none.
            now: Time on any clock, s.
        """
        robots = self._num_robots
        if image is not None:
            self._image = image
            self._taken = now
        # The clock may have jumped back to before the image was taken.
        age = min(abs(now - self._taken), OLDEST)
        return Images(
            image=self._image,
            fresh=np.full(robots, image is not None),
            age=np.full(robots, age),
            invalid=np.zeros(robots),
        )
