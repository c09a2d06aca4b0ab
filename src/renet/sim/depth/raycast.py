"""Ray casting against the terrain mesh with NVIDIA Warp.

The kernels run on a CPU as on a GPU. A CPU uses them only for rays that make no image: images and
heights come from the rasterizer, which is thirty times as fast there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property, lru_cache
from typing import Any

import mujoco
import numpy as np
import torch
import warp as wp
from torch import Tensor

from renet.camera import Intrinsics
from renet.sim.depth.rasterizer import Rasterizer
from renet.sim.depth.terrain_mesh import terrain_mesh
from renet.sim.threads import for_chunks

CELL = 4.0
"""Side in metres of the squares that get their own search tree."""
REACH = wp.constant(3.0)
"""Metres around its cell that a cell's tree covers; longer rays search the whole mesh."""
FINE = 20.0
"""Triangles wider than this (a ground plane's) do not extend the grid of cells, m."""
MAX_CELLS = 4096
"""About; larger terrains get larger cells."""

wp.set_module_options({"enable_backward": False})


@wp.struct
class Grid:
    """Cells over the terrain. `meshes[0]` is all of it; cell (i, j) is `meshes[1 + i * ny + j]`."""

    meshes: wp.array(dtype=wp.uint64)  # type: ignore[valid-type]
    low: wp.vec2
    cell: float
    nx: int
    ny: int


@wp.func
def mesh_around(grid: Grid, x: float, y: float):  # type: ignore[valid-type]
    """The mesh that holds everything within REACH of a point; NaN gets all of it."""
    u = (x - grid.low[0]) / grid.cell
    v = (y - grid.low[1]) / grid.cell
    if u >= 0.0 and v >= 0.0 and u < float(grid.nx) and v < float(grid.ny):
        return grid.meshes[1 + int(u) * grid.ny + int(v)]
    return grid.meshes[0]


@wp.kernel
def cast_depth(
    grid: Grid,  # type: ignore[valid-type]
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
    eye = position[camera]
    ray = rotation[camera] * rays[pixel]
    mesh = grid.meshes[0]
    if wp.length(ray) * limit <= REACH:
        mesh = mesh_around(grid, eye[0], eye[1])  # type: ignore[arg-type]
    hit = wp.mesh_query_ray(mesh, eye, ray, limit)
    if hit.result:
        depth[camera, pixel] = hit.t
    else:
        depth[camera, pixel] = -1.0


@wp.kernel
def cast_down(
    grid: Grid,  # type: ignore[valid-type]
    position: wp.array(dtype=wp.vec3),  # type: ignore[valid-type]
    rotation: wp.array(dtype=wp.mat33),  # type: ignore[valid-type]
    pattern: wp.array(dtype=wp.vec2),  # type: ignore[valid-type]
    first: int,
    top: float,
    limit: float,
    clearance: wp.array2d(dtype=float),  # type: ignore[valid-type]
):
    """Height of frames over the highest surface at points around them, far where there is none.

    The pattern turns with the yaw of rotations; where there are none, it does not.
    """
    row, point = wp.tid()  # type: ignore[misc]
    frame = row + first
    origin = position[frame]
    at = pattern[point]
    cosine, sine = 1.0, 0.0
    if rotation:
        a, b = rotation[frame][0, 0], rotation[frame][1, 0]
        size = wp.max(wp.sqrt(a * a + b * b), 1.0e-12)
        cosine, sine = a / size, b / size
    x = origin[0] + cosine * at[0] - sine * at[1]
    y = origin[1] + sine * at[0] + cosine * at[1]
    mesh = mesh_around(grid, x, y)  # type: ignore[arg-type]
    start, down = wp.vec3(x, y, top), wp.vec3(0.0, 0.0, -1.0)
    hit = wp.mesh_query_ray(mesh, start, down, limit)  # type: ignore[arg-type]
    if hit.result:
        clearance[frame, point] = origin[2] - (top - hit.t)
    else:
        clearance[frame, point] = origin[2] - (top - limit)


class TerrainScanner:
    """Casts rays against a model's terrain; shared by every sensor on that model.

    A robot sees a few metres of a terrain that measures a hundred, so every cell of a grid has a
    search tree of the triangles near it: the same hits as in the whole mesh, in about 2/3 the time.
    On a CPU images are drawn instead, shape by shape.
    """

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
        self._rasterizer = Rasterizer(model, without) if self.device.is_cpu else None

    @cached_property
    def _trees(self) -> tuple[Any, list[wp.Mesh]]:
        """The grid, and the meshes it refers to; built when rays are first cast."""
        wp.load_module(__name__, device=self.device)  # Else every thread compiles it.
        return _build_grid(self._vertices, self._faces, self.device)

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
        if self._rasterizer is not None:
            limits = (self.top, self.drop)
            return self._rasterizer.watch(position, rotation, parts, pattern, limits)
        index = torch.tensor(parts, device=position.device)

        def look() -> Tensor:
            frames = position[:, index].flatten(0, 1)
            turns = None if rotation is None else rotation[:, index].flatten(0, 1)
            return self.cast_clearance(frames, turns, pattern).unflatten(0, (-1, len(index)))

        return look

    def cast_clearance(self, position: Tensor, rotation: Tensor | None, pattern: Tensor) -> Tensor:
        """The same, by ray casting on any device."""
        clearance = torch.empty(len(position), len(pattern), device=position.device)
        frames = wp.from_torch(position.float().contiguous(), dtype=wp.vec3)
        turns = (
            None
            if rotation is None
            else wp.from_torch(rotation.float().contiguous(), dtype=wp.mat33)
        )
        around = wp.from_torch(pattern.float().contiguous(), dtype=wp.vec2)
        limits, results = (self.top, self.drop), wp.from_torch(clearance)
        self._launch(
            cast_down,
            len(position),
            (len(pattern),),
            lambda grid, first: [grid, frames, turns, around, first, *limits, results],
        )
        return clearance

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
        if self._rasterizer is not None:
            return self._rasterizer.depth(position, rotation, lens, limit)
        rays = torch.from_numpy(lens.rays(np.float32)).to(position.device)
        return self.cast_depth(position, rotation, rays, limit)

    def cast_depth(self, position: Tensor, rotation: Tensor, rays: Tensor, limit: float) -> Tensor:
        """The same along any rays [P, 3] with forward component 1: [N, P]."""
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
            lambda grid, first: [grid, *arrays, first, limit, wp.from_torch(depth)],
        )
        return depth

    def _launch(self, kernel: Any, count: int, inner: tuple[int, ...], inputs: Any) -> None:
        """Launch over `count` rows: at once on a GPU, in parallel chunks on a CPU."""
        grid, _ = self._trees  # Here, before threads share it.

        def run(first: int, last: int) -> None:
            wp.launch(kernel, (last - first, *inner), inputs(grid, first), device=self.device)

        if self.device.is_cpu:
            for_chunks(count, run)
        else:
            stream = torch.cuda.current_stream(wp.device_to_torch(self.device))
            with wp.ScopedStream(wp.stream_from_torch(stream)):
                run(0, count)


def _rows(values: Tensor) -> Tensor:
    """The same as float32, each row in one piece; a view where it is so already."""
    values = values.float()
    return values if values[0:1].is_contiguous() else values.contiguous()


@lru_cache(maxsize=8)
def scanner(
    model: mujoco.MjModel, device: str, without: frozenset[int] = frozenset()
) -> TerrainScanner:
    """The scanner of a model: its mesh and search trees are built once."""
    return TerrainScanner(model, device, without)


def _build_grid(vertices: np.ndarray, faces: np.ndarray, device: Any) -> tuple[Any, list[wp.Mesh]]:
    """The grid, and its meshes, which the caller must keep alive."""
    points = wp.array(vertices, dtype=wp.vec3, device=device)

    def mesh(of: np.ndarray) -> wp.Mesh:
        return wp.Mesh(points, wp.array(of.ravel(), dtype=wp.int32, device=device))

    low, cell, (nx, ny) = _cells(vertices, faces)
    corners = vertices[faces, :2]
    lower, upper = corners.min(1), corners.max(1)
    meshes = [mesh(faces)]
    ids = [meshes[0].id]
    for i in range(nx):
        left = low[0] + i * cell
        column = (lower[:, 0] <= left + cell + REACH) & (upper[:, 0] >= left - REACH)
        for j in range(ny):
            front = low[1] + j * cell
            row = (lower[:, 1] <= front + cell + REACH) & (upper[:, 1] >= front - REACH)
            if (column & row).any():
                meshes.append(mesh(faces[column & row]))
                ids.append(meshes[-1].id)
            else:
                ids.append(ids[0])
    grid: Any = Grid()
    grid.meshes = wp.array(ids, dtype=wp.uint64, device=device)
    grid.low, grid.cell, grid.nx, grid.ny = wp.vec2(*low), cell, nx, ny
    return grid, meshes


def _cells(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, float, tuple[int, int]]:
    """Lower corner [2], side in metres and numbers of cells; none where all triangles are wide."""
    corners = vertices[faces, :2]
    fine = corners[(np.ptp(corners, axis=1) <= FINE).all(-1)]
    if not len(fine):
        return np.zeros(2), CELL, (0, 0)
    low = fine.min((0, 1)).astype(float)
    size = fine.max((0, 1)) - low
    cell = max(CELL, float(np.sqrt(size.prod() / MAX_CELLS)))
    nx, ny = (max(1, int(np.ceil(s / cell))) for s in size)
    return low, cell, (nx, ny)
