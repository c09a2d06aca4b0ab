"""Image of the true height map, which the Oracle of the paper's Table I sees."""

from torch import Tensor
from torch.nn.functional import interpolate

from renet.interface import DEPTH_SHAPE, HEIGHT_MAP_X


def true_image(height_map: Tensor) -> Tensor:
    """Draw height maps m_t [N, 132] as images [N, 48, 64] in [0, 1].

    Rows are x, with the farthest at the top, and columns are y, with the leftmost at the left.
    Level ground is 0.5; 0 and 1 are half a metre above and below it.
    """
    grid = height_map.float().unflatten(-1, (len(HEIGHT_MAP_X), -1))
    # x and y of the map grow forwards and to the left, rows and columns down and to the right.
    grid = grid.flip(1, 2)
    image = 0.5 + interpolate(grid.unsqueeze(1), DEPTH_SHAPE)
    return image.clamp(0.0, 1.0).squeeze(1)
