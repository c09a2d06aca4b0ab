"""Pinhole geometry of the depth camera.

Camera frame: x forward, y left, z up. Images have the top row first; rays go through pixel centres.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from renet.interface import DEPTH_SHAPE


@dataclass(frozen=True)
class Intrinsics:
    """Focal lengths and principal point in pixels of the image that is cast.

    Default: an Intel RealSense D435i at 848 x 480 (87 x 58 degrees) loses its noisy edges to a
    central 4:3 crop with square pixels, 66.0 x 52.0 degrees, and is resized to 64 x 48 (RENet,
    Method C: truncate edges, then resize). The rays of that crop are cast directly.
    """

    height: int = DEPTH_SHAPE[0]
    width: int = DEPTH_SHAPE[1]
    fx: float = 32.0 / 0.650
    fy: float = 24.0 / 0.4875
    cx: float = 32.0
    cy: float = 24.0

    def rays(self, device: str | torch.device = "cpu") -> Tensor:
        """Directions with forward component 1, row-major: [height * width, 3]."""
        row = (self.cy - 0.5 - torch.arange(self.height, device=device)) / self.fy
        column = (self.cx - 0.5 - torch.arange(self.width, device=device)) / self.fx
        up, left = torch.meshgrid(row, column, indexing="ij")
        return torch.stack((torch.ones_like(up), left, up), dim=-1).reshape(-1, 3)


def mount_rotation(pitch: Tensor, yaw: Tensor) -> Tensor:
    """Camera axes in the base frame, [N, 3, 3]: yaw about z, then pitch about y (down positive)."""
    cp, sp, cy, sy = pitch.cos(), pitch.sin(), yaw.cos(), yaw.sin()
    entries = (cy * cp, -sy, cy * sp, sy * cp, cy, sy * sp, -sp)
    return torch.stack((*entries, torch.zeros_like(pitch), cp), dim=-1).unflatten(-1, (3, 3))
