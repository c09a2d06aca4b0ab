"""Sparse grass before the training camera, which the variance detector is to know.

The paper's robot keeps to vision in sparse grass and leaves it in dense grass (RENet, field tests).
A detector that never saw a blade objects to the first one.
"""

import numpy as np
import torch
from torch import Tensor

from renet.faults import Frames
from renet.faults.vegetation import TallGrass
from renet.interface import DEPTH_SHAPE, FRAMES

SHARE = 0.15
"""Of the image pairs that the detector learns from; with twice as many it notices less else."""
BLADES = 20
"""Most blades in view: `tall_grass` at severity 2 of 5."""
VIEWS = 512
"""Different views of blades."""


def draw_views(seed: int = 0) -> Tensor:
    """Depth of blades alone, [512, 48, 64]: 1 where there are none, 0 where one is not measured."""
    rng = np.random.default_rng(seed)
    nothing = Frames.healthy(np.ones((1, *DEPTH_SHAPE), np.float32))
    views = [
        TallGrass(count, [rng]).corrupt(nothing, np.zeros(1)).image[0]
        for count in rng.integers(1, BLADES + 1, VIEWS)
    ]
    return torch.from_numpy(np.stack(views))


def grow(pairs: Tensor, views: Tensor) -> Tensor:
    """Put blades before the first 15 % of image pairs [B, 2, 48, 64], other ones in each image."""
    count = round(SHARE * len(pairs))
    drawn = torch.randint(len(views), (count, FRAMES), device=pairs.device)
    return torch.cat([torch.minimum(pairs[:count], views[drawn]), pairs[count:]])
