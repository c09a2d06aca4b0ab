"""Addresses in MuJoCo's memory that its Python package does not give.

Functions come from the library that the package has loaded. Fields are found by their values, and
are not found where MuJoCo lays out its structs in another way than `VERSION` does.
"""

import ctypes
from functools import cache
from pathlib import Path

import mujoco
import numpy as np

VERSION = "3.11."
"""Beginning of the versions of MuJoCo that this module is tested with."""
SIZES = 32
"""Numbers at the beginning of mjModel among which nbody and ngeom are."""


@cache
def library() -> ctypes.CDLL:
    """MuJoCo's own library.

    Raises:
        LookupError: MuJoCo's package has none that this system loads by its path.
    """
    folder = Path(mujoco.__file__).parent
    for pattern in ("libmujoco.so*", "libmujoco*.dylib"):
        for path in folder.glob(pattern):
            return ctypes.CDLL(str(path))
    raise LookupError(f"no MuJoCo library in {folder}")


def model_size(model: mujoco.MjModel, name: str) -> ctypes.c_int64:
    """A number at the beginning of mjModel, such as nbody, which can be written.

    Raises:
        LookupError: it is not there.
    """
    sizes = (ctypes.c_int64 * SIZES).from_address(model._address)
    value = getattr(model, name)
    for index in [i for i, size in enumerate(sizes) if size == value]:
        sizes[index] += 1
        found = getattr(model, name) == value + 1
        sizes[index] -= 1
        if found:
            return ctypes.c_int64.from_address(model._address + 8 * index)
    raise LookupError(f"mjModel.{name} is not among its first {SIZES} numbers")


def time(data: mujoco.MjData) -> np.ndarray:
    """A view [1] of `time`, a plain number that lies just before `energy` in mjData.

    Raises:
        LookupError: it does not.
    """
    before = ctypes.cast(data.energy.ctypes.data - 8, ctypes.POINTER(ctypes.c_double))
    view, kept = np.ctypeslib.as_array(before, (1,)), data.time
    data.time = kept + 1.0
    found = view[0] == kept + 1.0
    data.time = kept
    if not found:
        raise LookupError("mjData.time does not lie before mjData.energy")
    return view


@ctypes.CFUNCTYPE(None, ctypes.c_char_p)
def _ignore(message: bytes) -> None:
    pass


def ignore_warnings() -> None:
    """Keep MuJoCo's warnings out of the log file that it would append to in the working folder."""
    handler = ctypes.c_void_p.in_dll(library(), "mju_user_warning")
    handler.value = ctypes.cast(_ignore, ctypes.c_void_p).value
