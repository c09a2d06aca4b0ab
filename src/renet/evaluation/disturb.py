"""From what a physical fault says of a view to the rays of the simulated cameras."""

from __future__ import annotations

import mujoco
import numpy as np
import torch

from renet.faults import View
from renet.faults.obstacles import obstacles, spread
from renet.sim.depth.camera import CameraPerturbation


def disturbance(
    view: View, model: mujoco.MjModel, middles: np.ndarray
) -> CameraPerturbation | None:
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
    return CameraPerturbation(lift, rotation(view.turn), unseen)


def rotation(turn: np.ndarray) -> torch.Tensor:
    """Matrices [N, 3, 3] of rotation vectors [N, 3] in rad."""
    x, y, z = torch.as_tensor(turn, dtype=torch.float32).unbind(-1)
    zero = torch.zeros_like(x)
    cross = torch.stack((zero, -z, y, z, zero, -x, -y, x, zero), -1).unflatten(-1, (3, 3))
    return torch.linalg.matrix_exp(cross)
