"""Ways to notice that vision failed, beyond the paper's reconstruction loss.

An autoencoder is blind to a frozen image, a blank one, late or missing frames and filled holes:
each frame by itself looks fine. Every monitor turns what it sees into one score per robot; a robot
is healthy while its score stays below the monitor's threshold, and thresholds are calibrated from
scores of healthy runs (`renet.selector.calibration`).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from renet.errors import RenetError
from renet.interface import DEPTH_SHAPE

NEAR = 0.05
"""Normalised depth (10 cm of 2 m) below which a stereo camera sees nothing real (paper, IV-D)."""


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


class Monitor:
    """One score per robot against one threshold."""

    name: ClassVar[str]
    reason: ClassVar[str]
    """Said when it is the first to object."""
    judges: ClassVar[str]
    """Part of the input that is its score; monitors that compute theirs need none."""

    def __init__(self, threshold: float) -> None:
        self.threshold = threshold

    def score(self, seen: SelectorInput) -> np.ndarray:
        """How suspicious vision is, [N]; larger is worse."""
        return getattr(seen, self.judges)

    def reset(self, mask: np.ndarray) -> None:
        """Forget the past of the masked robots."""


class Reconstruction(Monitor):
    """The paper's: the autoencoder cannot rebuild the image."""

    name, reason = "reconstruction", "images unlike those of training"
    judges = "anomaly_score"


class Variance(Monitor):
    """The autoencoder's error by how unusual it is: edges are hard to draw, flat ground is not."""

    name, reason, judges = "variance", "images unlike those of training", "variance_score"


class FrameAge(Monitor):
    """No image arrives; at 10 Hz a threshold of 0.2 s is two missed frames."""

    name, reason, judges = "frame_age", "no new image", "age"


class InvalidFraction(Monitor):
    """Too many holes before filling, which hides them from the reconstruction."""

    name, reason, judges = "invalid_fraction", "too many pixels without depth", "invalid"


class Disagreement(Monitor):
    """Both estimators know the body's velocity; one that sees nonsense drifts away."""

    name, reason = "disagreement", "the estimators disagree on velocity"

    def score(self, seen: SelectorInput) -> np.ndarray:
        """Distance of both velocities, m/s."""
        apart = seen.velocity_op - seen.velocity_vp
        return np.sqrt(np.vecdot(apart, apart))


class FrozenFrame(Monitor):
    """The same image again and again: live stereo noise never repeats."""

    name, reason = "duplicate", "the image is frozen"

    def __init__(self, num_robots: int, threshold: float) -> None:
        super().__init__(threshold)
        self._last = np.full((num_robots, *DEPTH_SHAPE), np.nan)
        self._run = np.zeros(num_robots)

    def score(self, seen: SelectorInput) -> np.ndarray:
        """How many equal images arrived in a row."""
        if not seen.fresh.any():
            return self._run
        same = (seen.image == self._last).all(axis=(1, 2))
        self._run = np.where(seen.fresh, np.where(same, self._run + 1, 1), self._run)
        self._last = np.where(seen.fresh[:, None, None], seen.image, self._last)
        return self._run

    def reset(self, mask: np.ndarray) -> None:
        """Forget the masked robots' last images."""
        self._run[mask] = 0
        self._last[mask] = np.nan


class ImageMonitor(Monitor):
    """Judges each image by itself, and each only once."""

    def __init__(self, threshold: float) -> None:
        super().__init__(threshold)
        self._image: np.ndarray | None = None
        self._score = np.zeros(0)

    def score(self, seen: SelectorInput) -> np.ndarray:
        """Its score, computed once for each new image array."""
        if seen.image is not self._image:
            self._image, self._score = seen.image, self.judge(seen.image)
        return self._score

    def judge(self, image: np.ndarray) -> np.ndarray:
        """The score of images [N, 48, 64]."""
        raise NotImplementedError


class LowContrast(ImageMonitor):
    """A blank image: black, white or covered."""

    name, reason = "uniformity", "the image is blank"

    def judge(self, image: np.ndarray) -> np.ndarray:
        """Negative standard deviation of the image."""
        return -image.std(axis=(1, 2))


class NearFraction(ImageMonitor):
    """Something right in front of the lens."""

    name, reason = "nearness", "the lens is covered"

    def judge(self, image: np.ndarray) -> np.ndarray:
        """Share of pixels nearer than 10 cm."""
        return (image < NEAR).mean(axis=(1, 2))


MONITORS: dict[str, type[Monitor]] = {
    # The first to object is named as the reason: the plainest causes come first.
    monitor.name: monitor
    for monitor in (
        FrameAge,
        FrozenFrame,
        InvalidFraction,
        LowContrast,
        NearFraction,
        Variance,
        Reconstruction,
        Disagreement,
    )
}
FALLBACK = {
    "frame_age": 0.2,
    "duplicate": 3.0,
    "invalid_fraction": 0.25,
    "uniformity": -0.03,
    "nearness": 0.5,
}
"""Thresholds for bundles that were never calibrated: two missed frames, three equal images, a
quarter of the pixels without depth (a cropped D435 image has under a tenth), an image without
contrast, a lens half covered. Reconstruction falls back to the paper's β. Variance and disagreement
are calibrated or not used: not every model has the one, the other has no natural scale."""
FLOORS = {name: FALLBACK[name] for name in ("frame_age", "duplicate", "invalid_fraction")}
"""Calibration never goes below these: a simulated camera has no holes and never misses a frame, so
that healthy runs say nothing of what a real one may be forgiven."""

CEILINGS = {"uniformity": -0.005, "nearness": 0.9}
"""Nor above these, whatever healthy runs say: a blank image or a covered lens must be noticed."""
LIMITS = CEILINGS | {
    "frame_age": 1.0,
    "duplicate": 10.0,
    "invalid_fraction": 0.9,
    "variance": 100.0,
    "reconstruction": 0.25,
    "disagreement": 3.0,
}
"""Thresholds above these would switch a monitor off: images are in [0, 1], and predicting 0.5
everywhere is wrong by 0.25 at most; healthy images have a variance score of about 1."""
SLOWEST = 1.0
"""Longest delay of the filter in seconds."""


def default_monitors(
    beta: float, thresholds: Mapping[str, float], num_robots: int
) -> list[Monitor]:
    """Fresh monitors for N robots.

    Args:
        beta: the paper's threshold on the anomaly score.
        thresholds: calibrated ones by monitor name; those missing use `FALLBACK`, reconstruction β
            unless there is one of the variance, which judges the same images better.
        num_robots: N.

    Raises:
        RenetError: a threshold for a monitor that does not exist.
    """
    unknown = sorted(set(thresholds) - set(MONITORS))
    if unknown:
        raise RenetError(f"unknown monitor '{unknown[0]}': choose among {', '.join(MONITORS)}")
    known = FALLBACK | dict(thresholds)
    if "variance" not in thresholds:
        known = {"reconstruction": beta} | known
    return [
        FrozenFrame(num_robots, known[name]) if monitor is FrozenFrame else monitor(known[name])
        for name, monitor in MONITORS.items()
        if name in known
    ]
