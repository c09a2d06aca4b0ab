"""Functions and fields of MuJoCo that its Python package does not expose.

Functions are those of the library that the package has loaded. Fields are found by their values,
which fails for versions of MuJoCo with another layout than that of `VERSION`.
"""

import ctypes
from functools import cache
from pathlib import Path

import mujoco
import numpy as np

VERSION = "3.11."
"""Prefix of the versions of MuJoCo that this module is tested with."""
NUM_SIZES = 32
"""Number of integers at the beginning of mjModel, among which are nbody and ngeom."""


@cache
def mujoco_library() -> ctypes.CDLL:
    """Load MuJoCo's C library; raises LookupError if the package has none for Linux or macOS."""
    folder = Path(mujoco.__file__).parent
    for pattern in ("libmujoco.so*", "libmujoco*.dylib"):
        for path in folder.glob(pattern):
            return ctypes.CDLL(str(path))
    raise LookupError(f"no MuJoCo library in {folder}")


def model_size(model: mujoco.MjModel, name: str) -> ctypes.c_int64:
    """Find a number at the beginning of mjModel, such as nbody, so that it can be changed.

    Raises:
        LookupError: The number is not there.
    """
    sizes = (ctypes.c_int64 * NUM_SIZES).from_address(model._address)
    value = getattr(model, name)
    candidates = [index for index, size in enumerate(sizes) if size == value]
    for index in candidates:
        # The right number is the one whose change the package sees.
        sizes[index] += 1
        is_field = getattr(model, name) == value + 1
        sizes[index] -= 1
        if is_field:
            return ctypes.c_int64.from_address(model._address + 8 * index)
    raise LookupError(f"mjModel.{name} is not among its first {NUM_SIZES} numbers")


def time(data: mujoco.MjData) -> np.ndarray:
    """Return a view [1] of mjData's `time`, which lies before its `energy`.

    Raises:
        LookupError: It lies elsewhere.
    """
    address = data.energy.ctypes.data - 8
    view = np.ctypeslib.as_array(ctypes.cast(address, ctypes.POINTER(ctypes.c_double)), (1,))
    # A change of the time must show in the view.
    value = data.time
    data.time = value + 1.0
    is_field = view[0] == value + 1.0
    data.time = value
    if not is_field:
        raise LookupError("mjData.time does not lie before mjData.energy")
    return view
