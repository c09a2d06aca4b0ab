"""What the native engine copies, and where: rows that pair Warp memory with MuJoCo's.

Names are the same on both sides (mujoco_warp mirrors mjData and mjModel), so the tables are lists
of names; addresses, sizes and types are derived and checked.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from renet.errors import RenetError
from renet.sim.native_kernel import BYTE, FLOAT, INT
from renet.sim.pipeline import moving_bodies

DOUBLE_POINTER = ctypes.POINTER(ctypes.c_double)

POSE = ("qpos", "qvel", "mocap_pos", "mocap_quat")
"""What poses and velocities follow from."""
STATE = (*POSE, "act", "qacc_warmstart", "ctrl", "qfrc_applied", "xfrc_applied", "time")
"""Inputs of a step. All must be finite for an environment to be stepped."""

INTEGRATED = ("qpos", "qvel", "act", "time", "qacc_warmstart", "qacc", "act_dot")
SENSED = ("sensordata", "actuator_length", "actuator_velocity", "actuator_force", "ten_length")
FORCES = ("qfrc_actuator", "qfrc_bias", "qfrc_passive", "qfrc_constraint", "qfrc_smooth", "energy")
PER_BODY = ("xpos", "xquat", "xmat", "xipos", "ximat", "subtree_com", "cvel", "subtree_linvel")
PER_BODY += ("subtree_angmom", "cacc", "cfrc_int", "cfrc_ext")
PER_GEOM = ("geom_xpos", "geom_xmat")
PER_SITE = ("site_xpos", "site_xmat")
PER_JOINT = ("xanchor", "xaxis")
PER_CAMERA = ("cam_xpos", "cam_xmat")

LOOKS = ("geom_rgba", "light_", "mat_")
"""Beginnings of model fields that only viewers read, and from Warp."""


@dataclass(frozen=True)
class Transfer:
    """`count` elements of one environment between a Warp and a MuJoCo address."""

    warp: int
    stride: int
    """Bytes between environments in the Warp array."""
    mujoco: int
    count: int
    kind: int = FLOAT

    def numbers(self) -> tuple[int, int, int, int, int]:
        """The row as native_kernel.advance reads it."""
        return (self.warp, self.stride, self.mujoco, self.count, self.kind)


def load_rows(
    wp_data: Any, mj_data: mujoco.MjData, num_envs: int, names: tuple[str, ...] = STATE
) -> list[Transfer]:
    """State and inputs into an MjData."""
    return [row for name in names for row in _whole(wp_data, mj_data, name, num_envs)]


def model_rows(wp_model: Any, mj_model: mujoco.MjModel, names: list[str]) -> list[Transfer]:
    """Per-environment model fields into an MjModel."""
    rows = []
    for name in names:
        source: Any = getattr(wp_model, name)
        target = getattr(mj_model, name)
        if not hasattr(source, "ptr") or target.size == 0 or name.startswith(LOOKS):
            continue
        per_env = source.numpy()[0].size
        if per_env != target.size:
            raise RenetError(
                f"model field {name} has {per_env} numbers per environment in Warp and "
                f"{target.size} in MuJoCo: the native engine cannot randomise it"
            )
        rows.append(
            Transfer(
                source.ptr, source.strides[0], target.ctypes.data, per_env, _kind(name, target)
            )
        )
    return rows


def store_rows(
    wp_data: Any, mj_data: mujoco.MjData, mj_model: mujoco.MjModel, num_envs: int
) -> list[Transfer]:
    """Results out of an MjData; rows of static bodies are left out."""
    moving = moving_bodies(mj_model)
    rows = [
        row
        for name in (*INTEGRATED, *SENSED, *FORCES)
        for row in _whole(wp_data, mj_data, name, num_envs)
    ]
    for names, owner in (
        (PER_BODY, np.arange(mj_model.nbody)),
        (PER_GEOM, mj_model.geom_bodyid),
        (PER_SITE, mj_model.site_bodyid),
        (PER_JOINT, mj_model.jnt_bodyid),
        (PER_CAMERA, mj_model.cam_bodyid),
    ):
        for start, stop in _runs(moving[owner]):
            rows += [_slice(wp_data, mj_data, name, start, stop) for name in names]
    return rows


def _whole(wp_data: Any, mj_data: mujoco.MjData, name: str, num_envs: int) -> list[Transfer]:
    """All of one field, or nothing where the model has none of it."""
    source = getattr(wp_data, name)
    target = _time(mj_data) if name == "time" else getattr(mj_data, name)
    if target.size == 0 or source.size == 0:
        return []
    per_env = source.strides[0] // 4
    if source.shape[0] != num_envs or per_env < target.size:
        raise RenetError(f"data field {name} does not match between Warp and MuJoCo")
    return [Transfer(source.ptr, source.strides[0], target.ctypes.data, target.size)]


def _time(mj_data: mujoco.MjData) -> np.ndarray:
    """A view of `time`, a plain number that lies just before `energy` in mjData."""
    view = np.ctypeslib.as_array(ctypes.cast(mj_data.energy.ctypes.data - 8, DOUBLE_POINTER), (1,))
    mj_data.time = 1.0
    if view[0] != 1.0:
        raise RenetError(f"the native engine does not know mjData of MuJoCo {mujoco.__version__}")
    mj_data.time = 0.0
    return view


def _slice(wp_data: Any, mj_data: mujoco.MjData, name: str, start: int, stop: int) -> Transfer:
    """Rows [start, stop) of a per-object field."""
    source, target = getattr(wp_data, name), getattr(mj_data, name)
    width = target[0].size
    return Transfer(
        source.ptr + 4 * width * start,
        source.strides[0],
        target.ctypes.data + 8 * width * start,
        width * (stop - start),
    )


def _runs(mask: np.ndarray) -> list[tuple[int, int]]:
    """Half-open ranges of consecutive true entries."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], mask.astype(int), [0]))))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _kind(name: str, target: np.ndarray) -> int:
    kinds = {np.dtype(np.float64): FLOAT, np.dtype(np.int32): INT}
    kinds |= {np.dtype(np.uint8): BYTE, np.dtype(bool): BYTE}
    if target.dtype not in kinds:
        raise RenetError(f"model field {name} has type {target.dtype}: it cannot be randomised")
    return kinds[target.dtype]
