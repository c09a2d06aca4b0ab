"""Parts that fail and are mended, and the driver through which everything may go wrong."""

from dataclasses import fields
from math import inf

import numpy as np
import pytest

from disturbances import LASTS, Body, Failure, Means, ShakyCamera, ShakyRobot
from hardware_faults import Fault
from renet.bundle import Bundle
from renet.deploy.robots.base import JointCommand
from renet.deploy.robots.sim.scene import build_scene
from renet.errors import RenetError
from renet.interface import CONTROL_DT
from renet.training.export import robot_spec
from vendor_go1 import COLD

STANDING = np.array(robot_spec().default_position)
HOLD = JointCommand(STANDING, np.full(12, 40.0), np.ones(12))
NEVER = dict.fromkeys((field.name for field in fields(Means)), inf)
AT_ONCE = CONTROL_DT / 2
"""Mean time of what happens in every control step."""


def body_on_flat() -> Body:
    model, ground = build_scene("flat", 1)
    return Body(1, model, robot_spec(), ground)


def robot_with(**means: float) -> ShakyRobot:
    """A connected robot to which only the named things happen."""
    robot = ShakyRobot(1, body_on_flat(), Means(**(NEVER | means)), lambda command: None)
    robot.connect()
    return robot


def hold(robot: ShakyRobot, seconds: float) -> list:
    """Readings of a robot that holds its pose."""
    readings = []
    end = robot.now() + seconds
    while robot.now() < end:
        robot.write(HOLD)
        robot.wait(robot.now() + CONTROL_DT)
        readings.append(robot.read())
    return readings


@pytest.mark.parametrize("kind", ["freezes", "sticks"])
def test_a_mended_motor_moves_as_freely_as_before(kind):
    body = body_on_flat()
    friction = body.model.dof_frictionloss.copy()
    body.fail(Fault("motor", kind, 4, 0.0, 1.0))
    body.write(HOLD)
    body.wait(0.1)
    assert (body.model.dof_frictionloss != friction).sum() == 1
    body.mend()
    np.testing.assert_array_equal(body.model.dof_frictionloss, friction)


def test_a_mended_encoder_tells_the_truth_again():
    body = body_on_flat()
    for _ in range(2):
        body.fail(Fault("encoder", "freezes", 4, body.now(), 1.0))
        body.write(HOLD)
        frozen = body.read().joint_position[4]
        body.wait(body.now() + 0.1)
        assert body.read().joint_position[4] == frozen
        assert body.data.qpos[body._position][4] != frozen
        body.mend()
        assert body.read().joint_position[4] == body.data.qpos[body._position][4]


def test_a_robot_to_which_nothing_happens_holds_its_pose():
    robot = robot_with()
    readings = hold(robot, 1.0)
    assert robot.given == []
    assert robot.link.problem == ""
    times = np.diff([reading.time for reading in readings])
    np.testing.assert_allclose(times, CONTROL_DT)
    assert readings[-1].time == robot.now()
    assert np.abs(readings[-1].joint_position - STANDING).max() < 0.3


def test_what_happens_is_what_was_asked_for():
    assert hold(robot_with(reading_lost=AT_ONCE), 0.1) == [None] * 5
    lost = hold(robot_with(reading_not_finite=AT_ONCE), 0.1)
    assert all(np.isnan(reading.joint_velocity).all() for reading in lost)
    late = hold(robot_with(control_step_late=AT_ONCE), 1.0)
    assert len(late) < 40
    hot = robot_with(heat=0.5)
    assert hold(hot, 2.0)[-1].temperature.max() > COLD
    hot.repair()
    assert hot.wire.temperature.max() > COLD, "motors take their time to cool"
    assert hold(robot_with(battery=0.5), 5.0)[-1].battery < 0.95
    broken = robot_with(vendor_driver_fails=AT_ONCE)
    with pytest.raises(RenetError, match="the robot's driver failed: OSError"):
        hold(broken, 1.0)


def test_a_part_fails_until_it_recovers_and_what_was_told_is_kept():
    robot = robot_with(hardware=AT_ONCE)
    robot.wait(robot.now() + CONTROL_DT)
    (failure,) = robot.failures
    assert robot.body.fault is failure.fault
    assert failure.outcome == "not told"
    robot.wait(robot.now() + 0.3)
    robot.alarm("the gyroscope is frozen")
    robot.alarm("later")
    assert failure.why == "the gyroscope is frozen"
    assert failure.outcome == "told soon"
    robot.wait(robot.now() + LASTS)
    robot.wait(robot.now() + CONTROL_DT)
    assert robot.body.fault is None


@pytest.mark.parametrize(
    ("braked", "why", "outcome"),
    [
        (None, "", "not told"),
        (0.5, "FR_hip_joint is frozen", "told soon"),
        (0.6, "FR_hip_joint is frozen", "told later"),
        (0.2, "operator stop", "fell"),
        (0.2, "the state is 60 ms old", "braked for another reason"),
        (
            0.2,
            "the robot lies down: a motor is hot",
            "braked for another reason",
        ),
    ],
)
def test_outcomes(braked, why, outcome):
    fault = Fault("motor", "dies", 0, 3.0, 1.0)
    assert Failure(fault, True, braked, why).outcome == outcome


def test_a_camera_shows_faults_stalls_and_fails():
    robot = robot_with(camera_driver_fails=1.0)
    camera = ShakyCamera(robot, Bundle.load())
    camera.start()
    seen = 0
    failed = 0
    for _ in range(100):
        try:
            seen += camera.latest() is not None
        except OSError:
            failed += 1
        robot.wait(robot.now() + CONTROL_DT)
    assert seen + failed == 100
    assert seen > 50
    assert failed == sum(what == "camera_driver_fails" for _, what in robot.given) > 0
