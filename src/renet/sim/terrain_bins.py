"""Terrain as boxes and triangles in small square bins: what a CPU draws depth images from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from threading import local

import mujoco
import numpy as np
import torch
import warp as wp
from torch import Tensor

from renet.sim import raster_kernel
from renet.sim.native_call import Call
from renet.sim.raster_kernel import draw, scan
from renet.sim.terrain_mesh import terrain_shapes

BIN = 0.25
"""Side of a bin, m: about a step of stairs."""
WIDE = 20.0
"""Shapes wider than this (planes, the border) are looked at from everywhere, m."""
MAX_BINS = 1 << 20
"""About; larger terrains get larger bins."""
FEW = 4096
"""Points that one thread looks at before another would have been of help."""


@dataclass(frozen=True)
class Pinhole:
    """Rays of an image whose rows and columns are straight."""

    left: np.ndarray
    """[W] of each column, evenly spaced, at forward distance 1."""
    up: np.ndarray
    """[H] of each row."""

    @staticmethod
    def of(rays: Tensor) -> Pinhole | None:
        """The image that rays [P, 3] with forward component 1 make; None if they make none."""
        forward, left, up = rays.float().numpy().T
        width = int(np.argmax(up != up[0])) or len(up)
        if len(up) % width or width < 2 or len(up) < 2 * width:
            return None
        left, up = left.reshape(-1, width), up.reshape(-1, width)
        even = all(np.allclose(np.diff(a), a[1] - a[0], rtol=1e-3) for a in (left[0], up[:, 0]))
        straight = (left == left[0]).all() and (up == up[:, :1]).all() and (forward == 1.0).all()
        return Pinhole(left[0].copy(), up[:, 0].copy()) if even and straight else None


class TerrainBins:
    """Draws depth images shape by shape, and finds heights, on the CPU.

    Each shape near the camera fills the pixels it covers, in vectorised rows, where a ray caster
    walks a search tree for every pixel.
    """

    def __init__(self, model: mujoco.MjModel, without: frozenset[int] = frozenset()) -> None:
        """Sort the shapes of a model's terrain, save for the geoms `without`, into bins."""
        wp.load_module(raster_kernel, device="cpu")  # Else every thread compiles it.
        self._calls = local()
        shapes = terrain_shapes(model, without)
        self._boxes = np.ascontiguousarray(shapes.boxes, np.float32)
        self._triangles = np.ascontiguousarray(shapes.triangles, np.float32)
        reach = np.abs(shapes.boxes[:, 3:12].reshape(-1, 3, 3)) @ shapes.boxes[:, 12:, None]
        middle = shapes.boxes[:, :3]
        low = np.concatenate((middle - reach[..., 0], shapes.triangles.min(1)))
        high = np.concatenate((middle + reach[..., 0], shapes.triangles.max(1)))
        self._sort(low[:, :2], high[:, :2])

    def _sort(self, low: np.ndarray, high: np.ndarray) -> None:
        """List the shapes that touch each bin."""
        wide = (high - low > WIDE).any(-1)
        self._wide = np.flatnonzero(wide).astype(np.int32)
        fine = np.flatnonzero(~wide)
        start = low[fine].min(0) if len(fine) else np.zeros(2)
        size = high[fine].max(0) - start if len(fine) else np.zeros(2)
        side = max(BIN, float(np.sqrt(size.prod() / MAX_BINS)))
        count = np.floor(size / side).astype(int) + 1 if len(fine) else np.zeros(2, int)
        first = np.clip(((low - start) / side).astype(int), 0, None)
        last = np.minimum(((high - start) / side).astype(int), count - 1)
        self._first = np.ascontiguousarray(first, np.int32)
        spans = [
            np.add.outer(np.arange(a, c + 1) * count[1], np.arange(b, d + 1)).ravel()
            for (a, b), (c, d) in zip(first[fine], last[fine], strict=True)
        ]
        bins = np.concatenate([np.zeros(0, int), *spans])
        items = np.repeat(fine, [len(span) for span in spans])
        self._items = items[np.argsort(bins, kind="stable")].astype(np.int32)
        ends = np.cumsum(np.bincount(bins, minlength=int(count.prod())))
        self._offsets = np.concatenate(([0], ends)).astype(np.int32)
        self._frame = np.array([*start, side], np.float32)
        own = (self._boxes, self._triangles, self._offsets, self._items, self._first, self._wide)
        addresses = [array.ctypes.data for array in (*own, self._frame)]
        self._head = [len(self._boxes), len(self._wide), *count.tolist(), *addresses]

    def depth(self, position: Tensor, rotation: Tensor, image: Pinhole, limit: float) -> Tensor:
        """See TerrainScanner.depth: [N, H * W]."""
        depth = torch.empty(len(position), len(image.up) * len(image.left))
        # Held: a call has only addresses.
        inputs = (position.contiguous().float(), rotation.contiguous().float())
        arrays = (*(pose.numpy() for pose in inputs), depth.numpy(), image.left, image.up)
        sizes = (len(position), len(image.left), len(image.up))
        most = np.array([limit], np.float32)
        numbers = (*(array.ctypes.data for array in arrays), *sizes, most.ctypes.data)
        calls = vars(self._calls)  # Of this thread only.
        if "draw" not in calls:
            calls["draw"] = Call(draw, (*self._head, *numbers))
        calls["draw"](numbers)
        return depth

    def watch(
        self,
        position: Tensor,
        rotation: Tensor | None,
        parts: Sequence[int],
        pattern: Tensor,
        limits: tuple[float, float],
    ) -> Callable[[], Tensor]:
        """See TerrainScanner.watch; limits are its top and its drop."""
        chosen, around = np.array(parts, np.int64), pattern.contiguous().float()
        extent = np.array(limits, np.float32)
        count, points = len(position) * len(parts), len(pattern)
        clearance = torch.empty(len(position), len(parts), points)
        turn = (0, 0) if rotation is None else (rotation.data_ptr(), rotation.stride(0))
        numbers = (position.data_ptr(), position.stride(0), *turn, len(parts), chosen.ctypes.data)
        numbers += (around.data_ptr(), clearance.data_ptr(), count, points, extent.ctypes.data)
        held = (self, position, rotation, chosen, around, extent)
        call = Call(scan, (*self._head, *numbers), count * points < FEW, held)

        def look() -> Tensor:
            call()
            return clearance

        return look
