"""Descriptions of robots: they agree with their makers' files, and mistakes are named."""

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from mjlab.asset_zoo.robots.unitree_go1 import go1_constants as mjlab_go1

from renet.errors import RenetError
from renet.interface import JOINTS
from renet.robots import GO1, GO2, Motor, find_robot, register_robot, robots
from renet.robots import robot as module


def test_the_go1_is_mjlabs():
    assert GO1.height == mjlab_go1.INIT_STATE.pos[2]
    assert GO1.pose == mjlab_go1.INIT_STATE.joint_pos
    for kind, motor in (("hip", mjlab_go1.HIP_ACTUATOR), ("calf", mjlab_go1.KNEE_ACTUATOR)):
        theirs = Motor(motor.effort_limit, motor.velocity_limit, motor.reflected_inertia)
        assert GO1.motors[kind] == theirs
    assert GO1.motors["thigh"] == GO1.motors["hip"]
    spec = mjlab_go1.get_spec()
    model = spec.compile()
    for joint, lower, upper in zip(JOINTS, GO1.lower, GO1.upper, strict=True):
        assert tuple(model.joint(joint).range) == (lower, upper)
    assert model.geom("FL_foot_collision").size[0] == GO1.foot_radius


@pytest.mark.parametrize("robot", [GO1, GO2], ids=lambda robot: robot.name)
def test_the_file_says_the_same(robot):
    """It is read by other programs, too."""
    model = mujoco.MjModel.from_xml_path(str(robot.mjcf))
    for number, joint in enumerate(JOINTS):
        assert tuple(model.joint(joint).range) == (robot.lower[number], robot.upper[number])
        assert model.actuator(joint).forcerange[1] == robot.torque[number]
    assert model.geom("FL_foot_collision").size[0] == robot.foot_radius


def test_values_follow_the_joints():
    assert GO2.lower[JOINTS.index("FL_thigh_joint")] == -1.5708
    assert GO2.upper[JOINTS.index("RL_thigh_joint")] == 4.5379
    np.testing.assert_array_equal(GO1.default_position[:6], (0.1, 0.9, -1.8, -0.1, 0.9, -1.8))
    np.testing.assert_array_equal(GO1.velocity[3:6], (30.1, 30.1, 20.06))


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"motors": {"hip": GO1.motors["hip"]}}, "motors must be of hip, thigh, calf, not hip"),
        ({"pose": {".*_hip_joint": 0.0}}, "pose must have one value for FR_thigh_joint, it has 0"),
        (
            {"pose": {**GO1.pose, "RL_.*": 0.0}},
            "pose must have one value for RL_hip_joint, it has 2",
        ),
        (
            {"limits": {".*": (-1.0, 1.0)}},
            "the pose of FR_calf_joint is -1.8 rad, which must be within its limits, -1 to 1 rad",
        ),
        ({"limits": {".*": (-math.inf, math.nan)}}, "the pose of FR_hip_joint"),
        ({"height": 0.0}, "the height of the robot Unitree Go1 must be above 0, got 0"),
        ({"foot_radius": math.nan}, "the foot_radius of the robot .* must be above 0, got nan"),
        (
            {"motors": {**GO1.motors, "calf": Motor(torque=-35.0, velocity=20.0)}},
            "the torque of the calf motors must be above 0, got -35",
        ),
        (
            {"motors": {**GO1.motors, "hip": Motor(torque=23.7, velocity=0.0)}},
            "the velocity of the hip motors must be above 0, got 0",
        ),
        ({"mjcf": None}, "Unitree Go1 has no model: give its `mjcf` or its `spec`"),
    ],
)
def test_mistakes_are_named(changes, problem):
    with pytest.raises(RenetError, match=problem):
        replace(GO1, **changes)


def test_a_motor_without_a_limit_of_its_velocity():
    motors = dict.fromkeys(GO1.motors, Motor(torque=20.0, velocity=math.inf))
    assert np.isinf(replace(GO1, motors=motors).velocity).all()


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"stiffness": 120.0}, "the stiffness of .* is 120, .* at most max_stiffness, 100"),
        ({"max_damping": 0.5}, "the damping of .* is 1, .* at most max_damping, 0.5"),
    ],
)
def test_gains_that_no_driver_sends_are_refused(monkeypatch, changes, problem):
    monkeypatch.setattr(module, "_ROBOTS", dict(module._ROBOTS))
    with pytest.raises(RenetError, match=problem):
        register_robot(replace(GO1, name="Spot", **changes))
    assert "Spot" not in robots()


def test_robots_are_found_by_name(monkeypatch):
    monkeypatch.setattr(module, "_ROBOTS", dict(module._ROBOTS))
    spot = register_robot(replace(GO1, name="Spot"))
    assert find_robot("Spot") is spot is robots()["Spot"]
    with pytest.raises(RenetError, match="drives a Rex, which has no description here: there is"):
        find_robot("Rex")
