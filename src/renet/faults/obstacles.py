"""What in a scene can be glass."""

from __future__ import annotations

import mujoco
import numpy as np

from renet.errors import RenetError
from renet.terrain.tiles import TILE


def obstacles(model: mujoco.MjModel, middles: np.ndarray) -> list[int]:
    """Geoms one could walk around or over: boxes that neither span a tile nor carry its start.

    Raises:
        RenetError: there is none.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    found = []
    in_terrain = model.body_rootid[model.geom_bodyid] == model.body("terrain").id
    for geom in np.flatnonzero(in_terrain).tolist():
        half, centre = model.geom_size[geom, :2], data.geom_xpos[geom, :2]
        start = (np.abs(middles - centre) <= half).all(axis=1).any()
        box = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX
        if box and not start and (half < TILE / 2 - 1e-6).all():
            found.append(geom)
    if not found:
        raise RenetError(
            "this terrain has no obstacle that could be glass: choose obstacles, stairs_up or"
            " platform"
        )
    return found


def spread(geoms: list[int], share: float) -> frozenset[int]:
    """A share of the geoms, at least one, spread evenly over their order."""
    counts = np.ceil(np.arange(len(geoms) + 1) * share - 1e-9)
    return frozenset(g for g, more in zip(geoms, np.diff(counts) > 0, strict=True) if more)
