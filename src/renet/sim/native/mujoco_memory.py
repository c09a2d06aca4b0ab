"""Functions and fields of MuJoCo that its Python package does not expose.

Functions are those of the library that the package has loaded. Fields are located by their values,
which fails for versions of MuJoCo with another layout than `VERSION`.
"""

import ctypes
from functools import cache
from pathlib import Path

import mujoco
import numpy as np

VERSION = "3.11."
"""Prefix of the versions of MuJoCo that this module is tested with."""
SIZES = 32
"""Count of the numbers at the beginning of mjModel, among which are nbody and ngeom."""


@cache
def library() -> ctypes.CDLL:
    """MuJoCo's C library; raises LookupError if its package has none for Linux or macOS."""
    folder = Path(mujoco.__file__).parent
    for pattern in ("libmujoco.so*", "libmujoco*.dylib"):
        for path in folder.glob(pattern):
            return ctypes.CDLL(str(path))
    raise LookupError(f"no MuJoCo library in {folder}")


def model_size(model: mujoco.MjModel, name: str) -> ctypes.c_int64:
    """A writable number at mjModel's beginning, such as nbody; raises LookupError if not there."""
    sizes = (ctypes.c_int64 * SIZES).from_address(model._address)
    value = getattr(model, name)
    for index in [i for i, size in enumerate(sizes) if size == value]:
        sizes[index] += 1
        follows = getattr(model, name) == value + 1
        sizes[index] -= 1
        if follows:
            return ctypes.c_int64.from_address(model._address + 8 * index)
    raise LookupError(f"mjModel.{name} is not among its first {SIZES} numbers")


def time(data: mujoco.MjData) -> np.ndarray:
    """A view [1] of mjData's `time`, before its `energy`; raises LookupError if not there."""
    before = ctypes.cast(data.energy.ctypes.data - 8, ctypes.POINTER(ctypes.c_double))
    view, kept = np.ctypeslib.as_array(before, (1,)), data.time
    data.time = kept + 1.0
    same = view[0] == kept + 1.0
    data.time = kept
    if not same:
        raise LookupError("mjData.time does not lie before mjData.energy")
    return view
