"""The feet's places and speeds against MuJoCo's."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from renet.deploy.robots.sim.scene import build_scene
from renet.deploy.watch.legs import Legs
from renet.errors import RenetError
from renet.interface import JOINTS, LEGS, TRUNK
from renet.robots import GO1, GO2


@pytest.mark.parametrize("robot", [GO1, GO2], ids=lambda robot: robot.name)
def test_feet_are_where_mujoco_says_and_as_fast(robot):
    model, _ = build_scene("flat", 1, robot=robot)
    data, random = mujoco.MjData(model), np.random.default_rng(3)
    legs = Legs(robot)
    for _ in range(20):
        lower, upper = model.jnt_range[[model.joint(name).id for name in JOINTS]].T
        angles, speeds = random.uniform(lower, upper), random.uniform(-5, 5, 12)
        for name, angle, speed in zip(JOINTS, angles, speeds, strict=True):
            data.joint(name).qpos[0], data.joint(name).qvel[0] = angle, speed
        mujoco.mj_forward(model, data)
        places, motions = legs.feet(angles, speeds)
        trunk = data.body(TRUNK)
        for leg, place, motion in zip(LEGS, places, motions, strict=True):
            site = data.site(leg)
            turn = trunk.xmat.reshape(3, 3)
            np.testing.assert_allclose(place, turn.T @ (site.xpos - trunk.xpos), atol=1e-9)
            velocity = np.zeros(6)
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, site.id, velocity, 0)
            np.testing.assert_allclose(motion, turn.T @ velocity[3:], atol=1e-9)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (('axis="1 0 0"', 'axis="0 0 1"'), "are not those of a hip, a thigh and a calf"),
        (('site name="FR"', 'site name="toe"'), "has no site named 'FR'"),
    ],
)
def test_other_legs_are_refused(tmp_path, change, reason):
    file = tmp_path / "robot.xml"
    file.write_text(GO1.mjcf.read_text().replace(*change))
    with pytest.raises(RenetError, match=reason):
        Legs(replace(GO1, mjcf=file))
