"""Monitors of vision and memory: the paper's reconstruction loss, and others.

An autoencoder's loss does not notice frozen, blank, late or missing images, or filled holes,
because each image alone looks healthy. Every monitor computes one score for each robot. Vision is
healthy while each score is below its threshold, which is calibrated on healthy runs
(`selector/calibration.py`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from renet.interface import DEPTH_SHAPE

NEAR = 0.05
"""Normalised depth (10 cm of 2 m) below which a stereo camera measures nothing (paper, IV-D)."""
COVERED = 0.4
"""Share of an image's pixels nearer than `NEAR` above which the lens may be covered."""
PATCH = 4
"""Side of the patches of an image that are compared with those of the image before, pixels."""
FROZEN_PATCHES = 8
"""Smallest number of equal patches, of 192, with which part of an image counts as frozen."""


def _absent() -> np.ndarray:
    """Return the default of fields that a selector may not need."""
    return np.zeros(0)


@dataclass(frozen=True)
class SelectorInput:
    """State of N robots' vision at one time; the paper's selector needs the anomaly score alone."""

    anomaly_score: np.ndarray
    """Reconstruction loss Loss_ad of the newest images, [N]."""
    image: np.ndarray = field(default_factory=_absent)
    """Newest image delivered, [N, 48, 64] in [0, 1]; another array for each new image."""
    fresh: np.ndarray = field(default_factory=_absent)
    """True where that image arrived since the last update, [N] bool."""
    age: np.ndarray = field(default_factory=_absent)
    """Time since it was taken, [N] s."""
    invalid: np.ndarray = field(default_factory=_absent)
    """Share of its pixels without a measurement, before holes were filled, [N]."""
    velocity_op: np.ndarray = field(default_factory=_absent)
    """Base velocity that OP estimates, base frame, [N, 3] m/s."""
    velocity_vp: np.ndarray = field(default_factory=_absent)
    """Base velocity that VP estimates, base frame, [N, 3] m/s."""
    variance_score: np.ndarray = field(default_factory=_absent)
    """Mean squared error of the newest images over its predicted variance, [N]; zero if the model
    predicts none."""
    surprise: np.ndarray = field(default_factory=_absent)
    """Contradiction between the newest images and what was expected, [N]; zero if the model expects
    no images."""
    stillness: np.ndarray = field(default_factory=_absent)
    """Share of the expected change that the last images lack, [N]; zero if the model expects no
    images."""
    has_image: np.ndarray = field(default_factory=_absent)
    """True where VP's newest tick had an image, [N] bool."""
    map_error: np.ndarray = field(default_factory=_absent)
    """Error of the height map ahead that VP expects, [N] m; zero if the model predicts none."""
    scored: bool = True
    """False while the vision model has not judged the newest images yet: scores are of earlier
    ones."""


@dataclass(frozen=True)
class Gate:
    """Gate that withholds bad images from VP, in the same tick in which they arrive."""

    acceptable: np.ndarray
    """True for images that are new and on time, and to which no monitor objects before the vision
    model has run, [N] bool."""
    limits: Mapping[str, float]
    """Smallest score to object to, by name of the vision model's output."""
    robots: np.ndarray | bool = True
    """True for robots whose images the gate withholds, [N] bool; others use all images."""
    fresh: np.ndarray | bool = True
    """True for images that are new, [N] bool."""

    @classmethod
    def open(cls, fresh: np.ndarray) -> Gate:
        """Return a gate that withholds no image; `fresh` is True for those that are new, [N]."""
        return cls(np.ones(len(fresh), bool), {}, fresh=fresh)

    def of(self, rows: np.ndarray) -> Gate:
        """Return the gate of some robots, given by their rows."""
        robots = self.robots[rows] if isinstance(self.robots, np.ndarray) else self.robots
        fresh = self.fresh[rows] if isinstance(self.fresh, np.ndarray) else self.fresh
        return replace(self, acceptable=self.acceptable[rows], fresh=fresh, robots=robots)

    def judge(self, scores: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return a mask of images that VP may use, [N] bool, given scores [N] by output."""
        verdicts = [scores[name] < limit for name, limit in self.limits.items()]
        return np.logical_and.reduce([self.acceptable, *verdicts]) | ~np.asarray(self.robots)


@dataclass(frozen=True)
class Monitor:
    """Score, reason and range of thresholds of one monitor."""

    reason: str
    """Reason to show if this monitor is the first to object."""
    score: Callable[[SelectorInput, Scorer], np.ndarray]
    """Function that computes the score, [N]; larger is worse."""
    limit: float
    """Largest threshold in a bundle; a larger one would switch the monitor off."""
    fallback: float | None = None
    """Threshold in bundles that were never calibrated; None if such bundles do not use the
    monitor."""
    floor: float = -math.inf
    """Smallest calibrated threshold. A simulated camera has no holes and misses no frames, so that
    healthy runs do not show the threshold that a real one needs."""
    ceiling: float = math.inf
    """Largest calibrated threshold, at which a blank image or a covered lens is still noticed."""
    in_a_row: int = 1
    """Number of scores in a row that must exceed the threshold for an alarm. Fewer withhold their
    own images alone."""
    output: str = ""
    """Output of the vision model that the monitor judges; empty if it needs none."""
    of_image: bool = True
    """True for a monitor of images, which withholds the image; False for one of the estimators,
    with which OP takes over."""


class Scorer:
    """Scores of N robots' vision, with the facts about past images that they need."""

    def __init__(self, num_robots: int) -> None:
        self.repeats = np.zeros(num_robots)
        """Number of equal images that arrived in a row, [N]."""
        self.contrast = np.zeros(num_robots)
        """Standard deviation of the newest image, [N]."""
        self.partly_equal = np.zeros(num_robots)
        """Number of images in a row that are equal in part, [N] (see `FROZEN_PATCHES`)."""
        self.near = np.zeros(num_robots)
        """Number of consecutive images of a covered lens, [N] (see `COVERED`)."""
        self._image: np.ndarray | None = None
        self._last = np.full((num_robots, *DEPTH_SHAPE), np.nan)

    def scores(self, seen: SelectorInput, names: Iterable[str] | None = None) -> np.ndarray:
        """Count the fresh images, and score all robots by monitors: [monitors, N].

        Args:
            seen: State of vision, with the fields that these monitors need.
            names: Names of the monitors; None for all of them, in the order of `MONITORS`.
        """
        # Computed once for each new array of images.
        if seen.image.size and seen.image is not self._image:
            self._image = seen.image
            self.contrast = seen.image.std(axis=(1, 2))
        if seen.fresh.any():
            equal = seen.image == self._last
            same = equal.all(axis=(1, 2))
            frozen = _frozen_patches(seen.image, equal) >= FROZEN_PATCHES
            near = (seen.image < NEAR).mean(axis=(1, 2)) > COVERED
            repeats = np.where(same, self.repeats + 1, 1)
            partly_equal = np.where(frozen, self.partly_equal + 1, 1)
            covered = np.where(near, self.near + 1, 0)
            self.repeats = np.where(seen.fresh, repeats, self.repeats)
            self.partly_equal = np.where(seen.fresh, partly_equal, self.partly_equal)
            self.near = np.where(seen.fresh, covered, self.near)
            self._last = np.where(seen.fresh[:, None, None], seen.image, self._last)
        names = MONITORS if names is None else names
        scores = [MONITORS[name].score(seen, self) for name in names]
        return np.array(scores).reshape(-1, len(self.repeats))

    def reset(self, mask: np.ndarray) -> None:
        """Forget the last images of the masked robots, [N] bool."""
        self.repeats[mask] = 0
        self.partly_equal[mask] = 0
        self.near[mask] = 0
        self._last[mask] = np.nan


def _frozen_patches(image: np.ndarray, equal: np.ndarray) -> np.ndarray:
    """Count the patches that show again what they showed before, [N].

    A patch of one depth does not count: it may lie beyond the camera's range, or in a filled hole.

    Args:
        image: Images, [N, 48, 64] in [0, 1].
        equal: True for pixels that are equal to those of the image before, [N, 48, 64] bool.
    """
    corner = image[:, ::PATCH, ::PATCH]
    unchanged = np.ones(corner.shape, bool)
    varied = np.zeros(corner.shape, bool)
    # One pixel of all patches at a time, which is many times faster than reductions by patch.
    for row, column in product(range(PATCH), repeat=2):
        unchanged &= equal[:, row::PATCH, column::PATCH]
        varied |= image[:, row::PATCH, column::PATCH] != corner
    return (unchanged & varied).sum(axis=(1, 2))


def _disagreement(seen: SelectorInput, images: Scorer) -> np.ndarray:
    """Compute the distance of both estimators' velocities, [N] m/s.

    It grows if VP reads images that make no sense.
    """
    apart = seen.velocity_op - seen.velocity_vp
    return np.sqrt(np.vecdot(apart, apart))


MONITORS = {
    # The first monitor that objects gives the reason, so that the simplest causes come first.
    "frame_age": Monitor(
        "no new image",
        lambda seen, images: seen.age,
        limit=1.0,
        # Two missed frames at 10 Hz.
        fallback=0.2,
        floor=0.2,
    ),
    "duplicate": Monitor(
        # The noise of a live stereo camera never repeats.
        "the image is frozen",
        lambda seen, images: images.repeats,
        limit=10.0,
        fallback=3.0,
        floor=3.0,
    ),
    "partly_frozen": Monitor(
        # That noise repeats in no part of the image, either.
        "part of the image is frozen",
        lambda seen, images: images.partly_equal,
        limit=10.0,
        fallback=3.0,
        floor=3.0,
    ),
    "invalid_fraction": Monitor(
        # Holes are filled before the autoencoder sees the image.
        "too many pixels without depth",
        lambda seen, images: seen.invalid,
        limit=0.9,
        # In a cropped image of a D435 it is below 0.1.
        fallback=0.25,
        floor=0.25,
    ),
    "uniformity": Monitor(
        # Black, white or covered.
        "the image is blank",
        lambda seen, images: -images.contrast,
        limit=-0.005,
        fallback=-0.03,
        ceiling=-0.005,
    ),
    "nearness": Monitor(
        "the lens is covered",
        # Floor and ceiling are equal: a second, because a robot that climbs a platform has its
        # camera close to it for half a second.
        lambda seen, images: images.near,
        limit=20.0,
        fallback=10.0,
        floor=10.0,
        ceiling=10.0,
    ),
    # The error relative to its predicted variance, because edges are harder to reconstruct than
    # flat ground. The score of healthy images is about 1. Not every model predicts a variance.
    "variance": Monitor(
        "images unlike those of training",
        lambda seen, images: seen.variance_score,
        limit=100.0,
        output="variance_score",
    ),
    # The paper's monitor, with beta as its fallback. The limit is the largest error of a model that
    # predicts 0.5 everywhere, because images are in [0, 1].
    "reconstruction": Monitor(
        "images unlike those of training",
        lambda seen, images: seen.anomaly_score,
        limit=0.25,
        output="anomaly_score",
    ),
    # Images that lie plausibly. A healthy one surprises where an edge comes into view, the next one
    # hardly ever. The limit is beyond the score of an error of the whole range.
    "surprise": Monitor(
        "the image contradicts what was seen before",
        lambda seen, images: seen.surprise,
        limit=8.0,
        in_a_row=2,
        output="surprise",
    ),
    # Images that stand still in part or trail behind. The limit is below the score of images that
    # do not move at all.
    "stillness": Monitor(
        "the image does not move with the robot",
        lambda seen, images: seen.stillness,
        limit=0.9,
        output="stillness",
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
