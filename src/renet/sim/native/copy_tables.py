"""Fields that the native engine copies between Warp and MuJoCo before and after its steps.

A field has the same name on both sides, because mujoco_warp mirrors mjData and mjModel. The tables
are lists of names; sizes and types are derived and checked.
"""

from typing import Any, NamedTuple

import mujoco
import numpy as np

from renet.errors import RenetError
from renet.sim.native.stages import moving_bodies

POSE = ("qpos", "qvel", "mocap_pos", "mocap_quat")
"""Fields that determine poses and velocities."""
STATE = (*POSE, "act", "qacc_warmstart", "ctrl", "qfrc_applied", "xfrc_applied")
"""Inputs of a step beside the time. An environment is stepped only if all are finite."""

INTEGRATED = ("qpos", "qvel", "act", "qacc_warmstart", "qacc", "act_dot")
SENSOR_FIELDS = (
    "sensordata",
    "actuator_length",
    "actuator_velocity",
    "actuator_force",
    "ten_length",
)
FORCES = ("qfrc_actuator", "qfrc_bias", "qfrc_passive", "qfrc_constraint", "qfrc_smooth", "energy")
PER_BODY = ("xpos", "xquat", "xmat", "xipos", "ximat", "subtree_com", "cvel", "subtree_linvel")
PER_BODY += ("subtree_angmom", "cacc", "cfrc_int", "cfrc_ext")
ON_BODIES = {kind: (f"{kind}_xpos", f"{kind}_xmat") for kind in ("geom", "site", "cam")}
ON_BODIES["jnt"] = ("xanchor", "xaxis")
"""Fields with a row for each geom, site, camera or joint."""

VIEWER_FIELDS = ("geom_rgba", "light_", "mat_")
"""Prefixes of model fields that only viewers read, in Warp's memory."""


class FieldCopy(NamedTuple):
    """Field, or a part of one, of all environments in Warp and of one mjModel or mjData."""

    warp: np.ndarray
    """View of Warp's memory, [N, ...]."""
    mujoco: np.ndarray
    """View of MuJoCo's memory, with the number of elements of one environment."""

    @property
    def is_float(self) -> bool:
        """True for single precision in Warp and double in MuJoCo; False for equal bytes."""
        return self.mujoco.dtype == np.float64


def whole_data(
    wp_data: Any, mj_data: mujoco.MjData, num_envs: int, names: tuple[str, ...]
) -> list[FieldCopy]:
    """List copies of whole fields of mjData, without empty ones.

    Raises:
        RenetError: A field's sizes differ between Warp and MuJoCo.
    """
    copies = []
    for name in names:
        source = getattr(wp_data, name)
        target = getattr(mj_data, name)
        if target.size == 0 or source.size == 0:
            continue
        rows = source.numpy().reshape(source.shape[0], -1)
        if len(rows) != num_envs or rows.shape[1] < target.size:
            raise RenetError(f"data field {name} does not match between Warp and MuJoCo")
        copies.append(FieldCopy(rows[:, : target.size], target))
    return copies


def model_copies(wp_model: Any, mj_model: mujoco.MjModel, names: list[str]) -> list[FieldCopy]:
    """List copies of randomised fields into an MjModel.

    Raises:
        RenetError: A field's sizes or types differ between Warp and MuJoCo.
    """
    copies = []
    for name in names:
        source = getattr(wp_model, name)
        target = getattr(mj_model, name)
        if not hasattr(source, "ptr") or target.size == 0 or name.startswith(VIEWER_FIELDS):
            continue
        copy = FieldCopy(source.numpy(), target)
        if copy.warp[0].size != target.size:
            raise RenetError(
                f"model field {name} has {copy.warp[0].size} numbers per environment in Warp and "
                f"{target.size} in MuJoCo: the native engine cannot randomise it"
            )
        if not copy.is_float and target.itemsize != copy.warp.itemsize:
            raise RenetError(f"model field {name} has type {target.dtype}: it cannot be randomised")
        copies.append(copy)
    return copies


def store_data(
    wp_data: Any, mj_data: mujoco.MjData, mj_model: mujoco.MjModel, num_envs: int
) -> list[FieldCopy]:
    """List copies of results out of an MjData, without the rows of static bodies."""
    moving = moving_bodies(mj_model)
    copies = whole_data(wp_data, mj_data, num_envs, (*INTEGRATED, *SENSOR_FIELDS, *FORCES))
    # The body of each row, by the fields that have such rows.
    bodies_of_rows: dict[tuple[str, ...], np.ndarray] = {PER_BODY: np.arange(mj_model.nbody)}
    for kind, names in ON_BODIES.items():
        bodies_of_rows[names] = getattr(mj_model, f"{kind}_bodyid")
    for names, bodies in bodies_of_rows.items():
        for rows in _runs(moving[bodies]):
            for name in names:
                source = getattr(wp_data, name).numpy()[:, rows]
                target = getattr(mj_data, name)[rows]
                copies.append(FieldCopy(source, target))
    return copies


def _runs(mask: np.ndarray) -> list[slice]:
    """List slices of consecutive True entries of a mask."""
    edges = np.flatnonzero(np.diff(mask, prepend=False, append=False))
    return [slice(*edge) for edge in edges.reshape(-1, 2).tolist()]
