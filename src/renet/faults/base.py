"""Frames of depth cameras at one vision tick, and the interface of the faults that spoil them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from renet.errors import RenetError

SEVERITIES = (1, 2, 3, 4, 5)
FOREVER = float("inf")
"""Seconds."""


@dataclass(frozen=True)
class Frames:
    """One frame of each of n cameras, as the robots receive it.

    `image` [n, 48, 64] float32 in [0, 1], the newest image delivered, which the policy sees.
    `fresh` [n] bool, whether a new frame was delivered at this tick.
    `age` [n] seconds since the newest frame was delivered, by the driver's clock.
    `invalid` [n] share of pixels without a measurement, before holes are filled.
    `angular_velocity` [n, 3] rad/s of the base during the exposure, base frame.
    """

    image: np.ndarray
    fresh: np.ndarray
    age: np.ndarray
    invalid: np.ndarray
    angular_velocity: np.ndarray

    @classmethod
    def healthy(cls, image: np.ndarray, angular_velocity: np.ndarray | None = None) -> Frames:
        """Fresh frames without holes from `image` [n, 48, 64]."""
        n = len(image)
        rate = np.zeros((n, 3), np.float32) if angular_velocity is None else angular_velocity
        image = np.asarray(image, np.float32)
        return cls(image, np.ones(n, bool), np.zeros(n), np.zeros(n), rate)

    def rows(self, index: np.ndarray) -> Frames:
        """The frames of some robots only."""
        return Frames(**{name: value[index] for name, value in vars(self).items()})

    def write(self, index: np.ndarray, other: Frames) -> None:
        """Replace the frames of the robots `index` by `other`."""
        for name, value in vars(self).items():
            value[index] = getattr(other, name)

    def copy(self) -> Frames:
        """A deep copy."""
        return Frames(**{name: value.copy() for name, value in vars(self).items()})


class Fault:
    """One way a camera fails, for n robots, each with its own random stream.

    A subclass has five severities, and spoils frames in `corrupt`. It gets every frame, before,
    during and after the fault, so that it can keep past ones. The first paragraph of its docstring
    is shown to users: what happens, and what `level` means.
    """

    name: ClassVar[str]
    """What users call it; by default as the class: EdgeShadow is edge_shadow."""
    unit: ClassVar[str]
    levels: ClassVar[tuple[float, ...]]
    """The `level` of severities 1 to 5."""
    level_is_duration: ClassVar[bool] = False
    """Whether the level is the number of seconds after which the fault ends by itself."""

    def __init_subclass__(cls) -> None:
        if "name" not in vars(cls):
            cls.name = re.sub(r"\B[A-Z]", r"_\g<0>", cls.__name__).lower()

    def __init__(self, level: float, rngs: Sequence[np.random.Generator]) -> None:
        self.level = level
        self.rngs = rngs
        self.patterns = [self.draw(rng) for rng in rngs]
        """What `draw` returned for each robot."""

    def draw(self, rng: np.random.Generator) -> Any:
        """What stays the same for a robot as long as the fault lasts, such as the place of dirt."""
        return None

    def corrupt(self, frames: Frames, elapsed: np.ndarray) -> Frames:
        """The frames after the fault.

        Args:
            frames: what the cameras delivered at this tick; not changed.
            elapsed: [n] seconds since the fault began; negative where it is not at work, which
                leaves the frames of those robots as they are.
        """
        raise NotImplementedError

    @classmethod
    def lasts(cls, level: float) -> float:
        """Seconds after which the fault ends by itself; infinity where it does not."""
        return level if cls.level_is_duration else FOREVER

    @classmethod
    def summary(cls) -> str:
        """The first paragraph of the docstring, on one line."""
        return " ".join((cls.__doc__ or "").split("\n\n")[0].split())

    @classmethod
    def describe(cls, level: float) -> str:
        """A level with its unit, such as "30 %" or "∞ s"."""
        if cls.unit == "share":
            return f"{100 * level:.0f} %"
        if cls.unit == "factor":
            return f"×{level:g}"
        return f"{level:g} {cls.unit}".replace("inf", "∞")

    @classmethod
    def level_of(cls, severity: int) -> float:
        """The level of a severity between 1 and 5."""
        if severity not in SEVERITIES:
            raise RenetError(f"severity {severity} of fault '{cls.name}': choose 1 to 5")
        return cls.levels[severity - 1]


class ImageFault(Fault):
    """A fault that spoils each image independently of other frames."""

    def corrupt(self, frames: Frames, elapsed: np.ndarray) -> Frames:
        """Spoil the images of the robots that the fault is at work on."""
        image, invalid = frames.image.copy(), frames.invalid.copy()
        for i in np.flatnonzero(elapsed >= 0).tolist():
            spoilt = self.spoil(image[i], i, float(elapsed[i]))
            holes = np.isnan(spoilt)
            invalid[i] = max(invalid[i], holes.mean())
            image[i] = np.clip(self.fill(spoilt, holes), 0.0, 1.0)
        return replace(frames, image=image, invalid=invalid)

    def spoil(self, image: np.ndarray, robot: int, elapsed: float) -> np.ndarray:
        """The spoilt image [48, 64] of one robot, of any range, NaN where nothing is measured."""
        raise NotImplementedError

    def fill(self, image: np.ndarray, holes: np.ndarray) -> np.ndarray:
        """An image [48, 64] with its holes, [48, 64] bool, filled as by the driver: with zeros."""
        return np.where(holes, np.float32(0.0), image)
