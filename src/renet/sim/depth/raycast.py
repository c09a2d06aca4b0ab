"""Ray casting against the terrain mesh with NVIDIA Warp.

The kernels run on a CPU as on a GPU, but `rasterizer.scanner` gives a CPU the rasterizer, which is
thirty times as fast there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
import torch
import warp as wp
from torch import Tensor

from renet.camera import Intrinsics
from renet.sim.depth.terrain_mesh import terrain_mesh

wp.set_module_options({"enable_backward": False})


@wp.kernel
def cast_depth(
    mesh: wp.uint64,
    position: wp.array(dtype=wp.vec3),  # type: ignore[valid-type]
    rotation: wp.array(dtype=wp.mat33),  # type: ignore[valid-type]
    rays: wp.array(dtype=wp.vec3),  # type: ignore[valid-type]
    limit: float,
    depth: wp.array2d(dtype=float),  # type: ignore[valid-type]
):
    """Depth along rays given in camera frames; a miss within `limit` is -1.

    Rays have unit forward component, so that the ray parameter is the distance to the image plane.
    """
    camera, pixel = wp.tid()  # type: ignore[misc]
    ray = rotation[camera] * rays[pixel]
    hit = wp.mesh_query_ray(mesh, position[camera], ray, limit)
    if hit.result:
        depth[camera, pixel] = hit.t
    else:
        depth[camera, pixel] = -1.0


@wp.kernel
def cast_down(
    mesh: wp.uint64,
    position: wp.array(dtype=wp.vec3),  # type: ignore[valid-type]
    rotation: wp.array(dtype=wp.mat33),  # type: ignore[valid-type]
    pattern: wp.array(dtype=wp.vec2),  # type: ignore[valid-type]
    top: float,
    limit: float,
    clearance: wp.array2d(dtype=float),  # type: ignore[valid-type]
):
    """Height of frames over the highest surface at points around them, far where there is none.

    The pattern turns with the yaw of rotations; where there are none, it does not.
    """
    frame, point = wp.tid()  # type: ignore[misc]
    origin = position[frame]
    at = pattern[point]
    cosine, sine = 1.0, 0.0
    if rotation:
        a, b = rotation[frame][0, 0], rotation[frame][1, 0]
        size = wp.max(wp.sqrt(a * a + b * b), 1.0e-12)
        cosine, sine = a / size, b / size
    x = origin[0] + cosine * at[0] - sine * at[1]
    y = origin[1] + sine * at[0] + cosine * at[1]
    start, down = wp.vec3(x, y, top), wp.vec3(0.0, 0.0, -1.0)
    hit = wp.mesh_query_ray(mesh, start, down, limit)  # type: ignore[arg-type]
    if hit.result:
        clearance[frame, point] = origin[2] - (top - hit.t)
    else:
        clearance[frame, point] = origin[2] - (top - limit)


class TerrainScanner:
    """Depth images and heights of a model's terrain by ray casting on any device."""

    def __init__(
        self, model: mujoco.MjModel, device: str, without: frozenset[int] = frozenset()
    ) -> None:
        """Take the terrain of a model, save for the geoms `without`.

        Raises:
            RenetError: the terrain has a shape that cannot be turned into triangles, or none.
        """
        self._vertices, self._faces = terrain_mesh(model, without)
        self.device = wp.get_device(device)
        self.triangles = len(self._faces)
        self.top = float(self._vertices[:, 2].max()) + 1.0
        self.drop = self.top - float(self._vertices[:, 2].min()) + 1.0

    @cached_property
    def _mesh(self) -> wp.Mesh:
        """The terrain with a search tree, built when rays are first cast."""
        points = wp.array(self._vertices, dtype=wp.vec3, device=self.device)
        return wp.Mesh(points, wp.array(self._faces.ravel(), dtype=wp.int32, device=self.device))

    def height(self, points: Tensor) -> Tensor:
        """Terrain height in metres under world points [M, 2]: [M].

        The highest surface; 1 m below the lowest one where there is none.
        """
        position = torch.nn.functional.pad(points, (0, 1))
        return -self.clearance(position, None, position.new_zeros(1, 2)).squeeze(-1)

    def clearance(self, position: Tensor, rotation: Tensor | None, pattern: Tensor) -> Tensor:
        """Height of frames over the terrain at points around them.

        Args:
            position: [N, 3] m, world.
            rotation: [N, 3, 3], frame to world; its yaw turns the pattern. None does not.
            pattern: [P, 2] m from the position.

        Returns:
            [N, P] m; terrain is taken to be 1 m below its lowest where there is none.
        """
        frames = _rows(position).unsqueeze(1)
        turns = None if rotation is None else _rows(rotation).unsqueeze(1)
        return self.watch(frames, turns, (0,), pattern)().squeeze(1)

    def watch(
        self,
        position: Tensor,
        rotation: Tensor | None,
        parts: Sequence[int],
        pattern: Tensor,
    ) -> Callable[[], Tensor]:
        """Prepare `clearance` of some frames in arrays that stay where they are.

        Args:
            position: [N, B, 3] m, world.
            rotation: [N, B, 3, 3], frames to world; their yaw turns the pattern. None does not.
            parts: which of the B.
            pattern: [P, 2] m from each position.

        Returns:
            A function of none that gives [N, parts, P] m, which its next call may overwrite.
        """
        index = torch.tensor(parts, device=position.device)

        def look() -> Tensor:
            frames = position[:, index].flatten(0, 1)
            turns = None if rotation is None else rotation[:, index].flatten(0, 1)
            clearance = torch.empty(len(frames), len(pattern), device=frames.device)
            poses = _warp(frames, wp.vec3), None if turns is None else _warp(turns, wp.mat33)
            self._launch(cast_down, clearance, *poses, _warp(pattern, wp.vec2), self.top, self.drop)
            return clearance.unflatten(0, (-1, len(index)))

        return look

    def depth(self, position: Tensor, rotation: Tensor, lens: Intrinsics, limit: float) -> Tensor:
        """Planar depth of cameras.

        Args:
            position: [N, 3] m, world.
            rotation: [N, 3, 3], camera axes (forward, left, up) as columns, world.
            lens: rays of every camera.
            limit: m beyond which nothing is seen.

        Returns:
            [N, H * W] metres to the image plane; -1 where nothing was hit.
        """
        rays = torch.from_numpy(lens.rays(np.float32)).to(position.device)
        depth = torch.empty(len(position), len(rays), device=position.device)
        inputs = (_warp(position, wp.vec3), _warp(rotation, wp.mat33), _warp(rays, wp.vec3), limit)
        self._launch(cast_depth, depth, *inputs)
        return depth

    def _launch(self, kernel: Any, results: Tensor, *inputs: Any) -> None:
        """Fill `results`, on the stream that torch uses."""
        arguments = [self._mesh.id, *inputs, wp.from_torch(results)]
        if self.device.is_cpu:
            wp.launch(kernel, results.shape, arguments, device=self.device)
            return
        stream = torch.cuda.current_stream(wp.device_to_torch(self.device))
        with wp.ScopedStream(wp.stream_from_torch(stream)):
            wp.launch(kernel, results.shape, arguments, device=self.device)


def _warp(values: Tensor, dtype: Any) -> Any:
    return wp.from_torch(values.float().contiguous(), dtype=dtype)


def _rows(values: Tensor) -> Tensor:
    """The same as float32, each row in one piece; a view where it is so already."""
    values = values.float()
    return values if values[0:1].is_contiguous() else values.contiguous()
