"""What every depth camera offers: images prepared exactly as in training."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np


@dataclass(frozen=True)
class DepthFrame:
    """One image. Drivers report what they got: the controller checks it."""

    image: np.ndarray
    """[48, 64] planar depth divided by the range, in [0, 1], top row first, holes filled."""
    number: int
    """The sensor's own count of frames."""
    time: float
    """Seconds on the robot's clock at which it was taken."""
    invalid: float = 0.0
    """Share of pixels without a measurement, before holes were filled."""


class Camera(Protocol):
    """A depth camera that never makes its caller wait."""

    busy: bool = False
    """Whether the robot may not be disturbed: it is not braked."""

    def start(self) -> None:
        """Begin to stream; raises RenetError with what to do when that fails."""

    def latest(self) -> DepthFrame | None:
        """Newest frame, the same one until the next arrives; None before the first."""

    def close(self) -> None:
        """Stop streaming; safe to call twice."""
