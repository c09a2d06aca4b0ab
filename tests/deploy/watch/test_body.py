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
from renet.deploy.teleop.base import TeleopCommand
from renet.interface import JOINTS

from ..fakes import robot_on

FAILS = 2.0
"""Time at which something fails, s; the robot walks since 0.5 s."""


def walk(
    read: Callable[[RobotState], RobotState] = lambda state: state,
    write: Callable[[JointCommand], JointCommand] = lambda command: command,
    block: int | None = None,
    told: str = "damping",
    **limits: float,
) -> tuple[float, str]:
    """When something is told of a walking robot, s, and what, with readings or commands that are
    spoilt, or with a joint in which more friction begins than its motor overcomes."""
    robot, events = robot_on(), []
    robot_read, robot_write = robot.read, robot.write

    def failing_read() -> RobotState:
        return read(robot_read()) if robot.now() > FAILS else robot_read()

    def failing_write(command: JointCommand) -> None:
        if block is not None and robot.now() > FAILS:
            robot.model.joint(JOINTS[block]).frictionloss = 100.0
        robot_write(write(command) if robot.now() > FAILS else command)

    robot.read, robot.write = failing_read, failing_write
    safety = SafetyCfg(stand_up_seconds=0.5, **limits)
    controller = Controller(Bundle.load(), safety, on_event=events.append)
    hand = SimpleNamespace(command=lambda now: TeleopCommand(0.6 * (now > 1.0), arm=now < 0.5))
    run_control_loop(robot, None, hand, controller, done=lambda: robot.now() > FAILS + 2.0)
    return next((e.time, e.why) for e in events if e.what == told)


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
    # It gives nothing, too little, or, a calf that is stretched just then, another torque.
    assert why.startswith((f"{name} does not obey: it", f"{name} is too weak: its motor"))
    assert time - FAILS < 0.5


@pytest.mark.parametrize(
    ("joint", "name"), [(1, "FR_thigh_joint"), (4, "FL_thigh_joint"), (10, "RL_thigh_joint")]
)
def test_a_joint_that_cannot_reach_its_target_is_told_and_the_robot_walks_on(joint, name):
    """It trembles in its bearing, so that no two readings of it are the same."""
    time, why = walk(block=joint, told="robot")
    assert why.startswith(f"{name} is blocked: it moved by ")
    assert time - FAILS < 1.9
    assert walk(block=joint)[1] == ENDED


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
