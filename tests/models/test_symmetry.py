"""The mirror image of a robot, against physics."""

import mujoco
import numpy as np
import pytest
import torch
from tests.deploy.fakes import STANDING, command, robot_on

from renet.deploy.observation import observe
from renet.deploy.robots.sim.mujoco import MujocoRobot
from renet.interface import PROPRIOCEPTION_SIZE
from renet.models.symmetry import Mirror
from renet.training.export import robot_spec

MIRROR = Mirror("cpu")
SPEC = robot_spec()
SIDE = np.array([1.0, -1.0, 1.0])
"""Reflection of a vector at the plane through x and z."""


def mirrored(values: np.ndarray, what: str) -> np.ndarray:
    tensor = torch.tensor(values, dtype=torch.float32)
    return getattr(MIRROR, what)(tensor).numpy()


def throw(random: np.random.Generator) -> tuple[MujocoRobot, MujocoRobot]:
    """Two robots in the air: one turned and thrown at random, and its mirror image.

    The second is placed without `Mirror`: a rotation by an angle about an axis becomes, behind the
    plane, the rotation by the opposite angle about the reflected axis.
    """
    robots = robot_on(), robot_on()
    axis, angle = random.normal(size=3), random.uniform(-0.6, 0.6)
    velocity, spin = random.normal(size=(2, 3))
    for robot, side, sense in zip(robots, (np.ones(3), SIDE), (1.0, -1.0), strict=True):
        quaternion = np.empty(4)
        mujoco.mju_axisAngle2Quat(quaternion, side * axis / np.linalg.norm(axis), sense * angle)
        base = robot.data.joint(0)
        base.qpos[2] += 0.3
        base.qpos[3:] = quaternion
        base.qvel[:] = *(side * velocity), *(sense * side * spin)
    return robots


@pytest.mark.parametrize("seed", range(5))
def test_a_mirrored_robot_obeys_mirrored_actions(seed):
    random = np.random.default_rng(seed)
    robots = throw(random)
    action = random.uniform(-1.0, 1.0, 12)
    actions = action, mirrored(action, "action")
    twist = random.normal(size=3)
    # The command of a robot that is to go to the left, told to one that is to go to the right.
    twists = twist, twist * [1.0, -1.0, -1.0]

    observations = []
    for robot, wanted, told in zip(robots, actions, twists, strict=True):
        robot.write(command(STANDING + 0.5 * wanted))
        # It turns in the air, and lands on some of its legs.
        robot.wait(0.4)
        observations.append(observe(robot.read(), SPEC, told, wanted))

    real, image = observations
    # The Go1's masses are not quite symmetric.
    apart = np.abs(mirrored(real, "proprioception") - image).max()
    assert apart < 0.1 * np.abs(real - image).max()


def test_the_mirror_image_of_a_mirror_image_is_the_robot():
    random = torch.Generator().manual_seed(0)
    for what, shape in (
        ("proprioception", (4, PROPRIOCEPTION_SIZE)),
        ("action", (3, 2, 12)),
        ("image", (2, 48, 64)),
    ):
        values = torch.rand(shape, generator=random)
        mirror = getattr(MIRROR, what)
        assert torch.equal(mirror(mirror(values)), values)
        assert not torch.equal(mirror(values), values)
