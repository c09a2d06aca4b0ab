"""Grass before some of the images of training, so that sparse grass is nothing unusual later."""

import numpy as np
import torch
from torch import Tensor

from renet.faults import Frames
from renet.faults.vegetation import TallGrass
from renet.interface import DEPTH_SHAPE, FRAMES

PAIR_SHARE = 0.15
"""Share of the detector's image pairs with grass. With twice as many it misses other faults."""
ROBOTS_APART = 7
"""Robots from one that learns to expect images with grass to the next: a share of 0.14."""
BLADES = 20
"""Largest number of blades in view: the fault `tall_grass` at severity 2 of 5."""
VIEWS = 512
"""Number of different views of blades."""


class Grass:
    """Random views of blades, each the same in all trainings."""

    def __init__(self, device: torch.device) -> None:
        self._views = draw_views().to(device)

    def before_pairs(self, pairs: Tensor) -> Tensor:
        """Put grass before the first 15 % of image pairs, [B, 2, 48, 64], new in each image."""
        count = round(PAIR_SHARE * len(pairs))
        choice = torch.randint(len(self._views), (count, FRAMES), device=pairs.device)
        # The nearer surface hides the other one.
        overgrown = torch.minimum(pairs[:count], self._views[choice])
        return torch.cat([overgrown, pairs[count:]])

    def before_robots(self, images: Tensor) -> Tensor:
        """Put grass before every seventh of all robots' images, [N, 48, 64]."""
        overgrown = images.clone()
        some = overgrown[::ROBOTS_APART]
        choice = torch.randint(len(self._views), (len(some),), device=images.device)
        overgrown[::ROBOTS_APART] = torch.minimum(some, self._views[choice])
        return overgrown


def draw_views(seed: int = 0) -> Tensor:
    """Draw random views of blades of grass alone, [512, 48, 64].

    Pixels are depths in [0, 1]: 1 where there is no blade, 0 where one is not measured.
    """
    rng = np.random.default_rng(seed)
    background = Frames.healthy(np.ones((1, *DEPTH_SHAPE), np.float32))
    counts = rng.integers(1, BLADES + 1, VIEWS)
    views = []
    for count in counts:
        grass = TallGrass(count, [rng])
        views.append(grass.corrupt(background, np.zeros(1)).image[0])
    return torch.from_numpy(np.stack(views))
