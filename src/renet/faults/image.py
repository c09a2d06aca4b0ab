"""Faults of single images: noise, dirt, light and optics.

Depths are normalised: 1 is `DEPTH_RANGE` metres. Only faults whose docstring speaks of holes raise
`Frames.invalid`; the others deliver wrong numbers as measurements.
"""

from dataclasses import replace

import numpy as np

from renet.camera import Intrinsics
from renet.faults.base import Frames, ImageFault
from renet.interface import DEPTH_RANGE, DEPTH_SHAPE

ROWS, COLUMNS = DEPTH_SHAPE


def smooth_field(rng: np.random.Generator, cells: tuple[int, int] = (6, 8)) -> np.ndarray:
    """Draw spatially correlated noise, [48, 64]: normal numbers on a coarse grid, interpolated.

    Args:
        rng: Random stream.
        cells: Rows and columns of the grid's cells.
    """
    coarse = rng.standard_normal((cells[0] + 1, cells[1] + 1))
    # Cell of each pixel, and the pixel's position in it from 0 to 1.
    row = np.linspace(0, cells[0], ROWS)
    column = np.linspace(0, cells[1], COLUMNS)
    top = np.minimum(row.astype(int), cells[0] - 1)[:, None]
    left = np.minimum(column.astype(int), cells[1] - 1)
    down = row[:, None] - top
    right = column - left
    # Bilinear interpolation.
    upper = coarse[top, left] * (1 - right) + coarse[top, left + 1] * right
    lower = coarse[top + 1, left] * (1 - right) + coarse[top + 1, left + 1] * right
    return upper * (1 - down) + lower * down


def fill_from_left(image: np.ndarray, holes: np.ndarray) -> np.ndarray:
    """Fill each hole from its left, else from its right, else from the row above.

    This is RealSense's "fill from left", which leaves a smooth and plausible image.
    """
    # Nearest measured column to the left, or the first measured one of the row.
    columns = np.arange(image.shape[1])
    left = np.maximum.accumulate(np.where(holes, -1, columns), axis=1)
    first = np.argmin(holes, axis=1)[:, None]
    source = np.where(left < 0, first, left)
    result = np.take_along_axis(image, source, axis=1)
    # Rows without any measurement copy the nearest row above with one, or the first such row.
    empty = holes.all(axis=1)
    rows = np.maximum.accumulate(np.where(empty, -1, np.arange(len(image))))
    return result[np.where(rows < 0, np.argmin(empty), rows)]


class Gaussian(ImageFault):
    """Grain on every pixel and frame; level is its standard deviation, image range 1."""

    unit = "σ"
    levels = (0.1, 0.3, 0.5, 0.7, 1.0)  # The paper has 0.3, 0.7 and 1.

    def spoil(self, image: np.ndarray, robot: int, elapsed: float) -> np.ndarray:
        noise = self.rngs[robot].standard_normal(image.shape, dtype=np.float32)
        return image + np.float32(self.level) * noise


class SaltAndPepper(ImageFault):
    """Random pixels become nearest or farthest, half each; level is their share."""

    unit = "share"
    levels = (0.05, 0.1, 0.3, 0.5, 0.7)  # The paper has 0.1, 0.3 and 0.7.

    def spoil(self, image: np.ndarray, robot: int, elapsed: float) -> np.ndarray:
        draw = self.rngs[robot].random(image.shape, dtype=np.float32)
        spoilt = np.where(draw < self.level, np.float32(1.0), image)
        return np.where(draw < 0.5 * self.level, np.float32(0.0), spoilt)


class Blackout(ImageFault):
    """The picture fades to all zeros; level is the seconds the fade takes."""

    unit = "s fade"
    levels = (1.0, 0.5, 0.2, 0.1, 0.0)

    def spoil(self, image: np.ndarray, robot: int, elapsed: float) -> np.ndarray:
        remaining = 1.0 - elapsed / self.level if self.level > 0 else 0.0
        return image * np.float32(max(remaining, 0.0))


class Saturated(ImageFault):
    """The top rows read the farthest depth; level is their share of the image."""

    unit = "share"
    levels = (0.2, 0.4, 0.6, 0.8, 1.0)

    def spoil(self, image: np.ndarray, robot: int, elapsed: float) -> np.ndarray:
        spoilt = image.copy()
        spoilt[: round(self.level * ROWS)] = 1.0
        return spoilt


class Occlusion(ImageFault):
    """Something close to the lens: a rectangle reads 4 cm; level is its share of the image."""

    unit = "share"
    levels = (0.1, 0.25, 0.5, 0.75, 1.0)

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        height = round(ROWS * np.sqrt(self.level))
        width = round(COLUMNS * np.sqrt(self.level))
        top = rng.integers(0, ROWS - height + 1)
        left = rng.integers(0, COLUMNS - width + 1)
        pattern = np.zeros(DEPTH_SHAPE, bool)
        pattern[top : top + height, left : left + width] = True
        return pattern

    def spoil(self, image: np.ndarray, robot: int, elapsed: float) -> np.ndarray:
        return np.where(self.patterns[robot], np.float32(0.04 / DEPTH_RANGE), image)


class Blobs(ImageFault):
    """Dirt or drops on the lens: near discs of 1 to 4 pixels radius; level is their number."""

    unit = "blobs"
    levels = (2, 5, 10, 20, 30)

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """Draw the depth of each pixel's blob; NaN without one."""
        rows, columns = np.mgrid[:ROWS, :COLUMNS]
        pattern = np.full(DEPTH_SHAPE, np.nan, np.float32)
        for _ in range(int(self.level)):
            row = rng.uniform(0, ROWS)
            column = rng.uniform(0, COLUMNS)
            radius = rng.uniform(1, 4)
            inside = (rows - row) ** 2 + (columns - column) ** 2 <= radius**2
            pattern[inside] = rng.uniform(0.03, 0.2) / DEPTH_RANGE
        return pattern

    def spoil(self, image: np.ndarray, robot: int, elapsed: float) -> np.ndarray:
        return np.where(np.isnan(self.patterns[robot]), image, self.patterns[robot])


class Grass(ImageFault):
    """Upright blades at 0.2 to 0.6 m, new in every frame, over the lower third (sparse) up to the
    lower two thirds (dense) of the image; level is how far between the two.
    """

    unit = "density"
    levels = (0.0, 0.25, 0.5, 0.75, 1.0)

    def spoil(self, image: np.ndarray, robot: int, elapsed: float) -> np.ndarray:
        rng = self.rngs[robot]
        covered = ROWS * (1 + self.level) / 3
        present = rng.random(COLUMNS) < 0.25 + 0.7 * self.level
        tips = ROWS - covered * rng.uniform(0.6, 1.0, COLUMNS)
        blades = present & (np.arange(ROWS)[:, None] >= tips)
        depth = rng.uniform(0.2 / DEPTH_RANGE, 0.6 / DEPTH_RANGE, COLUMNS).astype(np.float32)
        return np.where(blades, np.minimum(image, depth), image)


class Glare(ImageFault):
    """Sun blinds the stereo pair: correlated holes, read as zero; level is their share."""

    unit = "share"
    levels = (0.05, 0.15, 0.3, 0.5, 0.8)

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        return smooth_field(rng)

    def spoil(self, image: np.ndarray, robot: int, elapsed: float) -> np.ndarray:
        """The image without a fixed patch, whose border flickers."""
        field = self.patterns[robot] + 0.25 * smooth_field(self.rngs[robot], (12, 16))
        return np.where(field > np.quantile(field, 1 - self.level), np.nan, image)


class GlareFilled(Glare):
    """As glare, but the driver fills the holes from their left: smooth and plausible."""

    def fill(self, image: np.ndarray, holes: np.ndarray) -> np.ndarray:
        return fill_from_left(image, holes)


class NearField(ImageFault):
    """Depths below the level become holes, which read zero: too close for a stereo camera.

    The paper has about 10 cm, at stairs.
    """

    unit = "m"
    levels = (0.1, 0.15, 0.2, 0.3, 0.5)

    def spoil(self, image: np.ndarray, robot: int, elapsed: float) -> np.ndarray:
        return np.where(image < self.level / DEPTH_RANGE, np.nan, image)


class WrongScale(ImageFault):
    """Every depth is multiplied by the level: its unit or the baseline's calibration is off."""

    unit = "factor"
    levels = (0.9, 0.8, 0.6, 1.3, 1.6)

    def spoil(self, image: np.ndarray, robot: int, elapsed: float) -> np.ndarray:
        return image * np.float32(self.level)


class MotionBlur(ImageFault):
    """Smeared by the base's pitch and yaw rate during the exposure; level is its length.

    The camera is taken to look straight ahead of the base.
    """

    unit = "ms"
    levels = (5, 10, 20, 30, 40)
    samples = 9

    def corrupt(self, frames: Frames, elapsed: np.ndarray) -> Frames:
        """Average the image along its motion during the exposure."""
        image = frames.image.copy()
        # Nose down moves the picture up, a turn to the left moves it right.
        pixels = np.array((-1.0, 1.0)) * (self.level * 1e-3 * Intrinsics.fx)
        travel = frames.angular_velocity[:, 1:] * pixels
        for i in np.flatnonzero(elapsed >= 0).tolist():
            shifts = np.linspace(-0.5, 0.5, self.samples)[:, None] * travel[i]
            image[i] = np.mean([shifted(image[i], *shift) for shift in shifts], axis=0)
        return replace(frames, image=image)


def shifted(image: np.ndarray, down: float, right: float) -> np.ndarray:
    """Move an image [48, 64] by fractions of pixels; the border is repeated."""
    # Interpolate linearly, first between rows and then between columns.
    for axis, shift in ((0, down), (1, right)):
        size = image.shape[axis]
        source = np.clip(np.arange(size) - shift, 0, size - 1)
        low = np.minimum(source.astype(int), size - 2)
        weight = np.expand_dims((source - low).astype(np.float32), 1 - axis)
        image = np.take(image, low, axis) * (1 - weight) + np.take(image, low + 1, axis) * weight
    return image
