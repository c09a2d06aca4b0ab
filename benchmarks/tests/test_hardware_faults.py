"""What becomes of a robot one of whose parts fails, judged and simulated."""

import numpy as np
import pytest

from hardware_faults import (
    HARMLESS,
    KINDS,
    PARTS,
    Cfg,
    FailingRobot,
    Fault,
    draw,
    harm,
    judge,
    walk,
)
from renet.deploy.robots.base import JointCommand
from renet.deploy.robots.sim.scene import build_scene
from renet.interface import CONTROL_DT
from renet.training.export import robot_spec

HOLD = np.full(12, 40.0), np.full(12, 1.0)


def failing(part: str, kind: str, joint: int = 4, size: float = 1.0) -> FailingRobot:
    """A robot that stands, and of which a part fails after a second."""
    spec = robot_spec()
    model, ground = build_scene("flat", 1)
    robot = FailingRobot(Fault(part, kind, joint, 1.0, size), 1, model, spec, ground)
    robot.write(JointCommand(np.asarray(spec.default_position), *HOLD))
    robot.wait(1.0)
    return robot


def readings(robot: FailingRobot, steps: int = 20) -> list:
    """Of a robot whose targets swing."""
    found = []
    for step in range(steps):
        swing = np.asarray(robot_spec().default_position) + 0.1 * np.sin(0.5 * step)
        robot.write(JointCommand(swing, *HOLD))
        robot.wait(robot.now() + CONTROL_DT)
        found.append(robot.read())
    return found


@pytest.mark.parametrize(
    ("part", "name", "rows"),
    [
        ("encoder", "joint_position", [4]),
        ("encoders", "joint_position", range(12)),
        ("gyroscope", "angular_velocity", range(3)),
        ("attitude", "quaternion", range(4)),
    ],
)
def test_a_sensor_that_freezes_says_the_same_and_the_others_live(part, name, rows):
    values = np.array([getattr(one, name) for one in readings(failing(part, "freezes"))])
    still = (values == values[0]).all(axis=0)
    assert still.tolist() == [row in rows for row in range(values.shape[1])]


def test_a_servo_acts_on_its_own_encoder():
    """One that says too much turns its joint as far the other way."""
    robot = failing("encoder", "drifts", size=0.5)
    last = readings(robot)[-1]
    true = robot.data.qpos[robot._position]
    drifted = 0.5 * (robot.now() - 1.0)
    assert last.joint_position[4] - true[4] == pytest.approx(drifted, abs=0.01)
    assert last.joint_position[1] == true[1]
    assert true[4] < 0.9


@pytest.mark.parametrize(("kind", "least", "most"), [("dies", 0.0, 0.0), ("drifts", 0.0, 9.0)])
def test_a_motor_that_fails_gives_less_torque(kind, least, most):
    torques = np.array([one.joint_torque for one in readings(failing("motor", kind, joint=5), 60)])
    assert least <= np.abs(torques[-5:, 5]).max() <= most
    assert np.abs(torques[:, 2]).max() > 5.0, "the others work"


def test_faults_are_drawn_alike_and_of_all_kinds():
    drawn = [draw(seed) for seed in range(300)]
    assert drawn == [draw(seed) for seed in range(300)]
    assert {(one.part, one.kind) for one in drawn} == {(p, k) for p in PARTS for k in KINDS}


@pytest.mark.parametrize(
    ("told", "harmed", "verdict"),
    [
        (2.9, None, "false alarm"),
        (2.9, 3.2, "false alarm"),
        (3.0, None, "told soon"),
        (3.4, None, "told soon"),
        (3.5, 3.2, "told soon"),
        (3.6, None, "told later, no harm"),
        (None, None, "harmless"),
        (3.6, 3.7, "told before harm"),
        (3.7, 3.6, "harm"),
        (None, 5.0, "harm"),
    ],
)
def test_verdicts(told, harmed, verdict):
    fault = Fault("motor", "dies", 0, 3.0, 1.0)
    assert judge(fault, {"told": told, "harm": harmed}) == verdict


def test_harm_is_a_fall_or_a_second_of_going_where_nobody_told():
    path = np.zeros((300, 6))
    path[:, 0] = CONTROL_DT * np.arange(300)
    path[:, 1] = 1.0
    path[:, 2] = path[:, 4] = 0.6
    assert harm(path, 1.0, 9.0) is None
    fell, ran, turned = path.copy(), path.copy(), path.copy()
    fell[200:, 1] = 0.4
    ran[100:, 2] = 1.8
    turned[100:110, 3] = 3.0
    assert harm(fell, 1.0, 9.0) == 4.0
    assert harm(ran, 1.0, 9.0) == pytest.approx(2.66, abs=0.03)
    assert harm(turned, 1.0, 9.0) is None, "a twitch is none"
    assert harm(fell, 1.0, 3.9) is None, "later harm does not count"


def test_a_braked_robot_is_observed_until_five_seconds_after_its_fault():
    fault = Fault("attitude", "freezes", 0, 2.5, 1.0)
    outcome = walk(Cfg(), fault, 1, "flat", fault.time + HARMLESS)
    assert outcome["told"] == pytest.approx(fault.time + 0.1, abs=0.03)
    # It stands braked, or fell as it was: either is seen.
    assert outcome["seconds"] > fault.time + HARMLESS or outcome["harm"] > outcome["told"]
