"""From what a physical fault says of a view to the rays of the simulated cameras."""

from __future__ import annotations

import mujoco
import numpy as np
import torch

from renet.errors import RenetError
from renet.evaluation.faults import View
from renet.sim.depth_camera import Disturbance
from renet.tiles import TILE


def disturbance(view: View, model: mujoco.MjModel, middles: np.ndarray) -> Disturbance | None:
    """What the cameras of `view` do with their rays; None where all see what is there.

    Args:
        view: of N cameras. model: the scene. middles: [M, 2] horizontal middles of its tiles.

    Raises:
        RenetError: obstacles are to be glass where there are none.
    """
    if view == View.true(len(view.lift)):
        return None
    shares = [float(share) for share in np.unique(view.glass) if share > 0]
    unseen = []
    if shares:
        found = obstacles(model, middles)
        unseen = [
            (spread(found, share), torch.from_numpy(np.flatnonzero(view.glass == share)))
            for share in shares
        ]
    lift = torch.as_tensor(view.lift, dtype=torch.float32)
    return Disturbance(lift, rotation(view.turn), unseen)


def rotation(turn: np.ndarray) -> torch.Tensor:
    """Matrices [N, 3, 3] of rotation vectors [N, 3] in rad."""
    x, y, z = torch.as_tensor(turn, dtype=torch.float32).unbind(-1)
    zero = torch.zeros_like(x)
    cross = torch.stack((zero, -z, y, z, zero, -x, -y, x, zero), -1).unflatten(-1, (3, 3))
    return torch.linalg.matrix_exp(cross)


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
