"""Frames of depth cameras at one vision tick, and the base of the faults that corrupt them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from renet.errors import RenetError

SEVERITIES = (1, 2, 3, 4, 5)
FOREVER = float("inf")
"""Duration without an end, s."""


@dataclass(frozen=True)
class Frames:
    """One frame of each of n cameras, as the robots receive it."""

    image: np.ndarray
    """Newest images delivered, which the policy sees, [n, 48, 64] float32 in [0, 1]."""
    fresh: np.ndarray
    """True where a new frame was delivered at this tick, [n] bool."""
    age: np.ndarray
    """Time since the newest frame was delivered, by the driver's clock, [n] s."""
    invalid: np.ndarray
    """Share of pixels without a measurement, before holes are filled, [n]."""
    angular_velocity: np.ndarray
    """Angular velocity of the base during the exposure, base frame, [n, 3] rad/s."""

    @classmethod
    def healthy(cls, image: np.ndarray, angular_velocity: np.ndarray | None = None) -> Frames:
        """Build fresh frames without holes from images [n, 48, 64]."""
        n = len(image)
        if angular_velocity is None:
            angular_velocity = np.zeros((n, 3), np.float32)
        return cls(
            image=np.asarray(image, np.float32),
            fresh=np.ones(n, bool),
            age=np.zeros(n),
            invalid=np.zeros(n),
            angular_velocity=angular_velocity,
        )

    def rows(self, index: np.ndarray) -> Frames:
        """Select the frames of some robots."""
        return Frames(**{name: value[index] for name, value in vars(self).items()})

    def write(self, index: np.ndarray, other: Frames) -> None:
        """Replace the frames of the robots `index` by `other`."""
        for name, value in vars(self).items():
            value[index] = getattr(other, name)

    def copy(self) -> Frames:
        """Return a deep copy."""
        return Frames(**{name: value.copy() for name, value in vars(self).items()})


class Fault:
    """Fault of a camera, for n robots, each with its own random stream.

    A subclass has five severities, and corrupts frames in `corrupt`. It receives all frames,
    before, during and after the fault, so that it can keep past ones. Users read the first
    paragraph of its docstring, which says what happens and what `level` means.
    """

    name: ClassVar[str]
    """Name for users; by default that of the class in snake case, such as edge_shadow."""
    unit: ClassVar[str]
    """Unit of the level."""
    levels: ClassVar[tuple[float, ...]]
    """Levels of severities 1 to 5."""
    level_is_duration: ClassVar[bool] = False
    """True if the level is the time in s after which the fault ends by itself."""

    def __init_subclass__(cls) -> None:
        if "name" not in vars(cls):
            cls.name = re.sub(r"\B[A-Z]", r"_\g<0>", cls.__name__).lower()

    def __init__(self, level: float, rngs: Sequence[np.random.Generator]) -> None:
        self.level = level
        self.rngs = rngs
        self.patterns = [self.draw(rng) for rng in rngs]
        """Result of `draw` for each robot."""

    def draw(self, rng: np.random.Generator) -> Any:
        """Draw a robot's pattern for the whole fault, such as the place of dirt."""
        return None

    def corrupt(self, frames: Frames, elapsed: np.ndarray) -> Frames:
        """Apply the fault to frames.

        Args:
            frames: Frames that the cameras delivered at this tick; not changed.
            elapsed: Time since the fault began, [n] s; negative where it is not active, which
                leaves the frames of those robots as they are.

        Returns:
            The corrupted frames.
        """
        raise NotImplementedError

    @classmethod
    def lasts(cls, level: float) -> float:
        """Return the time after which the fault ends by itself, s, or infinity."""
        return level if cls.level_is_duration else FOREVER

    @classmethod
    def summary(cls) -> str:
        """Return the first paragraph of the docstring on one line."""
        return " ".join((cls.__doc__ or "").split("\n\n")[0].split())

    @classmethod
    def describe(cls, level: float) -> str:
        """Format a level with its unit, such as "30 %" or "∞ s"."""
        if cls.unit == "share":
            return f"{100 * level:.0f} %"
        if cls.unit == "factor":
            return f"×{level:g}"
        return f"{level:g} {cls.unit}".replace("inf", "∞")

    @classmethod
    def level_of(cls, severity: int) -> float:
        """Return the level of a severity from 1 to 5; raises RenetError for another one."""
        if severity not in SEVERITIES:
            raise RenetError(f"severity {severity} of fault '{cls.name}': choose 1 to 5")
        return cls.levels[severity - 1]


class ImageFault(Fault):
    """Fault that corrupts each image independently of other frames."""

    def corrupt(self, frames: Frames, elapsed: np.ndarray) -> Frames:
        """Corrupt the images of robots whose fault is active."""
        image = frames.image.copy()
        invalid = frames.invalid.copy()
        for i in np.flatnonzero(elapsed >= 0).tolist():
            spoilt = self.spoil(image[i], i, float(elapsed[i]))
            holes = np.isnan(spoilt)
            invalid[i] = max(invalid[i], holes.mean())
            image[i] = np.clip(self.fill(spoilt, holes), 0.0, 1.0)
        return replace(frames, image=image, invalid=invalid)

    def spoil(self, image: np.ndarray, robot: int, elapsed: float) -> np.ndarray:
        """Corrupt an image of one robot.

        Args:
            image: The image, [48, 64] in [0, 1]; not changed.
            robot: Index of the robot.
            elapsed: Time since the fault began, s.

        Returns:
            The corrupted image, [48, 64], of any range; NaN where nothing is measured.
        """
        raise NotImplementedError

    def fill(self, image: np.ndarray, holes: np.ndarray) -> np.ndarray:
        """Fill the holes of an image as the camera's driver does, by default with zeros.

        Args:
            image: The image, [48, 64].
            holes: True at holes, [48, 64] bool.
        """
        return np.where(holes, np.float32(0.0), image)
