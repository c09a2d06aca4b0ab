"""Pinhole geometry and mount of the simulated and the real depth camera.

Camera frame: x forward, y left, z up. Images have the top row first; rays go through pixel centres.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from renet.interface import DEPTH_SHAPE


@dataclass(frozen=True)
class Intrinsics:
    """Focal lengths and principal point, in pixels, of an image with straight rows and columns.

    Default: the image of an Intel RealSense D435i at 848 x 480 (87 x 58 degrees), cropped to its
    centre of 66.0 x 52.0 degrees with square pixels and resized to 64 x 48 (RENet, Method C:
    truncate edges, then resize). In simulation the rays of that crop are cast directly.
    """

    height: int = DEPTH_SHAPE[0]
    width: int = DEPTH_SHAPE[1]
    fx: float = 32.0 / 0.650
    fy: float = 24.0 / 0.4875
    cx: float = 32.0
    cy: float = 24.0

    def axes(self, dtype: Any = np.float64) -> tuple[np.ndarray, np.ndarray]:
        """Left [width] and up [height] components of rays whose forward component is 1."""

        def axis(centre: float, size: int, focal: float) -> np.ndarray:
            return (dtype(centre - 0.5) - np.arange(size, dtype=dtype)) / dtype(focal)

        return axis(self.cx, self.width, self.fx), axis(self.cy, self.height, self.fy)

    def rays(self, dtype: Any = np.float64) -> np.ndarray:
        """Directions (forward, left, up) with forward component 1, row-major: [H * W, 3]."""
        left, up = self.axes(dtype)
        ups, lefts = np.meshgrid(up, left, indexing="ij")
        return np.stack((np.ones_like(ups), lefts, ups), axis=-1).reshape(-1, 3)


@dataclass(frozen=True)
class MountCfg:
    """Pose of the camera on its body, and the errors that each episode draws.

    It is frozen because all tasks of a robot share it.
    """

    position: tuple[float, float, float] = (0.27, 0.0, 0.03)
    """Position in the body frame, m (on the head, as in published Go1 parkour policies)."""
    pitch: float = math.radians(30.0)
    """Downward tilt, rad."""
    position_error: float = 0.01
    """Largest position error, uniform, m (paper)."""
    angle_error: float = math.radians(5.0)
    """Largest pitch and yaw error, uniform, rad (paper)."""
