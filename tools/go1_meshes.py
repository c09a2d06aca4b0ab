"""Write the Go1's look for the page, `go1.json`, from the visual meshes of mjlab's model.

Run `python tools/go1_meshes.py`. Vertices within a cell become one (Rossignac and Borrel, 1993):
a hundredth of the triangles, which a phone draws and a page loads.
"""

from __future__ import annotations

import base64
import json
from typing import Any

import mujoco
import numpy as np
from mjlab.entity import Entity

from renet.page.writer import WEB
from renet.tasks.config.go1 import GO1 as ROBOT

NOTICE = (
    "Unitree Go1, decimated by tools/go1_meshes.py from mjlab's model (Apache-2.0), itself from "
    "MuJoCo Menagerie's (BSD-3-Clause, Copyright (c) 2016-2022 HangZhou YuShu TECHNOLOGY CO.,LTD. "
    '("Unitree Robotics"), All rights reserved).'
)
CELL = 0.009
"""Side of a cell, m."""
STEP = 1e-4
"""Positions are stored in these steps, m."""


def decimate(vertices: np.ndarray, faces: np.ndarray, cell: float) -> tuple[np.ndarray, np.ndarray]:
    """Merge the vertices of each cell into their mean, and drop the faces that collapse.

    Args:
        vertices: [V, 3] m.
        faces: [F, 3] indices.
        cell: side, m.

    Returns:
        Fewer vertices and faces, in the same format.
    """
    cells = np.floor((vertices - vertices.min(axis=0)) / cell).astype(int)
    _, owner, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    owner = owner.ravel()
    means = np.stack([np.bincount(owner, axis) for axis in vertices.T], axis=1) / count[:, None]
    merged = owner[faces]
    a, b, c = merged.T
    merged = merged[(a != b) & (b != c) & (c != a)]
    _, first = np.unique(np.sort(merged, axis=1), axis=0, return_index=True)
    merged = merged[np.sort(first)]
    used, merged = np.unique(merged, return_inverse=True)
    return means[used], merged.reshape(-1, 3)


def look() -> dict[str, Any]:
    """Meshes by name, and which body wears which where."""
    model = Entity(ROBOT.entity()).spec.compile()
    meshes, geoms = {}, []
    for geom in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH).tolist():
        mesh = model.mesh(model.geom_dataid[geom])
        name, body = mesh.name, model.body(model.geom_bodyid[geom]).name
        geoms.append(
            {
                "body": body,
                "mesh": name,
                "position": model.geom_pos[geom].round(6).tolist(),
                "quaternion": model.geom_quat[geom].round(6).tolist(),
            }
        )
        if name not in meshes:
            first, number = int(mesh.vertadr[0]), int(mesh.vertnum[0])
            start, faces = int(mesh.faceadr[0]), int(mesh.facenum[0])
            vertices = model.mesh_vert[first : first + number]
            triangles = model.mesh_face[start : start + faces]
            meshes[name] = decimate(vertices, triangles, CELL)
    return {
        "notice": NOTICE,
        "step": STEP,
        "meshes": {
            name: {
                "positions": _packed((vertices / STEP).round(), "<i2"),
                "indices": _packed(triangles, "<u2"),
            }
            for name, (vertices, triangles) in meshes.items()
        },
        "geoms": geoms,
    }


def _packed(values: np.ndarray, kind: str) -> str:
    return base64.b64encode(values.astype(kind).tobytes()).decode()


if __name__ == "__main__":
    path = WEB / "go1.json"
    path.write_text(json.dumps(look(), indent=1) + "\n")
    print(path, f"{path.stat().st_size} bytes")
