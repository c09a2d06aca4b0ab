"""Heights of somebody's own ground, from an array of NumPy's or a picture."""

from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from renet.errors import RenetError, install, reason
from renet.files import MEGABYTE, require_regular

ARRAY, PICTURE = ".npy", ".png"
"""Endings of the files that are read."""
MAX_MAP = 100 * MEGABYTE
"""Bytes of a file."""
MAX_SAMPLES = 16_000_000
"""Samples of a map: 4,000 by 4,000."""


def read_heights(file: Path, height: float) -> np.ndarray:
    """Heights [rows, columns] m: the first row is at the smallest y, the first column at x.

    Args:
        file: a .npy of heights in m whose rows and columns are so, or a .png as seen from above,
            whose top row is at the largest y.
        height: m, of white above black in a picture.

    Raises:
        RenetError: there is no such file, it holds no map of finite heights, or it is too large.
    """
    require_regular(file, MAX_MAP, "height map")
    heights = _picture(file) * height if file.suffix.lower() == PICTURE else _array(file)
    if heights.ndim != 2 or min(heights.shape) < 2:
        raise RenetError(
            f"the height map {file} has the shape {heights.shape}: give rows and columns, 2 or more"
            " of each"
        )
    if not np.isfinite(heights).all():
        raise RenetError(
            f"the height map {file} holds values that are not finite: fill its holes, for example"
            " with numpy.nan_to_num"
        )
    return heights


def _array(file: Path) -> np.ndarray:
    """Numbers of a .npy; nothing in it is ever executed."""
    try:
        stored = np.load(file, mmap_mode="r", allow_pickle=False)
    except (ValueError, OSError, EOFError, BadZipFile) as error:
        raise RenetError(f"the height map {file} is no .npy of numbers: {reason(error)}") from error
    if not isinstance(stored, np.ndarray) or stored.dtype.kind not in "iuf":
        raise RenetError(f"the height map {file} must hold numbers: save heights in m as floats")
    _demand_size(file, stored.size)
    return np.asarray(stored, float)


def _picture(file: Path) -> np.ndarray:
    """Brightness of a .png, 0 to 1, its top row last."""
    try:
        from PIL import Image
    except ModuleNotFoundError as error:
        raise RenetError(f"a height map as .png needs Pillow: {install('sim')}") from error
    try:
        with Image.open(file, formats=("PNG",)) as picture:
            _demand_size(file, picture.width * picture.height)
            # Sixteen bits stay as they are; colours become grey.
            deep = picture.mode.startswith("I")
            grey = np.asarray(picture if deep else picture.convert("L"), float)
    except (OSError, ValueError, SyntaxError) as error:
        raise RenetError(
            f"the height map {file} is no .png that Pillow reads: {reason(error)}"
        ) from error
    return grey[::-1] / (65535.0 if deep else 255.0)


def _demand_size(file: Path, samples: int) -> None:
    if samples > MAX_SAMPLES:
        raise RenetError(
            f"the height map {file} has {samples:,} samples; at most {MAX_SAMPLES:,} are read: cut"
            " out a part, or thin it out"
        )


def interpolate(heights: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Heights [R, C] between samples, linear along each axis.

    Args:
        heights: [rows, columns] m. rows, columns: places [R] and [C] among the samples, from 0.
    """
    low_row = np.clip(rows.astype(int), 0, heights.shape[0] - 2)
    low_column = np.clip(columns.astype(int), 0, heights.shape[1] - 2)
    up = (rows - low_row)[:, None]
    along = (columns - low_column)[None]
    near = heights[low_row] * (1.0 - up) + heights[low_row + 1] * up
    return near[:, low_column] * (1.0 - along) + near[:, low_column + 1] * along
