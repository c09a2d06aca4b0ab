"""What the Oracle of the paper's Table I sees: the true height map in place of a camera's image."""

from torch import Tensor
from torch.nn.functional import interpolate

from renet.interface import DEPTH_SHAPE, HEIGHT_MAP_X


def true_image(height_map: Tensor) -> Tensor:
    """The height map m_t [N, 132] as an image [N, 48, 64] in [0, 1].

    Rows are x, the farthest at the top, and columns y, the leftmost at the left. Level ground is
    grey, 0.5; black and white are half a metre above and below it.
    """
    grid = height_map.float().unflatten(-1, (len(HEIGHT_MAP_X), -1)).flip(1, 2)
    return (0.5 + interpolate(grid.unsqueeze(1), DEPTH_SHAPE)).clamp(0.0, 1.0).squeeze(1)
