"""A walking robot whose sensors or motors fail, and the controller that watches it."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from renet.bundle import Bundle
from renet.deploy.controller import Controller
from renet.deploy.loop import run_control_loop
from renet.deploy.robots.base import JointCommand, RobotState
from renet.deploy.safety.limits import SafetyCfg
from renet.deploy.safety.machine import ENDED
from renet.deploy.teleop import TeleopCommand

from ..fakes import robot_on

FAILS = 2.0
"""Time at which something fails, s; the robot walks since 0.5 s."""


def walk(
    read: Callable[[RobotState], RobotState] = lambda state: state,
    write: Callable[[JointCommand], JointCommand] = lambda command: command,
    **limits: float,
) -> tuple[float, str]:
    """When a walking robot is braked, s, and why, with readings or commands that are spoilt."""
    robot, events = robot_on(), []
    robot_read, robot_write = robot.read, robot.write

    def failing_read() -> RobotState:
        return read(robot_read()) if robot.now() > FAILS else robot_read()

    def failing_write(command: JointCommand) -> None:
        robot_write(write(command) if robot.now() > FAILS else command)

    robot.read, robot.write = failing_read, failing_write
    safety = SafetyCfg(stand_up_seconds=0.5, **limits)
    controller = Controller(Bundle.load(), safety, on_event=events.append)
    hand = SimpleNamespace(command=lambda now: TeleopCommand(0.6 * (now > 1.0), arm=now < 0.5))
    run_control_loop(robot, None, hand, controller, done=lambda: robot.now() > FAILS + 2.0)
    return next((e.time, e.why) for e in events if e.what == "damping")


def without(joint: int) -> Callable[[JointCommand], JointCommand]:
    """Commands that one motor does not obey."""
    share = np.ones(12)
    share[joint] = 0.0
    return lambda command: JointCommand(
        command.position, share * command.stiffness, share * command.damping
    )


def test_a_healthy_robot_walks_to_the_end():
    assert walk()[1] == ENDED


@pytest.mark.parametrize(
    ("joint", "name"), [(1, "FR_thigh_joint"), (8, "RR_calf_joint"), (11, "RL_calf_joint")]
)
def test_a_dead_motor_brakes_within_half_a_second(joint, name):
    time, why = walk(write=without(joint))
    # A calf that is stretched just then is told by the torque that it reports.
    assert why.startswith(f"{name} does not obey: it")
    assert time - FAILS < 0.5


def test_a_robot_that_is_not_to_follow_is_not_watched():
    """As in a dry run."""
    assert "obey" not in walk(write=without(1), least_torque=0.0)[1]


def test_a_frozen_gyroscope_brakes_although_the_attitude_lives():
    time, why = walk(lambda state: replace(state, angular_velocity=np.array([0.1, 0.0, 0.0])))
    assert why == "frozen: 6 readings of the gyroscope are the same"
    assert time - FAILS < 0.2


def test_speeds_that_are_all_zero_brake_whatever_their_sign():
    time, why = walk(lambda state: replace(state, joint_velocity=-0.0 * state.joint_velocity))
    assert why == "frozen: 6 readings of the joints' speeds are the same"
    assert time - FAILS < 0.2
