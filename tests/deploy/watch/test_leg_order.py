"""A lying robot whose legs push in turn, wired rightly or in another order."""

from itertools import combinations

import numpy as np
import pytest

from renet.deploy.robots.base import JointCommand, RobotState
from renet.deploy.watch.leg_order import LegTest
from renet.interface import CONTROL_DT, JOINTS, LEGS
from renet.training.export import robot_spec

from ..fakes import live, robot_on

SECONDS = 4.0
LYING = np.tile([0.0, 1.36, -2.65], 4)
SPEC = robot_spec()


def swapped(first: str, second: str) -> np.ndarray:
    """Joint of each motor [12] where two legs take each other's place."""
    order = np.arange(12).reshape(4, 3)
    places = [LEGS.index(first), LEGS.index(second)]
    order[places] = order[places[::-1]]
    return order.ravel()


class Wired:
    """A simulated robot that lies, whose motors are wired in an order."""

    def __init__(self, order: np.ndarray) -> None:
        self.robot, self.order = robot_on(), order
        data, model = self.robot.data, self.robot.model
        data.qpos[2] = 0.12
        data.qpos[[model.joint(name).qposadr[0] for name in JOINTS]] = LYING
        self.write(LYING, 0.0, 3.0)
        self.robot.wait(1.0)

    def read(self) -> RobotState:
        state = self.robot.read()
        parts = ("joint_position", "joint_velocity", "joint_torque")
        return live(
            state.time,
            quaternion=state.quaternion,
            angular_velocity=state.angular_velocity,
            **{part: getattr(state, part)[self.order] for part in parts},
        )

    def write(self, target: np.ndarray, stiffness: float, damping: float) -> None:
        position = np.empty(12)
        position[self.order] = target
        gains = np.full(12, stiffness), np.full(12, damping)
        self.robot.write(JointCommand(position, *gains))

    def test_legs(self, stiffness: float = 40.0) -> str:
        """What the test says of it."""
        begun = self.robot.now()
        test = LegTest(SPEC, SECONDS, self.read())
        while (elapsed := self.robot.now() - begun) < SECONDS - 1e-6 and not test.problem:
            self.write(test.target(elapsed, self.read()), stiffness, 1.0)
            self.robot.wait(self.robot.now() + CONTROL_DT)
        return test.problem


def test_legs_in_their_order_pass():
    wired = Wired(np.arange(12))
    lay = wired.read().joint_position
    assert wired.test_legs() == ""
    np.testing.assert_allclose(wired.read().joint_position, lay, atol=0.15)


@pytest.mark.parametrize("pair", combinations(LEGS, 2), ids="-".join)
def test_legs_that_are_swapped_are_found_before_the_robot_rises(pair):
    problem = Wired(swapped(*pair)).test_legs()
    why = "pushes, and another corner rises: are legs wired in another order?"
    assert problem == f"leg {pair[0]} {why}"


def test_a_robot_on_a_hoist_passes_if_its_legs_follow():
    wired = Wired(np.arange(12))
    wired.robot.model.opt.gravity[:] = 0.0
    wired.robot.data.qpos[2] = 2.0
    assert wired.test_legs() == ""


def test_a_leg_that_does_not_move_is_named():
    wired = Wired(np.arange(12))
    assert wired.test_legs(stiffness=0.0) == ("leg FR does not follow: is it another one's number?")
