"""Depth images and heights of terrain on the CPU, from boxes and triangles in square bins."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import mujoco
import numpy as np
import torch
import warp as wp
from torch import Tensor

from renet.camera import Intrinsics
from renet.sim.depth.raycast import TerrainScanner
from renet.sim.native.compiler import Source

SOURCE = Source(Path(__file__).with_name("rasterizer.cpp"))
BIN = 0.25
"""Side of a bin, m: about a step of stairs."""
WIDE = 20.0
"""Width above which shapes (planes, the border) are in no bin and always drawn, m."""
MAX_BINS = 1 << 20
"""Approximate largest number of bins; larger terrains get larger bins."""
FEW = 4096
"""Number of points below which a second thread is of no help."""


class Rasterizer(TerrainScanner):
    """Draws depth images and finds heights shape by shape, on the CPU.

    Each shape near the camera fills the pixels it covers, while a ray caster searches a tree for
    every pixel.
    """

    def __init__(self, model: mujoco.MjModel, without: frozenset[int] = frozenset()) -> None:
        """Sort the shapes of a model's terrain into bins; `without` as in `terrain_shapes`."""
        super().__init__(model, "cpu", without)
        boxes, triangles = self._shapes
        reach = np.abs(boxes[:, 3:12].reshape(-1, 3, 3)) @ boxes[:, 12:, None]
        middle = boxes[:, :3]
        low = np.concatenate((middle - reach[..., 0], triangles.min(1)))
        high = np.concatenate((middle + reach[..., 0], triangles.max(1)))
        self._terrain = SOURCE.struct("Terrain")(
            boxes=np.ascontiguousarray(boxes, np.float32),
            num_boxes=len(boxes),
            triangles=np.ascontiguousarray(triangles, np.float32),
            **_bins(low[:, :2], high[:, :2]),
        )

    def depth(self, position: Tensor, rotation: Tensor, lens: Intrinsics, limit: float) -> Tensor:
        """Planar depth, as `TerrainScanner.depth`: [N, H * W] m, at most `limit`."""
        depth = torch.empty(len(position), lens.height * lens.width)
        left, up = lens.axes(np.float32)
        argument = SOURCE.struct("Draw")(
            terrain=self._terrain,
            cameras=len(position),
            eyes=position.float().contiguous().numpy(),
            rotations=rotation.float().contiguous().numpy(),
            width=lens.width,
            height=lens.height,
            left=left,
            up=up,
            limit=limit,
            images=depth.numpy(),
        )
        SOURCE.call("draw", argument)
        return depth

    def clearance(self, position: Tensor, rotation: Tensor | None, pattern: Tensor) -> Tensor:
        """Height over the terrain, as `TerrainScanner.clearance`: [N, P] m."""
        clearance = torch.empty(len(position), len(pattern))
        argument = SOURCE.struct("Scan")(
            terrain=self._terrain,
            frames=len(position),
            positions=position.float().contiguous().numpy(),
            rotations=None if rotation is None else rotation.float().contiguous().numpy(),
            pattern=pattern.float().contiguous().numpy(),
            points=len(pattern),
            top=self.top,
            drop=self.drop,
            clearances=clearance.numpy(),
        )
        SOURCE.call("scan", argument, alone=clearance.numel() < FEW)
        return clearance


@lru_cache(maxsize=8)
def scanner(
    model: mujoco.MjModel, device: str, without: frozenset[int] = frozenset()
) -> TerrainScanner:
    """The fastest scanner of a model's terrain, built once and shared by all sensors."""
    if wp.get_device(device).is_cpu:
        return Rasterizer(model, without)
    return TerrainScanner(model, device, without)


def _bins(low: np.ndarray, high: np.ndarray) -> dict[str, object]:
    """The shapes that touch each bin, as fields of the struct Terrain.

    Args:
        low, high: [shapes, 2] horizontal corners of the boxes around them, m.
    """
    wide = (high - low > WIDE).any(-1)
    fine = np.flatnonzero(~wide)
    start = low[fine].min(0) if len(fine) else np.zeros(2)
    size = high[fine].max(0) - start if len(fine) else np.zeros(2)
    side = max(BIN, float(np.sqrt(size.prod() / MAX_BINS)))
    count = np.floor(size / side).astype(int) + 1 if len(fine) else np.zeros(2, int)
    first = np.clip(((low - start) / side).astype(int), 0, None)
    last = np.minimum(((high - start) / side).astype(int), count - 1)
    spans = [
        np.add.outer(np.arange(a, c + 1) * count[1], np.arange(b, d + 1)).ravel()
        for (a, b), (c, d) in zip(first[fine], last[fine], strict=True)
    ]
    bins = np.concatenate([np.zeros(0, int), *spans])
    items = np.repeat(fine, [len(span) for span in spans])
    ends = np.cumsum(np.bincount(bins, minlength=int(count.prod())))
    return {
        "wide": np.flatnonzero(wide).astype(np.int32),
        "num_wide": int(wide.sum()),
        "bins_x": int(count[0]),
        "bins_y": int(count[1]),
        "corner_x": start[0],
        "corner_y": start[1],
        "side": side,
        "offsets": np.concatenate(([0], ends)).astype(np.int32),
        "items": items[np.argsort(bins, kind="stable")].astype(np.int32),
        "first_bin": np.ascontiguousarray(first, np.int32),
    }
