"""Heights of a user's own ground, read from a NumPy array or a picture."""

from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from renet.errors import RenetError, install
from renet.files import MEGABYTE, require_regular

ARRAY = ".npy"
"""Suffix of files with a NumPy array of heights."""
PICTURE = ".png"
"""Suffix of files with a picture, brighter where the ground is higher."""
MAX_MAP = 100 * MEGABYTE
"""Largest size of a file, bytes."""
MAX_SAMPLES = 16_000_000
"""Largest number of samples of a map: 4,000 by 4,000."""


def read_heights(file: Path, height: float) -> np.ndarray:
    """Read a height map.

    Args:
        file: Array (.npy) of heights in m, or picture (.png) of the ground from above, with its top
            row at the largest y.
        height: Height of white above black in a picture, m.

    Returns:
        Heights [rows, columns], m. The first row is at the smallest y, the first column at the
        smallest x.

    Raises:
        RenetError: There is no such file, it holds no map of finite heights, or it is too large.
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
    """Read the numbers of a .npy."""
    # Pickled objects, which could run code, are refused; memory is mapped until the size is known.
    try:
        stored = np.load(file, mmap_mode="r", allow_pickle=False)
    except (ValueError, OSError, EOFError, BadZipFile) as error:
        raise RenetError(
            f"the height map {file} is no .npy of numbers: save heights in m with numpy.save"
        ) from error
    if not isinstance(stored, np.ndarray) or stored.dtype.kind not in "iuf":
        raise RenetError(f"the height map {file} must hold numbers: save heights in m as floats")
    _demand_size(file, stored.size)
    return np.asarray(stored, float)


def _picture(file: Path) -> np.ndarray:
    """Read the brightness of a .png, from 0 to 1, with its top row last."""
    try:
        from PIL import Image
    except ModuleNotFoundError as error:
        raise RenetError(f"a height map as .png needs Pillow: {install('sim')}") from error
    try:
        with Image.open(file, formats=("PNG",)) as picture:
            _demand_size(file, picture.width * picture.height)
            # Modes with I have 16 bits of grey, which a conversion would cut to 8.
            has_16_bits = picture.mode.startswith("I")
            grey = np.asarray(picture if has_16_bits else picture.convert("L"), float)
    except (OSError, ValueError, SyntaxError) as error:
        raise RenetError(
            f"the height map {file} is no .png that Pillow reads: save the picture as PNG"
        ) from error
    return grey[::-1] / (65535.0 if has_16_bits else 255.0)


def _demand_size(file: Path, samples: int) -> None:
    """Raise RenetError for a map with too many samples."""
    if samples > MAX_SAMPLES:
        raise RenetError(
            f"the height map {file} has {samples:,} samples; at most {MAX_SAMPLES:,} are read: cut"
            " out a part, or thin it out"
        )


def interpolate(heights: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Interpolate heights between samples, linearly along each axis.

    Args:
        heights: Heights of the samples, [rows, columns] m.
        rows: Positions along the rows, [R], in samples from 0.
        columns: Positions along the columns, [C], in samples from 0.

    Returns:
        Heights, [R, C] m.
    """
    # The sample below each position, and the rest of the way to the next one.
    low_row = np.clip(rows.astype(int), 0, heights.shape[0] - 2)
    low_column = np.clip(columns.astype(int), 0, heights.shape[1] - 2)
    up = (rows - low_row)[:, None]
    along = (columns - low_column)[None]
    near = heights[low_row] * (1.0 - up) + heights[low_row + 1] * up
    return near[:, low_column] * (1.0 - along) + near[:, low_column + 1] * along
