"""Depth images and heights of terrain on the CPU, from boxes and triangles in small square bins."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from threading import local

import mujoco
import numpy as np
import torch
import warp as wp
from torch import Tensor

from renet.camera import Intrinsics
from renet.sim.depth.raycast import TerrainScanner
from renet.sim.depth.terrain_mesh import terrain_shapes
from renet.sim.native.compiler import Call, Source

SOURCE = Source(Path(__file__).with_name("rasterizer.cpp"))
BIN = 0.25
"""Side of a bin, m: about a step of stairs."""
WIDE = 20.0
"""Shapes wider than this (planes, the border) are looked at from everywhere, m."""
MAX_BINS = 1 << 20
"""About; larger terrains get larger bins."""
FEW = 4096
"""Points that one thread looks at before another would have been of help."""

wp.set_module_options({"enable_backward": False})


@wp.func_native(SOURCE.snippet("draw", "Draw"))
def _draw(call: wp.uint64): ...


@wp.kernel
def draw(call: wp.uint64):
    """Draw depth images; `call` is the address of a struct Draw of rasterizer.cpp."""
    _draw(call)


@wp.func_native(SOURCE.snippet("scan", "Scan"))
def _scan(call: wp.uint64): ...


@wp.kernel
def scan(call: wp.uint64):
    """Measure heights over terrain; `call` is the address of a struct Scan of rasterizer.cpp."""
    _scan(call)


class Rasterizer(TerrainScanner):
    """Draws depth images shape by shape, and finds heights, on the CPU.

    Each shape near the camera fills the pixels it covers, where a ray caster walks a search tree
    for every pixel.
    """

    def __init__(self, model: mujoco.MjModel, without: frozenset[int] = frozenset()) -> None:
        """Sort the shapes of a model's terrain, save for the geoms `without`, into bins."""
        super().__init__(model, "cpu", without)
        wp.load_module(__name__, device="cpu")  # Else every thread compiles it.
        self._calls = local()
        boxes, triangles = terrain_shapes(model, without)
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
        """See TerrainScanner.depth."""
        images = np.empty((len(position), lens.height * lens.width), np.float32)
        left, up = lens.axes(np.float32)
        fields = {
            "cameras": len(position),
            "eyes": position.contiguous().float().numpy(),
            "rotations": rotation.contiguous().float().numpy(),
            "width": lens.width,
            "height": lens.height,
            "left": left,
            "up": up,
            "limit": limit,
            "images": images,
        }
        calls = vars(self._calls)  # Of this thread only.
        if "draw" not in calls:
            argument = SOURCE.struct("Draw")(terrain=self._terrain, **fields)
            calls["draw"] = Call(draw, argument)
        calls["draw"].argument.set(**fields)
        calls["draw"]()
        return torch.from_numpy(images)

    def watch(
        self,
        position: Tensor,
        rotation: Tensor | None,
        parts: Sequence[int],
        pattern: Tensor,
    ) -> Callable[[], Tensor]:
        """See TerrainScanner.watch."""
        count, points = len(position) * len(parts), len(pattern)
        clearance = torch.empty(len(position), len(parts), points)
        argument = SOURCE.struct("Scan")(
            terrain=self._terrain,
            frames=count,
            positions=position.numpy(),
            position_stride=position.stride(0),
            rotations=None if rotation is None else rotation.numpy(),
            rotation_stride=0 if rotation is None else rotation.stride(0),
            part=np.array(parts, np.int64),
            parts=len(parts),
            pattern=pattern.contiguous().float().numpy(),
            points=points,
            top=self.top,
            drop=self.drop,
            clearances=clearance.numpy(),
        )
        call = Call(scan, argument, alone=count * points < FEW)

        def look() -> Tensor:
            call()
            return clearance

        return look


@lru_cache(maxsize=8)
def scanner(
    model: mujoco.MjModel, device: str, without: frozenset[int] = frozenset()
) -> TerrainScanner:
    """The quickest scanner of a model, made once and shared by every sensor on it."""
    if wp.get_device(device).is_cpu:
        return Rasterizer(model, without)
    return TerrainScanner(model, device, without)


def _bins(low: np.ndarray, high: np.ndarray) -> dict[str, object]:
    """The shapes that touch each bin, as fields of the struct Terrain.

    Args:
        low: [shapes, 2] horizontal corners of the boxes around them, m.
        high: [shapes, 2].
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
