"""The links to all real robots: what arrives, and when they brake whatever a controller wants."""

import numpy as np
import pytest

from renet.bundle import Bundle
from renet.deploy.controller import Controller
from renet.deploy.robots.base import JointCommand
from renet.deploy.robots.real.braking import PERIOD, SILENCE
from renet.deploy.safety.limits import SafetyCfg
from renet.deploy.safety.machine import Mode
from renet.errors import RenetError

from ...fakes import command
from ..peer import STEP


def test_a_command_arrives_joint_by_joint(free, peer):
    targets = np.linspace(-0.1, 0.1, 12) + free.link.state.joint_position
    gains = np.linspace(10, 40, 12), np.linspace(0.5, 3, 12)
    free.send(JointCommand(targets, *gains), 1)
    mode, position, speed, torque, *arrived = peer.commands[-1].T
    assert (mode == peer.SERVO).all()
    limits = free.link._robot
    np.testing.assert_allclose(position, np.clip(targets, limits.lower, limits.upper), atol=1e-6)
    np.testing.assert_allclose(arrived, gains, atol=1 / 16)
    assert not speed.any()
    assert not torque.any()


def test_a_reading_arrives_joint_by_joint(free, peer):
    free.send(command(np.tile([0.2, 1.0, -2.0], 4) + np.linspace(-0.1, 0.1, 12)), 20)
    free.run(1, alone=True)  # The answer to the last command comes with the next.
    reading, data = free.link.state, peer.data
    assert len(set(np.round(reading.joint_position, 3))) == 12, "no two joints alike"
    np.testing.assert_allclose(reading.joint_position, peer.angles, atol=1e-5)
    np.testing.assert_allclose(reading.joint_velocity, peer.speeds, atol=1e-4)
    np.testing.assert_allclose(reading.quaternion, data.qpos[3:7], atol=1e-5)
    np.testing.assert_allclose(reading.angular_velocity, data.qvel[3:6], atol=1e-4)
    np.testing.assert_allclose(reading.joint_torque, peer.torques, atol=1 / 256)
    assert reading.time == free.now
    assert (reading.temperature == 30.0).all()


def test_a_controller_stands_up_from_the_floor_and_brakes(free, peer, kinds_bundle):
    """With no strength in its legs at first, and no jerk while it rises."""
    controller, limits = Controller(Bundle.load(kinds_bundle)), free.link._robot
    free.run(400)
    assert peer.height < 0.15, "it lies"
    lying, first = free.link.state.joint_position, len(peer.commands)
    free.control(controller, 100, arm=True)
    targets = np.array(peer.commands[first:])[::STEP, :, 1]
    assert np.abs(targets[0] - np.clip(lying, limits.lower, limits.upper)).max() < 0.1
    assert np.abs(np.diff(targets, axis=0)).max() < 0.1
    np.testing.assert_allclose(targets[-1], controller.robot.default_position, atol=0.05)
    assert peer.height > 0.2, "it stands"
    free.control(controller, 2, stop=True)
    assert controller.machine.reason == "operator stop"
    assert peer.braked


def test_a_robot_that_falls_silent_is_braked_by_the_controller(free, peer, kinds_bundle):
    hasty = SafetyCfg(stand_up_seconds=0.1, max_stand_up_error=9.0)
    controller = Controller(Bundle.load(kinds_bundle), hasty)
    free.control(controller, 10, arm=True)
    assert controller.machine.mode is Mode.WALKING
    peer.silent, last = True, free.link.state.time
    free.control(controller, 5)
    assert free.link.state.time <= last + 2 * PERIOD, "no reading is made up"
    assert controller.machine.mode is Mode.DAMPING
    assert "ms old" in controller.machine.reason
    assert peer.braked


def test_a_dead_robot_leaves_an_old_reading_and_the_driver_alive(free, peer):
    free.hold(5)
    free.run(1, alone=True)  # Its last message is read.
    last = free.link.state.time
    peer.close()
    free.run(100, alone=True)
    assert free.link.problem == ""
    assert free.link.state.time <= last + 2 * PERIOD


def test_a_silent_controller_is_braked_and_may_speak_again(free, peer):
    free.hold(round(SILENCE / PERIOD) - 1)
    assert peer.holds
    free.run(4)
    assert peer.braked
    free.hold(1)
    assert peer.holds


def test_a_controller_without_signs_of_life_is_braked_within_20_ms(free, peer):
    """And a command from before the gap is not obeyed after it."""
    free.hold(5)
    assert peer.holds
    free.dead = True
    free.run(round(0.02 / PERIOD))
    assert peer.braked
    free.dead = False
    free.run(5)
    assert peer.braked, "the old command"
    free.hold(1)
    assert peer.holds


def test_a_problem_brakes_with_the_next_exchange_and_for_good(free, peer):
    free.hold(5)
    free.link.problem = "the connection was closed"
    for _ in range(5):
        free.hold(1)
        assert peer.braked


def test_a_driver_that_cannot_receive_any_more_brakes_at_once_and_for_good(free, peer, monkeypatch):
    def deaf(now: float) -> None:
        raise OSError("bad file descriptor")

    free.hold(3)
    with monkeypatch.context() as broken:
        broken.setattr(free.link, "_receive", deaf)
        free.run(1)
    assert peer.braked
    assert "driver failed: OSError: bad file descriptor" in free.link.problem
    free.hold(2)
    assert peer.braked


@pytest.mark.parametrize(
    "parts", [{"position": [np.nan] * 12}, {"stiffness": np.inf}, {"position": [0]}]
)
def test_a_command_that_is_not_made_of_finite_numbers_is_refused(free, peer, parts):
    free.hold(0)
    with pytest.raises(RenetError, match=r"the command's .* must be"):
        free.send(command(**parts), 0)
    free.run(1)
    assert peer.holds, "the one before stands until silence brakes"


@pytest.mark.parametrize("gain", [1e9, -1e9])
def test_nothing_outside_the_envelope_reaches_the_motors(free, peer, gain):
    """Sent unchecked, the Go1's library would also turn a stiffness of 1100 into -948."""
    state, limits = free.link.state, free.link._robot
    free.send(command(np.full(12, gain), gain, gain), 1)
    _, position, speed, torque, stiffness, damping = peer.commands[-1].T
    assert (speed == 0).all()
    assert (torque == 0).all()
    assert (position >= limits.lower - 1e-6).all()
    assert (position <= limits.upper + 1e-6).all()
    assert ((stiffness >= 0) & (stiffness <= 100)).all()
    assert ((damping >= 0) & (damping <= 10)).all()
    torque = stiffness * (position - state.joint_position) - damping * state.joint_velocity
    assert (np.abs(torque) <= limits.torque * 1.01).all(), "gains of a Go1 are sent in 32nds"
