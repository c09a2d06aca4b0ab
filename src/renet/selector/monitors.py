"""Monitors of vision and memory: the paper's reconstruction loss, and others.

The loss of an autoencoder misses a frozen, blank, late or dropped image and filled holes, because
each frame by itself looks healthy. Every monitor computes one score per robot. Vision is healthy
while each score is below its threshold, calibrated on healthy runs (`selector/calibration.py`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from renet.interface import DEPTH_SHAPE

NEAR = 0.05
"""Normalised depth (10 cm of 2 m) below which a stereo camera measures nothing (paper, IV-D)."""
COVERED = 0.4
"""Share of an image's pixels nearer than `NEAR` above which the lens may be covered."""


def _absent() -> np.ndarray:
    return np.zeros(0)


@dataclass(frozen=True)
class SelectorInput:
    """The state of N robots' vision at one moment; the paper's selector needs the score alone."""

    anomaly_score: np.ndarray
    """Reconstruction loss Loss_ad of the newest images, [N]."""
    image: np.ndarray = field(default_factory=_absent)
    """Newest image delivered, [N, 48, 64] in [0, 1]; a new array whenever one arrives."""
    fresh: np.ndarray = field(default_factory=_absent)
    """Whether that image arrived since the last update, [N] bool."""
    age: np.ndarray = field(default_factory=_absent)
    """Seconds since it arrived, [N]."""
    invalid: np.ndarray = field(default_factory=_absent)
    """Share of its pixels without a measurement, before holes were filled, [N]."""
    velocity_op: np.ndarray = field(default_factory=_absent)
    """The OP estimator's base velocity, [N, 3] m/s."""
    velocity_vp: np.ndarray = field(default_factory=_absent)
    """The VP estimator's base velocity, [N, 3] m/s."""
    variance_score: np.ndarray = field(default_factory=_absent)
    """Mean squared error of the newest images over its predicted variance, [N]; zero from models
    that predict none."""
    has_image: np.ndarray = field(default_factory=_absent)
    """Whether VP's newest tick had an image, [N] bool."""
    map_error: np.ndarray = field(default_factory=_absent)
    """Error of the height map ahead that VP expects, [N] m; zero from models that predict none."""


@dataclass(frozen=True)
class Gate:
    """Which images of a tick VP may use; a spoilt image is withheld in the tick it arrives in."""

    acceptable: np.ndarray
    """[N] bool: new, of a camera that is on time, and no monitor objects before the vision model
    has run."""
    limits: Mapping[str, float]
    """Least score that is objected to, by name of the vision model's output."""
    robots: np.ndarray | bool = True
    """[N] bool: the robots it binds; the others use all their images."""

    def of(self, rows: np.ndarray) -> Gate:
        """The gate of some robots, by their rows."""
        robots = self.robots[rows] if isinstance(self.robots, np.ndarray) else self.robots
        return replace(self, acceptable=self.acceptable[rows], robots=robots)

    def judge(self, scores: Mapping[str, np.ndarray]) -> np.ndarray:
        """[N] bool: the images that VP may use, given the vision model's scores [N] by name."""
        verdicts = [scores[name] < limit for name, limit in self.limits.items()]
        return np.logical_and.reduce([self.acceptable, *verdicts]) | ~np.asarray(self.robots)


@dataclass(frozen=True)
class Monitor:
    """The score, the reason and the range of thresholds of one monitor."""

    reason: str
    """Shown when it is the first to object."""
    score: Callable[[SelectorInput, Scorer], np.ndarray]
    """How suspicious vision is, [N]; larger is worse."""
    limit: float
    """Largest threshold in a bundle; a larger one would switch the monitor off."""
    fallback: float | None = None
    """Threshold in bundles that were never calibrated; None: such bundles do not use it."""
    floor: float = -math.inf
    """Least calibrated threshold. A simulated camera has no holes and misses no frame: healthy
    runs do not show what a real one needs."""
    ceiling: float = math.inf
    """Largest calibrated threshold: a blank image or a covered lens must be noticed."""
    output: str = ""
    """Output of the vision model that it judges; empty: it needs none."""
    of_image: bool = True
    """Whether it judges an image, which is then withheld; else it judges the estimators, and OP
    takes over."""


class Scorer:
    """Scores the vision of N robots, and keeps of past images what the scores need."""

    def __init__(self, num_robots: int) -> None:
        self.repeats = np.zeros(num_robots)
        """Equal images that arrived in a row, [N]."""
        self.contrast = np.zeros(num_robots)
        """Standard deviation of the newest image, [N]."""
        self.near = np.zeros(num_robots)
        """Consecutive images with over two fifths of the pixels nearer than 10 cm, [N]."""
        self._image: np.ndarray | None = None
        self._last = np.full((num_robots, *DEPTH_SHAPE), np.nan)

    def scores(self, seen: SelectorInput, names: Iterable[str] | None = None) -> np.ndarray:
        """Count the fresh images, and score all robots by monitors: [monitors, N].

        Args:
            seen: the fields that these monitors need.
            names: of monitors; None: all of them, in the order of `MONITORS`.
        """
        if seen.image.size and seen.image is not self._image:
            self._image = seen.image
            self.contrast = seen.image.std(axis=(1, 2))
        if seen.fresh.any():
            same = (seen.image == self._last).all(axis=(1, 2))
            near = (seen.image < NEAR).mean(axis=(1, 2)) > COVERED
            self.repeats = np.where(seen.fresh, np.where(same, self.repeats + 1, 1), self.repeats)
            self.near = np.where(seen.fresh, np.where(near, self.near + 1, 0), self.near)
            self._last = np.where(seen.fresh[:, None, None], seen.image, self._last)
        names = MONITORS if names is None else names
        scores = [MONITORS[name].score(seen, self) for name in names]
        return np.array(scores).reshape(-1, len(self.repeats))

    def reset(self, mask: np.ndarray) -> None:
        """Forget the last images of the masked robots [N]."""
        self.repeats[mask] = self.near[mask] = 0
        self._last[mask] = np.nan


def _disagreement(seen: SelectorInput, images: Scorer) -> np.ndarray:
    """Distance of both estimators' velocities, m/s, which grows when VP sees nonsense."""
    apart = seen.velocity_op - seen.velocity_vp
    return np.sqrt(np.vecdot(apart, apart))


MONITORS = {
    # The first to object gives the reason: the plainest causes come first.
    "frame_age": Monitor(
        "no new image",
        lambda seen, images: seen.age,
        limit=1.0,
        fallback=0.2,  # Two missed frames at 10 Hz.
        floor=0.2,
    ),
    "duplicate": Monitor(
        "the image is frozen",  # The noise of a live stereo camera never repeats.
        lambda seen, images: images.repeats,
        limit=10.0,
        fallback=3.0,
        floor=3.0,
    ),
    "invalid_fraction": Monitor(
        "too many pixels without depth",  # Holes are filled before the reconstruction sees them.
        lambda seen, images: seen.invalid,
        limit=0.9,
        fallback=0.25,  # A cropped D435 image has under a tenth.
        floor=0.25,
    ),
    "uniformity": Monitor(
        "the image is blank",  # Black, white or covered.
        lambda seen, images: -images.contrast,
        limit=-0.005,
        fallback=-0.03,
        ceiling=-0.005,
    ),
    "nearness": Monitor(
        "the lens is covered",
        # Never calibrated. A robot that climbs a platform has its nose on it for half a second.
        lambda seen, images: images.near,
        limit=20.0,
        fallback=10.0,  # A second.
        floor=10.0,
        ceiling=10.0,
    ),
    # The error relative to its predicted variance, as edges are harder to draw than flat ground.
    # Healthy images score about 1. Not every model predicts a variance.
    "variance": Monitor(
        "images unlike those of training",
        lambda seen, images: seen.variance_score,
        limit=100.0,
        output="variance_score",
    ),
    # The paper's monitor; beta is its fallback. The limit is the largest error of predicting 0.5
    # everywhere, as images are in [0, 1].
    "reconstruction": Monitor(
        "images unlike those of training",
        lambda seen, images: seen.anomaly_score,
        limit=0.25,
        output="anomaly_score",
    ),
    "disagreement": Monitor(
        "the estimators disagree on velocity", _disagreement, limit=3.0, of_image=False
    ),
    "map_error": Monitor(
        "the memory of the ground is stale",
        lambda seen, images: seen.map_error,
        limit=1.0,
        of_image=False,
    ),
}
