"""Errors of stereo cameras in good light: shadows at edges, steps, and loss without texture.

A stereo camera measures disparity d = f * baseline / depth, in pixels between its two imagers
(Keselman et al. 2017, Intel RealSense Stereoscopic Depth Cameras). `FOCAL` is in pixels of the
delivered image, so that a D435i's 50 mm and 1 m give 2.5 of its 64 pixels.
"""

import numpy as np

from renet.camera import Intrinsics
from renet.faults.base import ImageFault
from renet.faults.image import smooth_field
from renet.interface import DEPTH_RANGE

FOCAL = Intrinsics().fx
"""Focal length in pixels of the delivered image."""
BASELINE = 0.05
"""Distance between the imagers of a D435i, m."""
NEAREST_DEPTH = 0.3
"""Depth whose disparity nearer surfaces have, too, m."""
FLAT_DISPARITY = 0.15
"""Largest difference of a smooth surface's disparity from the plane of its neighbours, pixels."""


def disparity(image: np.ndarray, baseline: float) -> np.ndarray:
    """Compute the disparity of an image after a 3 x 3 median, [48, 64] pixels."""
    padded = np.pad(image, 1, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3))
    depth = np.median(windows, axis=(2, 3)) * DEPTH_RANGE
    return FOCAL * baseline / np.maximum(depth, NEAREST_DEPTH)


class EdgeShadow(ImageFault):
    """Holes left of depth edges, as wide as the disparity jumps; level is the baseline.

    Only the left imager sees what is there. A D435i's baseline is 50 mm.
    """

    unit = "mm"
    levels = (25, 50, 75, 100, 150)

    def spoil(self, image: np.ndarray, robot: int, elapsed: float) -> np.ndarray:
        """The image without the pixels that a nearer surface hides from the right imager."""
        position = np.arange(image.shape[1]) - disparity(image, 1e-3 * self.level)
        nearest = np.minimum.accumulate(position[:, ::-1], axis=1)[:, ::-1]
        hidden = np.zeros(image.shape, bool)
        hidden[:, :-1] = nearest[:, 1:] <= position[:, :-1]
        return np.where(hidden, np.nan, image)


class DisparitySteps(ImageFault):
    """Disparity of a 50 mm baseline is rounded to multiples of the level.

    The ground becomes terraces, coarser the farther away: 0.1 px are 4 cm at 1 m.
    """

    unit = "px"
    levels = (0.02, 0.05, 0.1, 0.2, 0.4)

    def spoil(self, image: np.ndarray, robot: int, elapsed: float) -> np.ndarray:
        """The image of rounded disparities; holes and pixels out of range stay as they are."""
        scale = FOCAL * BASELINE / DEPTH_RANGE
        measured = (image > 0.0) & (image < 1.0)
        steps = np.round(scale / np.where(measured, image, 1.0) / self.level)
        rounded = scale / (np.maximum(steps, 1.0) * self.level)
        return np.where(measured, rounded, image).astype(np.float32)


class Textureless(ImageFault):
    """Patches of smooth surfaces become holes; level is their share of those surfaces.

    There is nothing to match in them; edges keep their depth.
    """

    unit = "share"
    levels = (0.1, 0.25, 0.45, 0.7, 0.9)

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        return smooth_field(rng, (3, 4))

    def spoil(self, image: np.ndarray, robot: int, elapsed: float) -> np.ndarray:
        """The image without patches of its smooth surfaces; their borders flicker."""
        smooth = smooth_surface(image)
        field = self.patterns[robot] + 0.15 * smooth_field(self.rngs[robot], (12, 16))
        if not smooth.any():
            return image
        lost = smooth & (field > np.quantile(field[smooth], 1 - self.level))
        return np.where(lost, np.nan, image)


def smooth_surface(image: np.ndarray) -> np.ndarray:
    """Return a mask of pixels whose disparity is in the plane of its neighbours', [48, 64] bool.

    A plane's disparity is linear in the image's coordinates, whatever its slope is.
    """
    pixels = disparity(image, BASELINE)
    # Compare each pixel with the mean of two neighbours, in its row and in its column.
    distance = 2
    padded = np.pad(pixels, distance, mode="reflect", reflect_type="odd")
    middle = slice(distance, -distance)
    row_mean = (padded[middle, 2 * distance :] + padded[middle, : -2 * distance]) / 2
    column_mean = (padded[2 * distance :, middle] + padded[: -2 * distance, middle]) / 2
    difference = np.maximum(np.abs(row_mean - pixels), np.abs(column_mean - pixels))
    return difference < FLAT_DISPARITY
