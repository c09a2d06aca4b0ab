"""When a real robot's link brakes it whatever its controller wants, in the robot's own time."""

from collections.abc import Iterator
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest

from renet.deploy.robots.real.braking import PERIOD, SILENCE
from renet.errors import RenetError

from ...fakes import command

NEEDS = {"go1": "unitree_legged_sdk.robot_interface", "go2": "cyclonedds"}


@pytest.fixture(params=["go1", "go2"])
def robot(request) -> Iterator[SimpleNamespace]:
    """A link and a robot in lockstep, connected and lying."""
    pytest.importorskip(NEEDS[request.param], reason=f"needs renet-locomotion[{request.param}]")
    module = import_module(f"tests.deploy.robots.{request.param}_peer")
    peer = module.Peer()
    wire = module.wire_of(peer)
    wire.start()
    yield SimpleNamespace(wire=wire, link=wire.link, peer=peer)
    peer.close()


def hold(robot, **gains):
    """A command to stay where it is."""
    return command(robot.link.state.joint_position, **gains)


def test_a_silent_controller_is_braked_and_may_speak_again(robot):
    robot.wire.send(hold(robot), round(SILENCE / PERIOD) - 1)
    assert robot.peer.holds
    robot.wire.run(4)
    assert robot.peer.braked
    robot.wire.send(hold(robot), 1)
    assert robot.peer.holds


def test_a_controller_without_signs_of_life_is_braked_within_20_ms(robot):
    """And a command from before the gap is not obeyed after it."""
    robot.wire.send(hold(robot), 5)
    assert robot.peer.holds
    robot.wire.dead = True
    robot.wire.run(round(0.02 / PERIOD))
    assert robot.peer.braked
    robot.wire.dead = False
    robot.wire.run(5)
    assert robot.peer.braked, "the old command"
    robot.wire.send(hold(robot), 1)
    assert robot.peer.holds


def test_a_problem_brakes_with_the_next_exchange_and_for_good(robot):
    robot.wire.send(hold(robot), 5)
    robot.link.problem = "the connection was closed"
    for _ in range(5):
        robot.wire.send(hold(robot), 1)
        assert robot.peer.braked


def test_a_driver_that_cannot_receive_any_more_brakes_at_once_and_for_good(robot, monkeypatch):
    def deaf(now: float) -> None:
        raise OSError("bad file descriptor")

    robot.wire.send(hold(robot), 3)
    with monkeypatch.context() as broken:
        broken.setattr(robot.link, "_receive", deaf)
        robot.wire.run(1)
    assert robot.peer.braked
    assert "driver failed: OSError: bad file descriptor" in robot.link.problem
    robot.wire.send(hold(robot), 2)
    assert robot.peer.braked


@pytest.mark.parametrize(
    "parts", [{"position": [np.nan] * 12}, {"stiffness": np.inf}, {"position": [0]}]
)
def test_a_command_that_is_not_made_of_finite_numbers_is_refused(robot, parts):
    robot.link.command(hold(robot), robot.wire.now)
    with pytest.raises(RenetError, match=r"the command's .* must be"):
        robot.link.command(command(**parts), robot.wire.now)
    robot.wire.run(1)
    assert robot.peer.holds, "the one before stands until silence brakes"


@pytest.mark.parametrize("gain", [1e9, -1e9])
def test_nothing_outside_the_envelope_reaches_the_motors(robot, gain):
    """Sent unchecked, the Go1's library would also turn a stiffness of 1100 into -948."""
    state = robot.link.state
    robot.wire.send(command(np.full(12, gain), gain, gain), 1)
    _, position, speed, torque, stiffness, damping = robot.peer.commands[-1].T
    assert (speed == 0).all()
    assert (torque == 0).all()
    envelope = robot.link._envelope
    assert (position >= envelope.lower - 1e-6).all()
    assert (position <= envelope.upper + 1e-6).all()
    assert ((stiffness >= 0) & (stiffness <= 100)).all()
    assert ((damping >= 0) & (damping <= 10)).all()
    torque = stiffness * (position - state.joint_position) - damping * state.joint_velocity
    assert (np.abs(torque) <= envelope.torque * 1.01).all(), "gains of a Go1 are sent in 32nds"


def test_a_reading_that_is_not_newer_is_no_news(robot):
    """The count has 32 bits and goes on from zero."""
    link = robot.link
    link._tick = 100
    assert [link._news(tick) for tick in (100, 98, 102, 102)] == [False, False, True, False]
    link._tick = 2**32 - 2
    assert [link._news(tick) for tick in (2**32 - 4, 0, 2)] == [False, True, True]
