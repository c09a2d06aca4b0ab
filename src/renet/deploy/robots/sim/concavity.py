"""Check of meshes for hollows, which MuJoCo's contacts fill and a camera's rays do not."""

import mujoco
import numpy as np

from renet.errors import RenetError

ON_HULL = 1e-3
"""Distance from the hull, in sizes of the mesh, within which a face of the mesh lies on it."""
HOLLOW = 0.03
"""Depth of the deepest hollow that a mesh may have, m: steps are higher."""
RAYS = 48
"""Number of rays along each edge of a mesh's bounding box, from each of its six sides."""


def demand_convex(model: mujoco.MjModel) -> None:
    """Raise RenetError if a static mesh has a hollow that contacts fill.

    A robot would walk on the convex hull, on air, while its camera sees the hollow.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for geom in range(model.ngeom):
        if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_MESH:
            continue
        # Only the ground counts, and of it what a robot can touch.
        static = model.body_weldid[model.geom_bodyid[geom]] == 0
        if not static or not model.geom_contype[geom] & 1:
            continue
        depth = hollow(model, data, geom)
        if depth > HOLLOW:
            name = model.mesh(model.geom_dataid[geom]).name.removeprefix("scene/")
            raise RenetError(
                f"its mesh {name!r} has a hollow of {depth:.2f} m, which MuJoCo's contacts fill, "
                "as they know only a mesh's convex hull: split it into convex parts (for example "
                "with the package coacd), or build the ground from boxes or a height field"
            )


def hollow(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> float:
    """Return the depth of the deepest hollow of a mesh seen from its six sides, m.

    Along each ray, the mesh's surface is compared with that of its convex hull.
    """
    mesh = model.geom_dataid[geom]
    if is_hull(model, mesh):
        return 0.0
    normals, offsets = planes(hull_corners(model, mesh))
    rotation = data.geom_xmat[geom].reshape(3, 3)
    middle = data.geom_xpos[geom]
    vertices = mesh_vertices(model, mesh)
    low = vertices.min(axis=0)
    high = vertices.max(axis=0)
    deepest = 0.0
    for axis in range(3):
        for way in (1.0, -1.0):
            for start, ray in side_rays(low, high, axis, way):
                eye = middle + rotation @ start
                on_mesh = mujoco.mj_rayMesh(model, data, geom, eye, rotation @ ray, None)
                if on_mesh >= 0.0:
                    deepest = max(deepest, on_mesh - enters(normals, offsets, start, ray))
    return deepest


def side_rays(
    low: np.ndarray, high: np.ndarray, axis: int, way: float
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return starts and directions of parallel rays through a box [low, high] from outside."""
    ray = np.zeros(3)
    ray[axis] = way
    first, second = (other for other in range(3) if other != axis)
    # Rays along the very edges might miss.
    margin = 1e-4 * (high - low)
    across = np.linspace(low[first] + margin[first], high[first] - margin[first], RAYS)
    along = np.linspace(low[second] + margin[second], high[second] - margin[second], RAYS)
    rays = []
    for a in across:
        for b in along:
            start = np.empty(3)
            start[axis] = low[axis] - 1.0 if way > 0.0 else high[axis] + 1.0
            start[first] = a
            start[second] = b
            rays.append((start, ray))
    return rays


def enters(normals: np.ndarray, offsets: np.ndarray, start: np.ndarray, ray: np.ndarray) -> float:
    """Return the distance after which a ray from outside is inside of all planes, m."""
    rates = normals @ ray
    distances = (offsets - normals @ start) / np.where(rates == 0.0, np.inf, rates)
    return float(np.max(distances, where=rates < 0.0, initial=0.0))


def mesh_vertices(model: mujoco.MjModel, mesh: int) -> np.ndarray:
    """Vertices of a mesh in its geom's frame, [V, 3] m."""
    first = model.mesh_vertadr[mesh]
    return model.mesh_vert[first : first + model.mesh_vertnum[mesh]].astype(float)


def is_hull(model: mujoco.MjModel, mesh: int) -> bool:
    """Return True if the faces of a mesh are those of its convex hull: it has no hollow."""
    faces = mesh_corners(model, mesh)
    hull = hull_corners(model, mesh)
    normals, offsets = planes(hull)
    size = np.ptp(faces.reshape(-1, 3), axis=0).max()
    # A face lies on the hull if its middle does, and the hull is covered if areas agree.
    depth = (offsets - faces.mean(axis=1) @ normals.T).min(axis=1)
    on_hull = np.all(np.abs(depth) < ON_HULL * size)
    return bool(on_hull) and area(faces) > 0.99 * area(hull)


def mesh_corners(model: mujoco.MjModel, mesh: int) -> np.ndarray:
    """Corners of the faces of a mesh in its geom's frame, [F, 3, 3] m."""
    first = model.mesh_faceadr[mesh]
    faces = model.mesh_face[first : first + model.mesh_facenum[mesh]]
    return mesh_vertices(model, mesh)[faces]


def hull_corners(model: mujoco.MjModel, mesh: int) -> np.ndarray:
    """Corners of the faces of a mesh's convex hull in its geom's frame, [F, 3, 3] m."""
    # MuJoCo's description of `mesh_graph`: numbers of vertices and faces, two numbers for each
    # vertex, a table of edges, and last three vertices of the mesh for each face.
    graph = model.mesh_graph[model.mesh_graphadr[mesh] :]
    vertices = int(graph[0])
    faces = int(graph[1])
    first = 2 + 3 * vertices + 3 * faces
    corners = graph[first : first + 3 * faces].reshape(faces, 3)
    return mesh_vertices(model, mesh)[corners]


def planes(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Planes of the faces of a convex body: outward normals [F, 3] and offsets [F], m."""
    a, b, c = corners.swapaxes(0, 1)
    normals = np.cross(b - a, c - a)
    sizes = np.linalg.norm(normals, axis=1)
    # Slivers have no direction.
    kept = sizes > 1e-12
    normals = normals[kept] / sizes[kept, None]
    offsets = np.einsum("ij,ij->i", normals, a[kept])
    # The order of the corners does not say which side is outside.
    inside = corners.reshape(-1, 3).mean(axis=0)
    flip = np.where(normals @ inside > offsets, -1.0, 1.0)
    return normals * flip[:, None], offsets * flip


def area(corners: np.ndarray) -> float:
    """Area of triangles [F, 3, 3] m, m^2."""
    a, b, c = corners.swapaxes(0, 1)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)
