"""Height maps as colours."""

import numpy as np
from matplotlib import colormaps

from renet.interface import HEIGHT_MAP_X, HEIGHT_MAP_Y

RELIEF = 0.5
"""Metres of ground above or below the robot's own that end a height map's colours."""


def map_picture(height_map: np.ndarray, scale: int = 16) -> np.ndarray:
    """Colours [12 scale, 11 scale, 3] uint8 of a height map [132] m; high ground is bright."""
    shares = 0.5 + as_seen(height_map) / (2 * RELIEF)
    return colormaps["viridis"](shares, bytes=True)[..., :3].repeat(scale, 0).repeat(scale, 1)


def as_seen(height_map: np.ndarray) -> np.ndarray:
    """Heights of the ground [12, 11] m of a height map [132], from above: ahead is up.

    A height map is the robot's height over the ground: its negative is the ground's.
    """
    return -height_map.reshape(len(HEIGHT_MAP_X), len(HEIGHT_MAP_Y))[::-1, ::-1]


def beside(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Two pictures of one height side by side, with a white line between."""
    return np.concatenate((left, np.full((len(left), 4, 3), 255, np.uint8), right), axis=1)
