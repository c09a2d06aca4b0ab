"""Grounds from files: what a robot touches is what its camera sees."""

import mujoco
import numpy as np
import pytest

from renet.deploy.robots.sim import scene_file
from renet.deploy.robots.sim.concavity import hollow
from renet.deploy.robots.sim.mujoco import SEEN_GROUPS
from renet.deploy.robots.sim.scene import build_scene
from renet.errors import RenetError

PLANE = '<geom type="plane" size="0 0 .1"/>'
# Side views of grounds, (x, z) m, extruded across.
PIT = [(-2, 0), (1.5, 0), (1.5, -0.6), (3, -0.6), (3, 0), (8, 0), (8, -0.8), (-2, -0.8)]
SLAB = [(-2, 0), (8, 0), (8, -0.8), (-2, -0.8)]
GROOVE = [(-2, 0), (2.99, 0), (3, -0.02), (3.01, 0), (8, 0), (8, -0.8), (-2, -0.8)]
STEP = [(-2, 0), (3, 0), (3, 0.2), (8, 0.2), (8, -0.8), (-2, -0.8)]


def extruded(profile, closed=True) -> dict:
    """Vertices and faces of a mesh 3 m wide; open, without the sides that one cannot stand on."""
    count = len(profile)
    vertices = [(x, y, z) for y in (-1.5, 1.5) for x, z in profile]
    faces = []
    for here in range(count):
        there = (here + 1) % count
        faces += [(here, there, there + count), (here, there + count, here + count)]
    if closed:
        # A fan covers profiles whose last corner sees all others.
        for first, way in ((0, 1), (count, -1)):
            for corner in range(count - 2):
                face = (count - 1, corner, corner + 1)
                faces.append(tuple(first + c for c in face[::way]))
    return {"uservert": np.ravel(vertices), "userface": np.ravel(faces)}


def mesh_scene(tmp_path, mesh):
    """The file of a scene that is one mesh."""
    vertices = mesh["uservert"].reshape(-1, 3)
    faces = mesh["userface"].reshape(-1, 3) + 1
    lines = [f"v {x} {y} {z}" for x, y, z in vertices] + [f"f {a} {b} {c}" for a, b, c in faces]
    (tmp_path / "ground.obj").write_text("\n".join(lines) + "\n")
    asset = '<asset><mesh name="ground" file="ground.obj" inertia="shell"/></asset>'
    return scene(tmp_path, '<geom type="mesh" mesh="ground"/>', asset)


def scene(tmp_path, body, asset=""):
    file = tmp_path / "scene.xml"
    file.write_text(f"<mujoco>{asset}<worldbody>{body}</worldbody></mujoco>")
    return file


def test_a_file_of_another_kind_is_refused_without_a_trial(tmp_path, monkeypatch):
    monkeypatch.setattr(scene_file, "run_trial", lambda *arguments: pytest.fail("a trial"))
    file = scene(tmp_path, PLANE).rename(tmp_path / "scene.usd")
    with pytest.raises(RenetError, match=r"scene\.usd is no MJCF: give an \.xml file"):
        build_scene(file=file)


def test_a_pit_in_one_mesh_is_refused(tmp_path):
    with pytest.raises(RenetError, match=r"mesh 'ground' has a hollow of 0\.60 m.*convex parts"):
        build_scene(file=mesh_scene(tmp_path, extruded(PIT, closed=False)))


def test_a_step_in_one_mesh_is_refused(tmp_path):
    with pytest.raises(RenetError, match="mesh 'ground' has a hollow of"):
        build_scene(file=mesh_scene(tmp_path, extruded(STEP)))


@pytest.mark.parametrize("profile", [SLAB, GROOVE], ids=["slab", "groove"])
def test_a_mesh_without_hollows_that_matter_carries_a_robot(tmp_path, profile):
    _, ground = build_scene(file=mesh_scene(tmp_path, extruded(profile)))
    assert ground == pytest.approx(0.0, abs=1e-6)


def test_a_convex_mesh_has_no_hollow_however_it_is_turned():
    spec = mujoco.MjSpec()
    corners = np.random.default_rng(0).normal(size=(40, 3))
    spec.add_mesh(name="stone", uservert=corners.ravel())
    kind = mujoco.mjtGeom.mjGEOM_MESH
    spec.worldbody.add_geom(type=kind, meshname="stone", quat=(0.5, 0.5, 0.1, 0.2))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    assert hollow(model, data, 0) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("look", "touched"),
    [
        ('group="3"', True),
        ('rgba="1 1 1 0"', True),
        ('contype="0" conaffinity="0"', False),
        ('contype="2" conaffinity="1"', False),
    ],
    ids=["hidden group", "invisible", "ghost", "of another bit"],
)
def test_what_is_touched_is_seen(tmp_path, look, touched):
    body = f'{PLANE}<geom type="box" pos="2.5 0 .15" size="1 2 .15" {look}/>'
    model, _ = build_scene(file=scene(tmp_path, body))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    eye, ahead, geom = np.array((0.5, 0.0, 0.1)), np.array((1.0, 0.0, 0.0)), np.zeros(1, np.int32)
    distance = mujoco.mj_ray(model, data, eye, ahead, SEEN_GROUPS, 1, -1, geom)
    assert distance == pytest.approx(1.0 if touched else -1.0)
