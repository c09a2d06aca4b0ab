"""From a real depth image to the one a policy was trained on: crop, resize, clip, normalise.

Training casts one ray through the centre of each pixel of a cropped, resized image. A real image is
therefore sampled where those rays meet it, whatever its own size and lens.
"""

import numpy as np

from renet.bundle.manifest import CameraSpec
from renet.camera import Intrinsics
from renet.errors import RenetError


class DepthPreprocessor:
    """Picks a policy's pixels from one camera's images."""

    def __init__(self, lens: Intrinsics, spec: CameraSpec) -> None:
        """Find the pixels in images without distortion; raises RenetError for too narrow a view.

        Both focal lengths of the lens are negative where the camera is mounted upside down.
        """
        left, up = spec.intrinsics.axes()
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
        """Rows, columns of the images it takes."""
        self._range = spec.range

    def invalid(self, image: np.ndarray) -> float:
        """Share of pixels of the policy's view, full resolution, that the camera gives as 0.

        Those it could not measure. Raises RenetError for an image of another size.
        """
        self._check(image)
        rows = slice(self._rows.min(), self._rows.max() + 1)
        columns = slice(self._columns.min(), self._columns.max() + 1)
        return float((image[rows, columns] == 0).mean())

    def image(self, depth: np.ndarray) -> np.ndarray:
        """Metres [rows, columns], 0 where nothing was measured, to [48, 64] in [0, 1].

        Holes are filled; an image without any measurement becomes 1, as rays that hit nothing do
        before noise. Raises RenetError for an image of another size.
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
    """An image [rows, columns] in which pixels of 0, holes, have the value of the nearest around.

    Holes are filled from their rims inwards, with the smallest depth of the eight pixels around, so
    that an obstacle too close to be measured stays close (librealsense's mode 2, which published
    Go1 parkour policies use). Nothing changes in an image without any measurement.
    """
    filled = np.where(depth > 0.0, depth, np.inf)
    rows, columns = filled.shape
    while np.isinf(filled).any() and np.isfinite(filled).any():
        framed = np.pad(filled, 1, constant_values=np.inf)
        around = [framed[r : r + rows, c : c + columns] for r in range(3) for c in range(3)]
        filled = np.where(np.isinf(filled), np.minimum.reduce(around), filled)
    return np.where(np.isinf(filled), 0.0, filled)
