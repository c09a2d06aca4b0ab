"""Physical faults: camera and driver are fine, but what they see is not what the feet will meet.

They cannot be painted on an image. A fault says how a camera's view departs from the scene, and a
simulated world casts its rays accordingly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from renet.faults.stream import Fault, Frames


@dataclass(frozen=True)
class View:
    """How each of n cameras sees its scene."""

    lift: np.ndarray
    """[n] m by which every surface appears higher than it is."""
    turn: np.ndarray
    """[n, 3] rotation vector of the camera in its mount, rad, camera axes (forward, left, up)."""
    glass: np.ndarray
    """[n] share of the obstacles that rays pass through; feet do not."""

    @classmethod
    def true(cls, n: int) -> View:
        """Every camera sees what is there."""
        return cls(np.zeros(n), np.zeros((n, 3)), np.zeros(n))

    def __eq__(self, other: object) -> bool:
        """Whether all cameras see the same in both."""
        return isinstance(other, View) and all(
            np.array_equal(mine, theirs)
            for mine, theirs in zip(vars(self).values(), vars(other).values(), strict=True)
        )


class PhysicalFault(Fault):
    """A fault of the scene or the mount; frames pass through it untouched."""

    def corrupt(self, frames: Frames, elapsed: np.ndarray) -> Frames:
        """The frames as they are: the rays were already cast into the wrong scene."""
        return frames

    def bend(self, view: View, rows: np.ndarray) -> None:
        """Add the fault to the view of the robots `rows`; the random streams are in that order."""
        raise NotImplementedError
