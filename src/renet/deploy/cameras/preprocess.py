"""Preparation of real depth images as in training: crop, resize, clip, normalise.

Training casts one ray through the centre of each pixel of a cropped, resized image. A real image is
therefore sampled at the pixels that these rays meet, whatever its own size and lens.
"""

import numpy as np

from renet.bundle.manifest import CameraSpec
from renet.camera import Intrinsics
from renet.errors import RenetError


class DepthPreprocessor:
    """Samples a policy's pixels from the images of one camera."""

    def __init__(self, lens: Intrinsics, spec: CameraSpec, upside_down: bool = False) -> None:
        """Find the pixels to sample.

        Args:
            lens: Lens of the camera, without distortion.
            spec: Format of the policy's images.
            upside_down: True if the camera is turned by 180 degrees in its mount.

        Raises:
            RenetError: The camera's view is too narrow for the policy.
        """
        # Directions of the policy's rays, then the pixels in which they meet the camera's image.
        left, up = spec.intrinsics.axes()
        if upside_down:
            left = -left
            up = -up
        self._columns = np.rint(lens.cx - 0.5 - lens.fx * left).astype(int)
        self._rows = np.rint(lens.cy - 0.5 - lens.fy * up).astype(int)
        for name, index, size in (
            ("wide", self._columns, lens.width),
            ("high", self._rows, lens.height),
        ):
            if index.min() < 0 or index.max() >= size:
                raise RenetError(
                    f"the camera's image is not {name} enough for the policy: it needs pixels "
                    f"{index.min()} to {index.max()} of {size}; choose another resolution"
                )
        self.size = (lens.height, lens.width)
        """Rows and columns of the camera's images."""
        self._range = spec.range

    def invalid(self, image: np.ndarray) -> float:
        """Return the share of pixels in the policy's view that have no measurement, 0 to 1.

        Pixels are counted at the camera's resolution; 0 stands for no measurement.

        Raises:
            RenetError: The image is of another size than the lens's.
        """
        self._check(image)
        rows = slice(self._rows.min(), self._rows.max() + 1)
        columns = slice(self._columns.min(), self._columns.max() + 1)
        return float((image[rows, columns] == 0).mean())

    def image(self, depth: np.ndarray) -> np.ndarray:
        """Return the policy's image, [48, 64] of 0 to 1, of a depth image [rows, columns], m.

        Pixels of 0 are holes, and are filled. An image of holes alone becomes 1 everywhere, like an
        image of training in which no ray hits anything, before noise.

        Raises:
            RenetError: The image is of another size than the lens's.
        """
        self._check(depth)
        picked = fill_holes(depth[np.ix_(self._rows, self._columns)])
        metres = np.where(picked > 0.0, picked, self._range)
        return (np.minimum(metres, self._range) / self._range).astype(np.float32)

    def _check(self, image: np.ndarray) -> None:
        if image.shape != self.size:
            raise RenetError(
                f"the depth image has {image.shape} rows and columns, its lens says {self.size}"
            )


def fill_holes(depth: np.ndarray) -> np.ndarray:
    """Return a copy of a depth image [rows, columns] with its holes, pixels of 0, filled.

    Holes are filled from their rims inwards with the smallest depth of the eight pixels around, so
    that an obstacle too close to be measured stays close (mode 2 of librealsense, which published
    Go1 parkour policies use). An image without any measurement stays as it is.
    """
    filled = np.where(depth > 0.0, depth, np.inf)
    rows, columns = filled.shape
    while np.isinf(filled).any() and np.isfinite(filled).any():
        framed = np.pad(filled, 1, constant_values=np.inf)
        # The image shifted by one pixel into each direction.
        around = []
        for down in range(3):
            for right in range(3):
                around.append(framed[down : down + rows, right : right + columns])
        filled = np.where(np.isinf(filled), np.minimum.reduce(around), filled)
    return np.where(np.isinf(filled), 0.0, filled)
