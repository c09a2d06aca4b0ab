"""Boxes and triangles of the terrain, which is all static geoms that collide."""

import mujoco
import numpy as np

from renet.errors import RenetError
from renet.sim.native.stages import moving_bodies

PLANE_HALF = 200.0
"""Half-width of the square that replaces an infinite plane, m."""

BOX_CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
BOX_FACES = np.array(
    [
        (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
        (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
    ]
)  # fmt: skip


def terrain_shapes(
    model: mujoco.MjModel, without: frozenset[int] = frozenset()
) -> tuple[np.ndarray, np.ndarray]:
    """Collect the shapes of a model's static geoms that can collide.

    Args:
        model: The scene.
        without: Ids of geoms to leave out.

    Returns:
        Boxes [B, 15] (centre, rotation by rows, half sizes), and corners [T, 3, 3] of the triangles
        of all other geoms, in m in the world frame.

    Raises:
        RenetError: A geom is neither box, plane nor height field, or there is no geom.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    collides = (model.geom_contype | model.geom_conaffinity) != 0
    static = np.flatnonzero(collides & ~moving_bodies(model)[model.geom_bodyid]).tolist()
    geoms = [geom for geom in static if geom not in without]
    if not geoms:
        raise RenetError("the scene has no terrain: nothing for rays to hit")
    boxes = [np.zeros((0, 15))]
    triangles = [np.zeros((0, 3, 3))]
    for geom in geoms:
        rotation = data.geom_xmat[geom].reshape(3, 3)
        position = data.geom_xpos[geom]
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
            box = np.concatenate((position, rotation.ravel(), model.geom_size[geom]))
            boxes.append(box[None])
        else:
            triangles.append(_triangles(model, geom) @ rotation.T + position)
    return np.concatenate(boxes), np.concatenate(triangles)


def box_triangles(boxes: np.ndarray) -> np.ndarray:
    """Compute the corners [12 B, 3, 3] of the triangles of boxes [B, 15] (see `terrain_shapes`)."""
    rotation = boxes[:, 3:12].reshape(-1, 3, 3).transpose(0, 2, 1)
    corners = (BOX_CORNERS * boxes[:, None, 12:]) @ rotation + boxes[:, None, :3]
    return corners[:, BOX_FACES].reshape(-1, 3, 3)


def _triangles(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Compute the corners of a geom's triangles in its own frame, [T, 3, 3] m."""
    kind = mujoco.mjtGeom(model.geom_type[geom])
    if kind == mujoco.mjtGeom.mjGEOM_PLANE:
        corners = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]) * PLANE_HALF
        return corners[[(0, 1, 2), (0, 2, 3)]]
    if kind == mujoco.mjtGeom.mjGEOM_HFIELD:
        return _height_field(model, int(model.geom_dataid[geom]))
    name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_GEOM, geom) or f"number {geom}"
    raise RenetError(
        f"terrain geom {name} is a {kind.name.removeprefix('mjGEOM_').lower()}: the depth camera "
        "knows planes, boxes and height fields"
    )


def _height_field(model: mujoco.MjModel, field: int) -> np.ndarray:
    """Compute the triangles of a height field as MuJoCo's solid, [T, 3, 3] m.

    It consists of cells that are split along a diagonal, of walls around them, and of a box as
    base.
    """
    rows = model.hfield_nrow[field]
    columns = model.hfield_ncol[field]
    half_x, half_y, height, depth = model.hfield_size[field]
    start = model.hfield_adr[field]
    elevation = model.hfield_data[start : start + rows * columns] * height
    y, x = np.meshgrid(
        np.linspace(-half_y, half_y, rows), np.linspace(-half_x, half_x, columns), indexing="ij"
    )
    top = np.stack((x.ravel(), y.ravel(), elevation), axis=-1)
    # The surface: two triangles for each cell, from the numbers of its four nodes.
    node = np.arange(rows * columns).reshape(rows, columns)
    low = node[:-1, :-1].ravel()
    right = node[:-1, 1:].ravel()
    back = node[1:, :-1].ravel()
    far = node[1:, 1:].ravel()
    surface = np.concatenate((np.stack((low, right, far), -1), np.stack((low, far, back), -1)))

    # The walls: from the nodes around the field down to height 0, where they are above it.
    edge = np.concatenate((node[0], node[1:, -1], node[-1, -2::-1], node[-2::-1, 0]))
    foot = top[edge] * (1.0, 1.0, 0.0)
    here = np.arange(len(edge) - 1)
    under = here + len(top)
    walls = np.concatenate(
        (
            np.stack((under, under + 1, edge[here + 1]), -1)[elevation[edge[1:]] > 0.0],
            np.stack((under, edge[here + 1], edge[here]), -1)[elevation[edge[:-1]] > 0.0],
        )
    )
    # The base: a box without its top.
    base = BOX_CORNERS * (half_x, half_y, depth / 2) - (0.0, 0.0, depth / 2)
    box = BOX_FACES[(base[BOX_FACES, 2] < 0.0).any(-1)]
    faces = np.concatenate((surface, walls))
    return np.concatenate((np.concatenate((top, foot))[faces], base[box]))
