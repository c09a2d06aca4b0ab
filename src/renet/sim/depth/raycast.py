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
    """Cast rays given in camera frames.

    `depth` is the ray parameter of a hit, or -1 beyond `limit`. For rays whose forward component is
    1 it is the distance to the image plane.
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
        """Collect the terrain of a model; arguments and errors are those of `terrain_shapes`."""
        self.device = wp.get_device(device)
        boxes, others = terrain_shapes(model, without)
        self._shapes = (boxes, others)
        self.triangles = np.concatenate((box_triangles(boxes), others)).astype(np.float32)
        """Corners of the terrain's triangles in the world frame, [T, 3, 3] m."""
        self.top = float(self.triangles[..., 2].max()) + 1.0
        """Height above all terrain, m."""
        self.drop = self.top - float(self.triangles[..., 2].min()) + 1.0
        """Distance from `top` to 1 m below all terrain, m."""

    @cached_property
    def _mesh(self) -> wp.Mesh:
        """Mesh with its search tree, built when rays are first cast."""
        points = self.triangles.reshape(-1, 3)
        corners = np.arange(len(points), dtype=np.int32)
        return wp.Mesh(
            wp.array(points, dtype=wp.vec3, device=self.device),
            wp.array(corners, dtype=wp.int32, device=self.device),
        )

    def height(self, points: Tensor) -> Tensor:
        """Compute the height of the highest surface at points [M, 2] of the world, [M] m.

        Without terrain it is 1 m below the lowest surface.
        """
        position = torch.nn.functional.pad(points, (0, 1))
        return -self.clearance(position, None, position.new_zeros(1, 2)).squeeze(-1)

    def clearance(self, position: Tensor, rotation: Tensor | None, pattern: Tensor) -> Tensor:
        """Compute the height of frames over the terrain at points around them.

        Points without terrain count as 1 m below the lowest surface.

        Args:
            position: Positions in the world frame, [N, 3] m.
            rotation: Rotations from the frames to the world, [N, 3, 3], whose yaw turns the
                pattern; None leaves the pattern as it is.
            pattern: Points relative to the positions, [P, 2] m.

        Returns:
            Heights, [N, P] m.
        """
        position = position.float()
        x, y = pattern.float().unbind(-1)
        # Turn the pattern by the yaw, and move it to the positions.
        if rotation is not None:
            forward = torch.nn.functional.normalize(rotation[:, :2, 0].float(), dim=-1)
            cosine = forward[:, :1]
            sine = forward[:, 1:]
            x, y = cosine * x - sine * y, sine * x + cosine * y
        x = position[:, :1] + x
        y = position[:, 1:2] + y
        # Cast a ray downwards from above all terrain at each point.
        start = torch.stack((x, y, torch.full_like(x, self.top)), dim=-1).flatten(0, 1)
        axes = torch.eye(3, device=x.device)
        rotations = axes.expand(len(start), 3, 3)
        distance = self._cast(start, rotations, -axes[2:], self.drop).view_as(x)
        distance = torch.where(distance < 0.0, self.drop, distance)
        return position[:, 2:] - (self.top - distance)

    def depth(self, position: Tensor, rotation: Tensor, lens: Intrinsics, limit: float) -> Tensor:
        """Compute planar depth of N cameras.

        Args:
            position: Positions in the world frame, [N, 3] m.
            rotation: Camera axes (forward, left, up) in the world frame as columns, [N, 3, 3].
            lens: Intrinsics of all cameras.
            limit: Largest depth, m.

        Returns:
            Distances to the image plane, [N, H * W] m; -1 beyond the limit.
        """
        rays = torch.from_numpy(lens.rays(np.float32)).to(position.device)
        return self._cast(position, rotation, rays, limit)

    def _cast(self, position: Tensor, rotation: Tensor, rays: Tensor, limit: float) -> Tensor:
        """Cast rays [P, 3] from each of N poses, on torch's stream; returns depth [N, P]."""
        depth = torch.empty(len(position), len(rays), device=position.device)
        inputs = [
            self._mesh.id,
            _to_warp(position, wp.vec3),
            _to_warp(rotation, wp.mat33),
            _to_warp(rays, wp.vec3),
            limit,
            wp.from_torch(depth),
        ]
        stream = None
        if not self.device.is_cpu:
            current = torch.cuda.current_stream(wp.device_to_torch(self.device))
            stream = wp.stream_from_torch(current)
        with wp.ScopedStream(stream):
            wp.launch(cast, depth.shape, inputs, device=self.device)
        return depth


def _to_warp(values: Tensor, dtype: Any) -> Any:
    """Convert a tensor to a Warp array of vectors or matrices."""
    return wp.from_torch(values.float().contiguous(), dtype=dtype)
