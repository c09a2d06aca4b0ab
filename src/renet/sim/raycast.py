"""Ray casting against the terrain mesh with NVIDIA Warp: one kernel set for CPU and CUDA."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import mujoco
import torch
import warp as wp
from torch import Tensor

from renet.sim.terrain_mesh import terrain_mesh
from renet.sim.threads import for_chunks


@wp.kernel
def cast_depth(
    mesh: wp.uint64,
    position: wp.array(dtype=wp.vec3),  # type: ignore[valid-type]
    rotation: wp.array(dtype=wp.mat33),  # type: ignore[valid-type]
    rays: wp.array(dtype=wp.vec3),  # type: ignore[valid-type]
    first: int,
    limit: float,
    depth: wp.array2d(dtype=float),  # type: ignore[valid-type]
):
    """Depth along rays given in camera frames; a miss within `limit` is -1.

    Rays have unit forward component, so that the ray parameter is the distance to the image plane.
    """
    row, pixel = wp.tid()  # type: ignore[misc]
    camera = row + first
    hit = wp.mesh_query_ray(mesh, position[camera], rotation[camera] * rays[pixel], limit)
    if hit.result:
        depth[camera, pixel] = hit.t
    else:
        depth[camera, pixel] = -1.0


@wp.kernel
def cast_down(
    mesh: wp.uint64,
    points: wp.array(dtype=wp.vec2),  # type: ignore[valid-type]
    first: int,
    top: float,
    limit: float,
    height: wp.array(dtype=float),  # type: ignore[valid-type]
):
    """Height of the highest surface under each (x, y); far below where there is none."""
    point = wp.tid() + first  # type: ignore[operator]
    start = wp.vec3(points[point][0], points[point][1], top)
    hit = wp.mesh_query_ray(mesh, start, wp.vec3(0.0, 0.0, -1.0), limit)  # type: ignore[arg-type]
    if hit.result:
        height[point] = top - hit.t
    else:
        height[point] = top - limit


class TerrainScanner:
    """Casts rays against a model's terrain; shared by every sensor on that model."""

    def __init__(self, model: mujoco.MjModel, device: str) -> None:
        vertices, faces = terrain_mesh(model)
        self.device = wp.get_device(device)
        self.top = float(vertices[:, 2].max()) + 1.0
        self.drop = self.top - float(vertices[:, 2].min()) + 1.0
        self.mesh = wp.Mesh(
            points=wp.array(vertices, dtype=wp.vec3, device=self.device),
            indices=wp.array(faces.ravel(), dtype=wp.int32, device=self.device),
        )

    def height(self, points: Tensor) -> Tensor:
        """Terrain height in metres under world points [M, 2]: [M]."""
        height = torch.empty(len(points), device=points.device)
        inputs = wp.from_torch(points.contiguous(), dtype=wp.vec2)
        self._launch(
            cast_down,
            len(points),
            (),
            lambda first: [self.mesh.id, inputs, first, self.top, self.drop, wp.from_torch(height)],
        )
        return height

    def depth(self, position: Tensor, rotation: Tensor, rays: Tensor, limit: float) -> Tensor:
        """Planar depth of cameras.

        Args:
            position: [N, 3] m, world. rotation: [N, 3, 3], camera axes (forward, left, up) as
            columns, world. rays: [P, 3] in the camera frame with forward component 1.
            limit: metres beyond which nothing is seen.

        Returns:
            [N, P] metres to the image plane; -1 where nothing was hit.
        """
        depth = torch.empty(len(position), len(rays), device=position.device)
        arrays = (
            wp.from_torch(position.contiguous(), dtype=wp.vec3),
            wp.from_torch(rotation.contiguous(), dtype=wp.mat33),
            wp.from_torch(rays.contiguous(), dtype=wp.vec3),
        )
        self._launch(
            cast_depth,
            len(position),
            (len(rays),),
            lambda first: [self.mesh.id, *arrays, first, limit, wp.from_torch(depth)],
        )
        return depth

    def _launch(self, kernel: Any, count: int, inner: tuple[int, ...], inputs: Any) -> None:
        """Launch over `count` rows: at once on a GPU, in parallel chunks on a CPU."""

        def run(first: int, last: int) -> None:
            wp.launch(kernel, (last - first, *inner), inputs(first), device=self.device)

        if self.device.is_cpu:
            for_chunks(count, run)
        else:
            with wp.ScopedStream(wp.stream_from_torch(torch.cuda.current_stream())):
                run(0, count)


@lru_cache(maxsize=8)
def scanner(model: mujoco.MjModel, device: str) -> TerrainScanner:
    """The scanner of a model: its mesh and BVH are built once."""
    return TerrainScanner(model, device)
