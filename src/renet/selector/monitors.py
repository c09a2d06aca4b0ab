"""Ways to notice that vision failed, beyond the paper's reconstruction loss.

An autoencoder is blind to a frozen image, a blank one, late or missing frames and filled holes:
each frame by itself looks fine. Every monitor turns what it sees into one score per robot; a robot
is healthy while its score stays below the monitor's threshold, and thresholds are calibrated from
scores of healthy runs (see `renet.selector.calibration`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

NEAR = 0.05
"""Normalised depth (10 cm of 2 m) below which a stereo camera sees nothing real (paper, IV-D)."""


@dataclass(frozen=True)
class Sight:
    """What N robots know of their vision at one moment."""

    anomaly_score: np.ndarray
    """Loss_ad of the newest images, [N]."""
    image: np.ndarray
    """Newest image delivered, [N, 48, 64] in [0, 1]; a new array whenever one arrives."""
    fresh: np.ndarray
    """True where that image arrived since the last update, [N]."""
    age: np.ndarray
    """Seconds since it arrived, [N]."""
    invalid: np.ndarray
    """Share of its pixels without a measurement, before holes were filled, [N]."""
    velocity_op: np.ndarray
    """The OP estimator's base velocity, [N, 3] m/s."""
    velocity_vp: np.ndarray
    """The VP estimator's, [N, 3] m/s."""


class Monitor:
    """One score per robot against one threshold."""

    name: ClassVar[str]
    reason: ClassVar[str]
    """Said when it is the first to object."""

    def __init__(self, threshold: float) -> None:
        self.threshold = threshold

    def score(self, sight: Sight) -> np.ndarray:
        """How suspicious vision is, [N]; larger is worse."""
        raise NotImplementedError

    def reset(self, mask: np.ndarray) -> None:
        """Forget the past of the masked robots."""


class Reconstruction(Monitor):
    """The paper's: the autoencoder cannot rebuild the image."""

    name, reason = "reconstruction", "images unlike those of training"

    def score(self, sight: Sight) -> np.ndarray:
        """Loss_ad."""
        return sight.anomaly_score


class FrameAge(Monitor):
    """No image arrives; at 10 Hz a threshold of 0.2 s is two missed frames."""

    name, reason = "frame_age", "no new image"

    def score(self, sight: Sight) -> np.ndarray:
        """Seconds."""
        return sight.age


class InvalidFraction(Monitor):
    """Too many holes before filling, which hides them from the reconstruction."""

    name, reason = "invalid_fraction", "too many pixels without depth"

    def score(self, sight: Sight) -> np.ndarray:
        """Share of pixels."""
        return sight.invalid


class Disagreement(Monitor):
    """Both estimators know the body's velocity; one that sees nonsense drifts away."""

    name, reason = "disagreement", "the estimators disagree on velocity"

    def score(self, sight: Sight) -> np.ndarray:
        """Distance of both velocities, m/s."""
        return np.linalg.norm(sight.velocity_op - sight.velocity_vp, axis=-1)


class Duplicate(Monitor):
    """The same image again and again: live stereo noise never repeats."""

    name, reason = "duplicate", "the image is frozen"

    def __init__(self, num_robots: int, threshold: float) -> None:
        super().__init__(threshold)
        self._last: np.ndarray | None = None
        self._run = np.zeros(num_robots)

    def score(self, sight: Sight) -> np.ndarray:
        """How many equal images arrived in a row."""
        if not sight.fresh.any():
            return self._run.copy()
        if self._last is None:
            self._last = np.full_like(sight.image, np.nan)
        same = (sight.image == self._last).all(axis=(1, 2))
        self._run = np.where(sight.fresh, np.where(same, self._run + 1, 1), self._run)
        self._last = np.where(sight.fresh[:, None, None], sight.image, self._last)
        return self._run.copy()

    def reset(self, mask: np.ndarray) -> None:
        """See Monitor.reset."""
        self._run[mask] = 0
        if self._last is not None:
            self._last[mask] = np.nan


class ImageMonitor(Monitor):
    """Judges each image by itself, and each only once."""

    def __init__(self, threshold: float) -> None:
        super().__init__(threshold)
        self._image: np.ndarray | None = None
        self._score = np.zeros(0)

    def score(self, sight: Sight) -> np.ndarray:
        """See Monitor.score."""
        if sight.image is not self._image:
            self._image, self._score = sight.image, self.judge(sight.image)
        return self._score

    def judge(self, image: np.ndarray) -> np.ndarray:
        """The score of images [N, 48, 64]."""
        raise NotImplementedError


class Uniformity(ImageMonitor):
    """A blank image: black, white or covered."""

    name, reason = "uniformity", "the image is blank"

    def judge(self, image: np.ndarray) -> np.ndarray:
        """Negative standard deviation of the image."""
        return -image.std(axis=(1, 2))


class Nearness(ImageMonitor):
    """Something right in front of the lens."""

    name, reason = "nearness", "the lens is covered"

    def judge(self, image: np.ndarray) -> np.ndarray:
        """Share of pixels nearer than 10 cm."""
        return (image < NEAR).mean(axis=(1, 2))
