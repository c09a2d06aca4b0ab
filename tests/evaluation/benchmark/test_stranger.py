"""The stranger has the same shape and density, and other sizes."""

import mujoco
import numpy as np
import pytest

from renet.evaluation.benchmark.stranger import stranger
from renet.interface import JOINTS, LEGS
from renet.robots import GO2
from renet.robots.model import load_robot_model
from renet.tasks import VISUAL_GO1


def built(robot):
    model = load_robot_model(robot).compile()
    data = mujoco.MjData(model)
    for joint in JOINTS:
        data.joint(joint).qpos[0] = {"hip": 0.1, "thigh": 0.7, "calf": -1.5}[joint.split("_")[1]]
    mujoco.mj_forward(model, data)
    return model, data


@pytest.mark.parametrize("robot", [VISUAL_GO1, GO2], ids=lambda robot: robot.name)
def test_every_length_grows(robot):
    model, data = built(robot)
    other, grown = built(stranger(robot, 1.2))
    for leg in LEGS:
        foot = data.site(leg).xpos - data.body("trunk").xpos
        np.testing.assert_allclose(
            grown.site(leg).xpos - grown.body("trunk").xpos, 1.2 * foot, atol=1e-6
        )
    assert other.body_mass.sum() == pytest.approx(1.2**3 * model.body_mass.sum())
    np.testing.assert_allclose(other.body_inertia, 1.2**5 * model.body_inertia, rtol=1e-5)
    feet = [model.geom(f"{leg}_foot_collision").id for leg in LEGS]
    np.testing.assert_allclose(other.geom_size[feet, 0], 1.2 * model.geom_size[feet, 0])


def test_motors_and_gains_stay():
    other = stranger(VISUAL_GO1)
    assert other.motors == VISUAL_GO1.motors
    assert other.stiffness == VISUAL_GO1.stiffness
    assert other.camera.position == pytest.approx([1.1 * x for x in VISUAL_GO1.camera.position])
