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

RASTERIZER_SOURCE = Source(Path(__file__).with_name("rasterizer.cpp"))
BIN = 0.25
"""Side of a bin, m: about a step of stairs."""
WIDE = 20.0
"""Width above which shapes (planes, the border) are in no bin and always drawn, m."""
MAX_BINS = 1 << 20
"""Approximate largest number of bins; larger terrains get larger bins."""
MIN_POINTS = 4096
"""Smallest number of points for which more threads are faster than one."""


class Rasterizer(TerrainScanner):
    """Depth images and heights of a model's terrain by rasterization, on the CPU.

    Each shape near the camera fills the pixels that it covers, whereas a ray caster searches a tree
    for each pixel.
    """

    def __init__(self, model: mujoco.MjModel, without: frozenset[int] = frozenset()) -> None:
        """Sort the shapes of a model's terrain into bins; `without` as in `terrain_shapes`."""
        super().__init__(model, "cpu", without)
        boxes, triangles = self._shapes
        # Axis-aligned boxes around all shapes.
        reach = np.abs(boxes[:, 3:12].reshape(-1, 3, 3)) @ boxes[:, 12:, None]
        middle = boxes[:, :3]
        low = np.concatenate((middle - reach[..., 0], triangles.min(1)))
        high = np.concatenate((middle + reach[..., 0], triangles.max(1)))
        self._terrain = RASTERIZER_SOURCE.struct("Terrain")(
            boxes=np.ascontiguousarray(boxes, np.float32),
            num_boxes=len(boxes),
            triangles=np.ascontiguousarray(triangles, np.float32),
            **_bins(low[:, :2], high[:, :2]),
        )

    def depth(self, position: Tensor, rotation: Tensor, lens: Intrinsics, limit: float) -> Tensor:
        """Compute planar depth as `TerrainScanner.depth` does, [N, H * W] m, at most `limit`."""
        depth = torch.empty(len(position), lens.height * lens.width)
        left, up = lens.axes(np.float32)
        argument = RASTERIZER_SOURCE.struct("Draw")(
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
        RASTERIZER_SOURCE.call("draw", argument)
        return depth

    def clearance(self, position: Tensor, rotation: Tensor | None, pattern: Tensor) -> Tensor:
        """Compute heights over the terrain as `TerrainScanner.clearance` does, [N, P] m."""
        clearance = torch.empty(len(position), len(pattern))
        argument = RASTERIZER_SOURCE.struct("Scan")(
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
        RASTERIZER_SOURCE.call("scan", argument, alone=clearance.numel() < MIN_POINTS)
        return clearance


@lru_cache(maxsize=8)
def scanner(
    model: mujoco.MjModel, device: str, without: frozenset[int] = frozenset()
) -> TerrainScanner:
    """Build the fastest scanner of a model's terrain, once for all sensors."""
    if wp.get_device(device).is_cpu:
        return Rasterizer(model, without)
    return TerrainScanner(model, device, without)


def _bins(low: np.ndarray, high: np.ndarray) -> dict[str, object]:
    """Sort shapes into bins.

    Args:
        low: Lowest x and y of each shape, [S, 2] m.
        high: Highest x and y of each shape, [S, 2] m.

    Returns:
        The shapes that touch each bin, as fields of the struct Terrain.
    """
    # Shapes in bins, and the area that the bins cover.
    wide = (high - low > WIDE).any(-1)
    narrow = np.flatnonzero(~wide)
    start = np.zeros(2)
    size = np.zeros(2)
    if len(narrow):
        start = low[narrow].min(0)
        size = high[narrow].max(0) - start
    side = max(BIN, float(np.sqrt(size.prod() / MAX_BINS)))
    count = np.zeros(2, int)
    if len(narrow):
        count = np.floor(size / side).astype(int) + 1

    # Bins that each shape touches: a rectangle from its first to its last bin.
    first = np.clip(((low - start) / side).astype(int), 0, None)
    last = np.minimum(((high - start) / side).astype(int), count - 1)
    spans = []
    for (first_x, first_y), (last_x, last_y) in zip(first[narrow], last[narrow], strict=True):
        rows = np.arange(first_x, last_x + 1) * count[1]
        columns = np.arange(first_y, last_y + 1)
        spans.append(np.add.outer(rows, columns).ravel())

    # A list of shapes sorted by bin, and where each bin's part of it ends.
    bins = np.concatenate([np.zeros(0, int), *spans])
    items = np.repeat(narrow, [len(span) for span in spans])
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
