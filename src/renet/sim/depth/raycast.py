"""Ray casting against the terrain mesh with NVIDIA Warp.

The kernel runs on GPUs and CPUs, but `rasterizer.scanner` chooses the rasterizer on a CPU, which is
thirty times as fast there.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import mujoco
import numpy as np
import torch
import warp as wp
from torch import Tensor

from renet.camera import Intrinsics
from renet.sim.depth.terrain_mesh import box_triangles, terrain_shapes

wp.set_module_options({"enable_backward": False})


@wp.kernel
def cast(
    mesh: wp.uint64,
    position: wp.array(dtype=wp.vec3),  # type: ignore[valid-type]
    rotation: wp.array(dtype=wp.mat33),  # type: ignore[valid-type]
    rays: wp.array(dtype=wp.vec3),  # type: ignore[valid-type]
    limit: float,
    depth: wp.array2d(dtype=float),  # type: ignore[valid-type]
):
    """Cast rays given in camera frames; depth is the ray parameter of a hit, -1 beyond `limit`.

    For rays whose forward component is 1 that is the distance to the image plane.
    """
    camera, pixel = wp.tid()  # type: ignore[misc]
    ray = rotation[camera] * rays[pixel]
    hit = wp.mesh_query_ray(mesh, position[camera], ray, limit)
    depth[camera, pixel] = wp.where(hit.result, hit.t, -1.0)


class TerrainScanner:
    """Depth images and heights of a model's terrain by ray casting on any device."""

    def __init__(
        self, model: mujoco.MjModel, device: str, without: frozenset[int] = frozenset()
    ) -> None:
        """Take the terrain of a model; arguments and errors are those of `terrain_shapes`."""
        self.device = wp.get_device(device)
        self._shapes = boxes, others = terrain_shapes(model, without)
        self.triangles = np.concatenate((box_triangles(boxes), others)).astype(np.float32)
        """Corners of the terrain's triangles, [T, 3, 3] m, world."""
        self.top = float(self.triangles[..., 2].max()) + 1.0
        """A height above all terrain, m."""
        self.drop = self.top - float(self.triangles[..., 2].min()) + 1.0
        """Distance from `top` to 1 m below all terrain, m."""

    @cached_property
    def _mesh(self) -> wp.Mesh:
        """The mesh with its search tree, built when rays are first cast."""
        points = self.triangles.reshape(-1, 3)
        corners = np.arange(len(points), dtype=np.int32)
        return wp.Mesh(
            wp.array(points, dtype=wp.vec3, device=self.device),
            wp.array(corners, dtype=wp.int32, device=self.device),
        )

    def height(self, points: Tensor) -> Tensor:
        """Height of the highest surface at world points [M, 2]: [M] m.

        Where there is no terrain, it is 1 m below the lowest surface.
        """
        position = torch.nn.functional.pad(points, (0, 1))
        return -self.clearance(position, None, position.new_zeros(1, 2)).squeeze(-1)

    def clearance(self, position: Tensor, rotation: Tensor | None, pattern: Tensor) -> Tensor:
        """Height of frames over the terrain at points around them, [N, P] m.

        Where there is no terrain, it is taken as 1 m below the lowest surface.

        Args:
            position: [N, 3] m, world.
            rotation: [N, 3, 3], frame to world, whose yaw turns the pattern; None: no turn.
            pattern: [P, 2] m from the position.
        """
        position = position.float()
        x, y = pattern.float().unbind(-1)
        if rotation is not None:
            ahead = torch.nn.functional.normalize(rotation[:, :2, 0].float(), dim=-1)
            cosine, sine = ahead[:, :1], ahead[:, 1:]
            x, y = cosine * x - sine * y, sine * x + cosine * y
        x, y = position[:, :1] + x, position[:, 1:2] + y
        above = torch.stack((x, y, torch.full_like(x, self.top)), dim=-1).flatten(0, 1)
        axes = torch.eye(3, device=x.device)
        fall = self._cast(above, axes.expand(len(above), 3, 3), -axes[2:], self.drop).view_as(x)
        return position[:, 2:] - (self.top - torch.where(fall < 0.0, self.drop, fall))

    def depth(self, position: Tensor, rotation: Tensor, lens: Intrinsics, limit: float) -> Tensor:
        """Planar depth of cameras, [N, H * W] m to the image plane; -1 where nothing is seen.

        Args:
            position: [N, 3] m, world.
            rotation: [N, 3, 3], camera axes (forward, left, up) as columns, world.
            lens: rays of every camera. limit: m of depth beyond which nothing is seen.
        """
        rays = torch.from_numpy(lens.rays(np.float32)).to(position.device)
        return self._cast(position, rotation, rays, limit)

    def _cast(self, position: Tensor, rotation: Tensor, rays: Tensor, limit: float) -> Tensor:
        """Cast rays [P, 3] from each of N poses, on torch's stream: [N, P]."""
        depth = torch.empty(len(position), len(rays), device=position.device)
        poses = _warp(position, wp.vec3), _warp(rotation, wp.mat33)
        inputs = [self._mesh.id, *poses, _warp(rays, wp.vec3), limit, wp.from_torch(depth)]
        stream = None
        if not self.device.is_cpu:
            current = torch.cuda.current_stream(wp.device_to_torch(self.device))
            stream = wp.stream_from_torch(current)
        with wp.ScopedStream(stream):
            wp.launch(cast, depth.shape, inputs, device=self.device)
        return depth


def _warp(values: Tensor, dtype: Any) -> Any:
    return wp.from_torch(values.float().contiguous(), dtype=dtype)
