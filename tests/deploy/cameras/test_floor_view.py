"""Views of a simulated floor, of steps and walls on it, and of cameras that show something else."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from renet.bundle import Bundle
from renet.deploy.cameras.floor_view import floor_view, view_problem
from renet.deploy.cameras.sim import SimCamera
from renet.deploy.controller import Controller
from renet.deploy.loop import run_control_loop
from renet.deploy.robots.sim.mujoco import MujocoRobot
from renet.deploy.robots.sim.scene import build_scene
from renet.deploy.safety.limits import SafetyCfg
from renet.deploy.teleop.base import TeleopCommand
from renet.robots import find_robot

from ..fakes import robot_on


def standing(bundle: Bundle, terrain: str = "flat", level: int = 5) -> SimCamera:
    """The camera of a robot at its start."""
    spec = bundle.manifest.robot
    model, ground = build_scene(terrain, level, robot=find_robot(spec.name))
    return SimCamera(MujocoRobot(model, spec, ground), bundle.manifest.camera)


def expected(bundle: Bundle) -> np.ndarray:
    return floor_view(bundle.manifest.camera, find_robot(bundle.manifest.robot.name).height)


def found(image: np.ndarray, bundle: Bundle) -> str:
    return view_problem(image, bundle.manifest.camera, bundle.manifest.robot.name)


@pytest.fixture(scope="module", params=["go1-parkour", "go2-parkour"])
def bundle(request) -> Bundle:
    return Bundle.load(request.param)


def test_the_view_is_the_simulated_cameras(bundle):
    seen = standing(bundle).depth() / bundle.manifest.camera.range
    np.testing.assert_allclose(expected(bundle), seen, atol=0.002)


@pytest.mark.parametrize("terrain", ["flat", "rough", "stairs_up", "stairs_down", "obstacles"])
def test_healthy_images_are_believed_on_all_ground(bundle, terrain):
    for level in (1, 5, 10):
        image = standing(bundle, terrain, level).latest().image
        assert found(image, bundle) == "", level


@pytest.mark.parametrize("wall", [0.5, 0.8, 1.5])
def test_a_wall_ahead_is_none_of_the_cameras_business(bundle, wall):
    image = np.minimum(expected(bundle), wall / bundle.manifest.camera.range)
    assert found(image, bundle) == ""


def test_an_image_that_is_upside_down_is_named(bundle):
    image = standing(bundle).latest().image[::-1, ::-1]
    assert "--rotate 180" in found(image, bundle)
    assert view_problem(image, bundle.manifest.camera, "unknown") == "", "its height is unknown"


@pytest.mark.parametrize("scale", [0.25, 0.5, 4.0, 1000.0])
def test_depths_of_another_unit_are_named(bundle, scale):
    """An L515 counts in quarters of a millimetre."""
    image = np.minimum(scale * standing(bundle).latest().image, 1.0)
    assert "check the unit of the depths" in found(image, bundle)


@pytest.mark.parametrize("turn", [1, -1])
def test_the_view_at_rest_is_compared_once_a_robot_has_stood_up(turn):
    robot, events = robot_on(), []
    bundle = Bundle.load()
    camera = SimCamera(robot, bundle.manifest.camera)
    latest = camera.latest

    def turned():
        frame = latest()
        return replace(frame, image=frame.image[::turn, ::turn])

    camera.latest = turned
    controller = Controller(bundle, SafetyCfg(stand_up_seconds=0.5), on_event=events.append)
    hand = SimpleNamespace(command=lambda now: TeleopCommand(arm=now < 0.1))
    run_control_loop(robot, camera, hand, controller, done=lambda: robot.now() > 0.8)
    told = [event.why for event in events if event.what == "camera"]
    assert len(told) == (turn < 0)
    assert all("--rotate 180" in why for why in told)
