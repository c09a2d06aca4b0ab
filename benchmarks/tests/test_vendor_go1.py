"""renet's own link to a Go1, behind a wire on which things go wrong."""

import numpy as np
import pytest

from disturbances import Body
from renet.deploy.robots.base import VECTORS, JointCommand
from renet.deploy.robots.real.identity import CONFUSED, RESTARTED
from renet.deploy.robots.sim.scene import build_scene
from renet.training.export import robot_spec
from vendor_go1 import Wire

PERIOD = 0.005


class Bench:
    """A robot that stands, its wire and a link to it."""

    def __init__(self, seed: int = 1) -> None:
        spec = robot_spec()
        model, ground = build_scene("flat", 1)
        self.body = Body(seed, model, spec, ground)
        self.sent: list[JointCommand] = []
        self.wire = Wire(self.body, np.random.default_rng(seed), self.sent.append)
        self.link = self.wire.link()
        self.standing = np.array(spec.default_position)

    def run(self, exchanges: int) -> None:
        """Hold the robot's pose for so many exchanges, or for what the link lets through."""
        for _ in range(exchanges):
            now = self.body.now()
            self.link.command(JointCommand(self.standing, np.full(12, 40.0), np.ones(12)), now)
            if not self.wire.lifeless:
                self.link.alive(now)
            self.link.exchange(now)
            self.body.wait(now + PERIOD)


@pytest.fixture
def bench() -> Bench:
    bench = Bench()
    bench.run(20)
    return bench


def test_readings_and_commands_pass_through_the_vendors_messages(bench):
    reading = bench.body.read()
    bench.link.exchange(bench.body.now())
    found = bench.link.state
    assert found.time == bench.body.now()
    for name in ("joint_position", "joint_velocity", "joint_torque", "quaternion"):
        np.testing.assert_allclose(getattr(found, name), getattr(reading, name))
    assert (found.temperature == 35.0).all()
    assert (found.battery, found.fault) == (1.0, "")
    assert bench.link.problem == ""
    # Before the first command motors have no target.
    assert len(bench.sent) == 21
    np.testing.assert_allclose(bench.sent[-1].position, bench.standing)
    ids = bench.body._servos.ids
    assert (bench.body.model.actuator_gainprm[ids, 0] > 0.0).all()


@pytest.mark.parametrize(
    ("attribute", "problem"),
    [
        ("miscounts", CONFUSED),
        ("stranger", CONFUSED),
        ("broken", "the robot's driver failed: OSError: the socket is gone"),
        ("overloaded", "the vendor's guard says that the motors draw too much power"),
    ],
)
def test_what_brakes_a_robot_for_good(bench, attribute, problem):
    setattr(bench.wire, attribute, True)
    while not bench.link.problem:
        bench.run(1)
        assert bench.body.now() < 1.0
    assert bench.link.problem == problem
    assert not bench.sent[-1].stiffness.any(), "the same message brakes"
    bench.wire.heal()
    bench.run(100)
    assert not bench.sent[-1].stiffness.any(), "it stays braked"
    bench.link = bench.wire.link()
    bench.run(20)
    assert bench.sent[-1].stiffness.any(), "until the program is started again"


def test_a_robot_that_restarts_is_found_if_it_counts_back():
    found = set()
    for seed in range(4):
        bench = Bench(seed)
        bench.run(20)
        bench.wire.restart()
        bench.run(20)
        found.add(bench.link.problem)
    # Counts of more than half the way around seem to go on.
    assert found <= {"", RESTARTED}
    assert RESTARTED in found


def test_damaged_packets_age_the_reading_and_a_silent_program_brakes(bench):
    bench.wire.damaged = True
    bench.run(20)
    assert bench.body.now() - bench.link.state.time > PERIOD
    bench.wire.heal()
    bench.wire.lifeless = True
    bench.run(10)
    assert not bench.sent[-1].stiffness.any()
    bench.wire.heal()
    bench.run(10)
    assert bench.sent[-1].stiffness.any()
    assert bench.link.problem == ""


def test_an_absurd_number_is_in_as_many_packets_as_asked_for(bench):
    bench.wire.absurd = 3
    absurd = 0
    for _ in range(10):
        bench.run(1)
        state = bench.link.state
        vectors = (getattr(state, name) for name in VECTORS)
        absurd += not (np.abs(np.concatenate(list(vectors))) < 40.0).all()
    assert bench.wire.absurd == 0
    assert 1 <= absurd <= 3, "a small number may pass for a true one"


def test_a_robot_reports_heat_charge_and_a_motor_that_left_its_mode(bench):
    bench.wire.temperature[4] = 70.0
    bench.wire.charge = 0.17
    # Motors change their mode some time after the first command.
    bench.run(20)
    bench.wire.modes[4] = 0
    bench.run(10)
    state = bench.link.state
    assert state.temperature[4] == 70.0
    assert state.battery == 0.17
    assert state.fault == "the motor of FL_thigh_joint has left its mode"
