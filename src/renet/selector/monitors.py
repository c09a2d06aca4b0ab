"""Ways to notice that vision or memory failed: the paper's reconstruction loss, and others.

An autoencoder does not notice a frozen image, a blank one, late or missing frames and filled holes:
each frame by itself looks healthy. Every monitor computes one score per robot; vision is healthy
while every score is below its monitor's threshold. Thresholds are calibrated from scores of healthy
runs (`renet.selector.calibration`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from renet.interface import DEPTH_SHAPE

NEAR = 0.05
"""Normalised depth (10 cm of 2 m) below which a stereo camera sees nothing real (paper, IV-D)."""
COVERED = 0.4
"""With a larger share of an image's pixels nearer than `NEAR` the lens may be covered."""


def _absent() -> np.ndarray:
    return np.zeros(0)


@dataclass(frozen=True)
class SelectorInput:
    """What N robots know of their vision at one moment; absent parts suit the paper's selector."""

    anomaly_score: np.ndarray
    """Loss_ad of the newest images, [N]."""
    image: np.ndarray = field(default_factory=_absent)
    """Newest image delivered, [N, 48, 64] in [0, 1]; a new array whenever one arrives."""
    fresh: np.ndarray = field(default_factory=_absent)
    """True where that image arrived since the last update, [N]."""
    age: np.ndarray = field(default_factory=_absent)
    """Seconds since it arrived, [N]."""
    invalid: np.ndarray = field(default_factory=_absent)
    """Share of its pixels without a measurement, before holes were filled, [N]."""
    velocity_op: np.ndarray = field(default_factory=_absent)
    """The OP estimator's base velocity, [N, 3] m/s."""
    velocity_vp: np.ndarray = field(default_factory=_absent)
    """The VP estimator's, [N, 3] m/s."""
    variance_score: np.ndarray = field(default_factory=_absent)
    """Mean squared error of the newest images over its predicted variance, [N]; zero from models
    that predict none."""
    has_image: np.ndarray = field(default_factory=_absent)
    """Whether VP's newest tick had an image, [N] bool."""
    map_error: np.ndarray = field(default_factory=_absent)
    """Error of the height map ahead that VP expects, [N] m; zero from models that predict none."""


@dataclass(frozen=True)
class Gate:
    """Which images of a tick VP may use: an image that is spoilt is withheld in that very tick."""

    acceptable: np.ndarray
    """[N] bool: new, and no monitor objects before the vision model has run."""
    limits: Mapping[str, float]
    """By name of the vision model's output: a score that is not below is objected to."""
    robots: np.ndarray | bool = True
    """[N] bool: whom it binds; the others' images are theirs, whatever they show."""

    def judge(self, scores: Mapping[str, np.ndarray]) -> np.ndarray:
        """[N] bool: the images that VP may use, given the vision model's scores [N] by name."""
        verdicts = [scores[name] < limit for name, limit in self.limits.items()]
        return np.logical_and.reduce([self.acceptable, *verdicts]) | ~np.asarray(self.robots)


@dataclass(frozen=True)
class Monitor:
    """How one monitor scores its input, what it says, and between which limits its threshold is."""

    reason: str
    """Said when it is the first to object."""
    score: Callable[[SelectorInput, Monitors], np.ndarray]
    """How suspicious vision is, [N]; larger is worse."""
    limit: float
    """A larger threshold would switch the monitor off: no bundle may hold one."""
    fallback: float | None = None
    """Threshold in bundles that were never calibrated; without it the monitor is calibrated or not
    used."""
    floor: float = -math.inf
    """Calibration never goes below this: a simulated camera has no holes and never misses a frame,
    so that healthy runs say nothing of what a real one may be forgiven."""
    ceiling: float = math.inf
    """Nor above this, whatever healthy runs say: a blank image or a covered lens must be
    noticed."""
    output: str = ""
    """Output of the vision model that it judges; empty: it needs none."""
    of_image: bool = True
    """Whether it judges an image, which is withheld then; else it judges the estimators, and OP
    takes over."""


class Monitors:
    """Scores N robots with some of the `MONITORS`; each image is judged once."""

    def __init__(self, names: Collection[str], num_robots: int) -> None:
        self.names = [name for name in MONITORS if name in names]
        self.repeats = np.zeros(num_robots)
        """Equal images that arrived in a row, [N]."""
        self.contrast = np.zeros(num_robots)
        """Standard deviation of the newest image, [N]."""
        self.near = np.zeros(num_robots)
        """Consecutive images with over two fifths of the pixels nearer than 10 cm, [N]."""
        self._image: np.ndarray | None = None
        self._last = np.full((num_robots, *DEPTH_SHAPE), np.nan)

    def scores(self, seen: SelectorInput, names: Sequence[str] | None = None) -> np.ndarray:
        """Scores of some monitors, of all in the order of `names` by default, [monitors, N]."""
        if seen.image.size and seen.image is not self._image:
            self._image = seen.image
            self.contrast = seen.image.std(axis=(1, 2))
        if seen.fresh.any():
            same = (seen.image == self._last).all(axis=(1, 2))
            near = (seen.image < NEAR).mean(axis=(1, 2)) > COVERED
            self.repeats = np.where(seen.fresh, np.where(same, self.repeats + 1, 1), self.repeats)
            self.near = np.where(seen.fresh, np.where(near, self.near + 1, 0), self.near)
            self._last = np.where(seen.fresh[:, None, None], seen.image, self._last)
        chosen = self.names if names is None else names
        return np.array([MONITORS[name].score(seen, self) for name in chosen])

    def reset(self, mask: np.ndarray) -> None:
        """Forget the last images of the masked robots [N]."""
        self.repeats[mask] = self.near[mask] = 0
        self._last[mask] = np.nan


def _disagreement(seen: SelectorInput, images: Monitors) -> np.ndarray:
    """Distance of both estimators' velocities, m/s: one that sees nonsense drifts away."""
    apart = seen.velocity_op - seen.velocity_vp
    return np.sqrt(np.vecdot(apart, apart))


MONITORS = {
    # The first to object is named as the reason: the plainest causes come first.
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
        # A robot that climbs a platform touches it with its nose for half a second. Not calibrated.
        lambda seen, images: images.near,
        limit=20.0,
        fallback=10.0,  # A second.
        floor=10.0,
        ceiling=10.0,
    ),
    # The error by how unusual it is: edges are hard to draw, flat ground is not. Not every model
    # predicts a variance. Healthy images score about 1.
    "variance": Monitor(
        "images unlike those of training",
        lambda seen, images: seen.variance_score,
        limit=100.0,
        output="variance_score",
    ),
    # The paper's: the autoencoder cannot rebuild the image; without a calibrated threshold β is
    # used. Images are in [0, 1]: predicting 0.5 everywhere is wrong by 0.25 at most.
    "reconstruction": Monitor(
        "images unlike those of training",
        lambda seen, images: seen.anomaly_score,
        limit=0.25,
        output="anomaly_score",
    ),
    # It has no natural scale.
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
