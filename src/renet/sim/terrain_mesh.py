"""One static triangle mesh of everything a robot can stand on or bump into."""

from __future__ import annotations

import mujoco
import numpy as np

from renet.errors import RenetError

PLANE_HALF = 200.0
"""Half-width in metres that stands for an unbounded plane."""

BOX_CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
BOX_FACES = np.array(
    [
        (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
        (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
    ]
)  # fmt: skip

Part = tuple[np.ndarray, np.ndarray]
"""Vertices [V, 3] and faces [F, 3]."""


def terrain_mesh(model: mujoco.MjModel) -> Part:
    """Triangulate the world-fixed geoms of a model that can collide.

    Returns:
        Vertices [V, 3] float32 in metres, world frame, and faces [F, 3] int32.

    Raises:
        RenetError: a geom is of a kind that cannot be turned into triangles, or there is none.
    """
    parts, count = [], 0
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for geom in range(model.ngeom):
        body = model.geom_bodyid[geom]
        collides = model.geom_contype[geom] or model.geom_conaffinity[geom]
        mocap = model.body_mocapid[model.body_rootid[body]] >= 0
        if model.body_weldid[body] != 0 or mocap or not collides:
            continue
        vertices, faces = _triangulate(model, geom)
        rotation = data.geom_xmat[geom].reshape(3, 3)
        parts.append((vertices @ rotation.T + data.geom_xpos[geom], faces + count))
        count += len(vertices)
    if not parts:
        raise RenetError("the scene has no terrain: nothing for rays to hit")
    vertices = np.concatenate([p[0] for p in parts]).astype(np.float32)
    return vertices, np.concatenate([p[1] for p in parts]).astype(np.int32)


def _triangulate(model: mujoco.MjModel, geom: int) -> Part:
    """One geom in its own frame."""
    kind, size = mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return BOX_CORNERS * size, BOX_FACES
    if kind == mujoco.mjtGeom.mjGEOM_PLANE:
        half = np.where(size[:2] > 0, size[:2], PLANE_HALF)
        corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half
        return np.pad(corners, ((0, 0), (0, 1))), np.array([(0, 1, 2), (0, 2, 3)])
    if kind == mujoco.mjtGeom.mjGEOM_HFIELD:
        return _height_field(model, int(model.geom_dataid[geom]))
    name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_GEOM, geom) or f"number {geom}"
    raise RenetError(
        f"terrain geom {name} is a {kind.name.removeprefix('mjGEOM_').lower()}: the depth camera "
        "knows planes, boxes and height fields"
    )


def _height_field(model: mujoco.MjModel, field: int) -> Part:
    """Upper surface of a height field, each cell split along MuJoCo's diagonal."""
    rows, columns = model.hfield_nrow[field], model.hfield_ncol[field]
    half_x, half_y, height, _ = model.hfield_size[field]
    start = model.hfield_adr[field]
    elevation = model.hfield_data[start : start + rows * columns] * height
    y, x = np.meshgrid(
        np.linspace(-half_y, half_y, rows), np.linspace(-half_x, half_x, columns), indexing="ij"
    )
    vertices = np.stack((x.ravel(), y.ravel(), elevation), axis=-1)
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    lower = np.stack((corner, corner + 1, corner + columns + 1), axis=-1)
    upper = np.stack((corner, corner + columns + 1, corner + columns), axis=-1)
    return vertices, np.concatenate((lower, upper))
