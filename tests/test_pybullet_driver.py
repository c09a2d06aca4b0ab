"""examples/pybullet_driver.py: a second engine's robot is MuJoCo's, seen and driven alike."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("pybullet", reason="pip install pybullet==3.2.7")

from pybullet_driver import BulletRobot, main
from renet.bundle import Bundle
from renet.deploy.cameras.sim import SimCamera
from renet.deploy.robots.sim.mujoco import MujocoRobot
from renet.deploy.robots.sim.scene import build_scene

SPEC = Bundle.load().manifest


def both(terrain: str = "flat") -> tuple[BulletRobot, MujocoRobot]:
    """The same scene in both engines."""
    model, ground = build_scene(terrain, 5)
    return BulletRobot(model, SPEC.robot, ground), MujocoRobot(model, SPEC.robot, ground)


def place(bullet: BulletRobot, other: MujocoRobot, spin=(0.0, 0.0, 0.0)) -> None:
    """Lean both robots alike, away from the origin, and let them turn (rad/s, base frame)."""
    pose = np.array([1.0, 0.4, other.base_position[2], 0.95, 0.05, 0.1, 0.3])
    pose[3:] /= np.linalg.norm(pose[3:])
    other.data.qpos[:7], other.data.qvel[3:6] = pose, spin
    mujoco.mj_forward(other.model, other.data)
    body, rotation = other.data.body("trunk"), other.base_rotation
    turn = Rotation.from_matrix(body.ximat.reshape(3, 3)).as_quat()
    bullet._engine.resetBasePositionAndOrientation(bullet._body, body.xipos, turn)
    bullet._engine.resetBaseVelocity(bullet._body, (0, 0, 0), rotation @ np.array(spin))


def test_it_has_the_mass_of_mujocos_robot_everywhere():
    """The mass matrix knows every mass, inertia, frame and axis; Bullet has no rotors' inertia."""
    bullet, other = both()
    angles = other.data.qpos[7:]
    mass = np.array(bullet._engine.calculateMassMatrix(bullet._body, list(angles)))
    expected = np.zeros((18, 18))
    mujoco.mj_fullM(other.model, other.data, expected)
    expected[range(18), range(18)] -= other.model.dof_armature
    np.testing.assert_allclose(mass[6:, 6:], expected[6:, 6:], atol=1e-6)
    total = other.model.body_mass.sum()
    np.testing.assert_allclose(mass[3:6, 3:6], total * np.eye(3), atol=1e-6)


def test_it_reads_what_mujocos_robot_reads_and_sees_nothing_of_itself_or_behind():
    bullet, other = both()
    above = np.array([0.0, 0.0, 1.0])
    assert bullet.cast(above, np.array([above, -above])) == pytest.approx([np.inf, 1.0], abs=1e-6)
    place(bullet, other, spin=(0.3, -0.8, 0.5))
    mine, theirs = bullet.read(), other.read()
    for name in ("joint_position", "joint_velocity", "quaternion", "angular_velocity"):
        np.testing.assert_allclose(getattr(mine, name), getattr(theirs, name), atol=1e-6)
    np.testing.assert_allclose(bullet.base_position, other.base_position, atol=1e-6)
    assert mine.time == 0.0


@pytest.mark.parametrize("terrain", ["flat", "stairs", "obstacles"])
def test_its_camera_sees_what_mujocos_sees(terrain):
    bullet, other = both(terrain)
    place(bullet, other)
    mine, theirs = (SimCamera(robot, SPEC.camera).depth() for robot in (bullet, other))
    error = np.abs(mine - theirs)
    # Rays that graze an edge may fall on either side of it.
    assert (error > 2e-3).mean() < 0.003
    assert theirs.min() < 1.0


def test_the_shipped_policy_walks_on_through_a_blackout(tmp_path):
    """Another engine, the same program."""
    out = str(tmp_path / "run")
    options = ["--robot", "pybullet", "--seconds", "8", "--fault", "blackout@4s", "--out", out]
    assert main(["deploy", *options]) == 0
    score = json.loads(Path(out, "score.json").read_text())
    assert (score["falls"], score["states"]) == (0, ["sees", "remembers"])
    assert score["distance_m"] > 2.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--terrain", "rough"], "has no hfield"),
        (["--terrain", "obstacles", "--fault", "glass@1s"], "needs --robot mujoco"),
        (["--viewer"], "use --robot mujoco"),
    ],
)
def test_what_it_cannot_do_is_refused(options, message, tmp_path, capsys):
    assert main(["deploy", "--robot", "pybullet", "--out", str(tmp_path / "o"), *options]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "o").exists()
