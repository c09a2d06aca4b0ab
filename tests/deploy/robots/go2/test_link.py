"""The Go2's link against the fake robot, message by message, in the robot's own time."""

import json
import math
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="needs renet-locomotion[go2]")

from cyclonedds.core import DDSException
from scipy.spatial.transform import Rotation

from renet.deploy.dds.network import Network
from renet.deploy.robots.go2.fake import SPORT, FakeGo2
from renet.deploy.robots.go2.link import (
    COMMAND_TOPIC,
    HOLD_STIFFNESS,
    LISTEN,
    QUIET_TIME,
    RELEASE,
    SETTLES,
    SEVERAL,
    reading,
)
from renet.deploy.robots.go2.messages import MOST_DAMAGED, LowCmd, LowState, crc
from renet.deploy.robots.go2.switch import CHECK_EVERY, SELECT_MODE, MotionSwitcher
from renet.deploy.robots.real.braking import PERIOD
from renet.deploy.robots.real.identity import IN_A_ROW, RESTARTED
from renet.interface import JOINTS

from ...dds.domain import free_domain
from ...fakes import command
from ..peer import VENDOR


def stranger(head=(0xFE, 0xEF), checksum: int | None = None):
    """Another program: a participant of its own, and a function that sends a stiff command."""
    writer = Network("lo", free_domain()).writer(COMMAND_TOPIC, LowCmd)

    def send() -> None:
        sample = LowCmd()
        sample.values["head"] = head
        sample.values["motor_cmd"]["mode"], sample.values["motor_cmd"]["kp"] = 1, 77.0
        sample.values["crc"] = crc(sample.raw) if checksum is None else checksum
        writer.write(sample)

    return send


def test_motors_are_numbered_as_joints_are():
    assert list(JOINTS) == VENDOR


def test_the_fake_robots_angles_are_those_of_its_quaternion():
    robot = FakeGo2(free_domain())
    turn = Rotation.from_euler("ZYX", [0.7, -0.2, 0.4])
    robot.data.qpos[3:7] = turn.as_quat(scalar_first=True)
    robot.publish()
    rpy = robot._out.values["imu_state"]["rpy"]
    np.testing.assert_allclose(rpy, [0.4, -0.2, 0.7], atol=1e-6)


def test_a_battery_that_says_nothing_is_not_empty():
    sample = LowState()
    assert math.isnan(reading(sample.values, 0.0).battery)
    sample.values["bms_state"]["soc"] = 57
    assert reading(sample.values, 0.0).battery == 0.57


def test_its_own_controller_has_ended_before_the_first_command(wire, peer):
    assert peer.mode
    wire.start()
    assert peer.mode == ""
    held = len(peer.commands)
    wire.hold(5)
    assert len(peer.commands) == held + 5
    assert peer.refused == peer.wrong == 0


@pytest.mark.parametrize(
    ("failure", "why"),
    [
        ("stubborn", "the robot's mode 'normal' does not end: end it with the remote or app"),
        ("deaf", "the robot's motion switcher does not answer: is it a Go2 EDU?"),
    ],
)
def test_a_mode_that_does_not_end_is_refused(wire, peer, failure, why):
    setattr(peer, failure, True)
    wire.run(round(RELEASE / PERIOD) + 5)
    assert wire.link.problem == why
    assert wire.link.state is None
    wire.send(command(), 50)
    assert peer.commands == []
    assert peer.refused == 0


def test_a_switch_that_answers_late_is_understood(wire, peer):
    peer.slow = round(3 * CHECK_EVERY / PERIOD)
    wire.start()
    assert peer.mode == ""


def test_a_robot_that_says_nothing_is_waited_for(wire, peer):
    peer.silent = True
    wire.run(round(RELEASE / PERIOD) + 100)
    assert wire.link.problem == ""
    peer.silent = False
    wire.start()
    assert wire.link.problem == "", "its time to end its mode began with its first word"


def test_a_command_that_nobody_takes_is_followed_by_the_next(free, peer, monkeypatch):
    def full(sample: LowCmd) -> None:
        raise DDSException(DDSException.DDS_RETCODE_TIMEOUT)

    with monkeypatch.context() as broken:
        broken.setattr(free.link, "_commands", SimpleNamespace(write=full))
        peer.commands.clear()
        free.hold(1)
    assert peer.commands == []
    free.hold(1)
    assert (len(peer.commands), free.link.problem) == (1, "")


def test_watching_ends_no_mode_and_commands_nothing(peer):
    wire = peer.wire(watch=True)
    wire.start()
    wire.hold(300)
    assert wire.link.problem == "", "its own mode is none of a watcher's business"
    assert peer.mode == "normal"
    assert peer.commands == []
    assert peer.refused == 0


def test_a_mode_that_comes_back_silences_this_program_for_good(free, peer):
    free.hold(5)
    app = MotionSwitcher(Network("lo", free_domain()))
    app._ask(SELECT_MODE, json.dumps({"name": "ai"}))
    for _ in range(round(CHECK_EVERY / PERIOD) + 2):
        free.hold(1)
    assert free.link.problem == "the robot's mode 'ai' was started again"
    refused = peer.refused
    assert refused <= CHECK_EVERY / PERIOD + 2
    for _ in range(500):
        free.hold(1)
    assert peer.refused == refused
    assert peer.mode == "ai", "it is not ended again"
    peer.mode = ""
    for _ in range(round(CHECK_EVERY / PERIOD) + 2):
        free.hold(1)
    assert peer.braked, "once the mode has ended the robot is braked, and not driven"


def test_another_program_that_commands_the_motors_is_refused_at_the_start(wire, peer):
    send = stranger()
    for _ in range(round(RELEASE / PERIOD) + 100):
        send()
        wire.run(1)
    assert wire.link.problem == "another program commands the robot's motors: end it first"
    assert wire.link.state is None


def test_another_program_that_ended_just_before_is_not_minded(wire):
    send = stranger()
    for _ in range(round(2.0 / PERIOD)):
        send()
        wire.run(1)
    assert wire.link.state is None
    wire.run(round(QUIET_TIME / PERIOD) + 2)
    assert wire.link.state is not None


def test_another_program_that_begins_to_command_brakes_for_good(free, peer):
    free.hold(5)
    stranger()()
    free.run(1)
    assert free.link.problem == "another program commands the robot's motors"
    free.hold(2)
    assert peer.braked


@pytest.mark.parametrize("wrong", [{"checksum": 1}, {"head": (0, 0)}])
def test_the_robot_obeys_no_command_with_a_wrong_crc_or_head(free, peer, wrong):
    free.hold(5)
    obeyed = len(peer.commands)
    stranger(**wrong)()
    peer.step()
    assert peer.wrong == 1
    assert len(peer.commands) == obeyed


def test_damaged_messages_are_left_out(free, peer):
    """Whatever they say: here that a motor is hot, the battery empty and a button pressed."""
    free.hold(5)
    spoil = Spoiler(peer)
    for _ in range(20):
        spoil.once(temperature=200, soc=1, button=1)
        free.hold(2)
        assert (free.link.state.temperature == 30.0).all()
        assert (free.link.state.battery, free.link.state.voltage) == (0.81, pytest.approx(28.8))
    assert free.link.problem == ""
    assert peer.holds


def test_a_robot_that_is_heard_only_damaged_is_braked_for_good(free, peer):
    free.hold(5)
    spoil = Spoiler(peer)
    peer.silent = True
    for _ in range(MOST_DAMAGED + 1):
        spoil.once()
        free.hold(1)
    assert free.link.problem == "the robot's messages arrive damaged: check cable and network card"
    free.hold(1)
    assert peer.braked


def test_a_robot_whose_checksums_are_never_right_is_believed(peer, monkeypatch):
    """What every firmware writes there is not known, and the vendor does not look."""
    monkeypatch.setattr("renet.deploy.robots.go2.fake.crc", lambda raw: 12345)
    wire = peer.wire()
    wire.start()
    assert wire.link.problem == ""
    assert wire.link.state.battery == 0.81


class Spoiler:
    """Sends what the robot would send next, damaged on its way."""

    def __init__(self, peer) -> None:
        self._peer = peer

    def once(self, temperature: int = 30, soc: int = 81, button: int = 0) -> None:
        out, peer = self._peer._out, self._peer
        before = out.raw.copy()
        out.values["tick"] += 1
        out.values["motor_state"]["temperature"] = temperature
        out.values["bms_state"]["soc"] = soc
        out.values["wireless_remote"][2] = button
        out.raw[20] ^= 1  # The CRC is that of the message before.
        peer._states.write(out)
        out.raw[:] = before


def test_a_flipped_bit_in_its_count_costs_a_reading_and_not_the_robot(free, peer):
    free.hold(5)
    true = peer.steps
    peer.steps = true ^ (1 << 28)
    free.hold(1)
    peer.steps = true + 1
    for _ in range(5):
        free.hold(1)
    assert free.link.problem == ""
    assert free.now - free.link.state.time <= 2 * PERIOD


def test_a_robot_that_is_started_again_brakes_for_good(free, peer):
    free.run(500)
    free.hold(5)
    peer.steps = 0
    for _ in range(5):
        free.hold(1)
    assert free.link.problem == RESTARTED
    assert peer.braked


def test_two_robots_on_one_network_are_refused_before_anything_is_released(wire, peer):
    other = FakeGo2(free_domain())
    other.steps, other.battery = 500_000, 33
    for _ in range(round(2 * LISTEN / PERIOD)):
        other.step()
        wire.run(1)
    assert wire.link.problem == SEVERAL.format(2)
    assert wire.link.state is None
    assert (peer.mode, other.mode) == (SPORT, SPORT)
    assert peer.commands == []
    assert peer.refused == other.refused == 0


def test_a_second_robot_that_comes_later_brakes_the_first_for_good(free, peer):
    free.hold(5)
    other = FakeGo2(free_domain())
    other.steps, other.battery = 500_000, 33
    for _ in range(100):
        other.step()
        free.hold(1)
    assert free.link.problem == RESTARTED
    assert free.link.state.battery == 0.81
    assert peer.braked
    assert other.mode == SPORT, "it is not released"


def test_a_watcher_too_hears_one_robot_alone(peer):
    wire, other = peer.wire(watch=True), FakeGo2(free_domain())
    for _ in range(round(2 * LISTEN / PERIOD)):
        other.step()
        wire.run(1)
    assert wire.link.problem == SEVERAL.format(2)
    assert wire.link.state is None


def test_it_is_held_where_it_stands_from_the_release_on(wire, peer):
    """Its motors are limp from there, and without a new command after 20 ms."""
    peer.pose, peer.patience = np.tile((0.0, 0.8, -1.6), 4), 0.02
    peer.data.qpos[2] = 0.3
    for _ in range(500):
        peer.step()
    stood, limp = peer.height, []
    assert stood > 0.25
    for _ in range(2000):
        wire.run(1)
        released = peer.mode == ""
        limp += [peer.steps] if released and not peer.commands else []
    assert wire.link.state is not None
    assert len(limp) * PERIOD <= 0.01
    assert abs(peer.height - stood) < 0.02
    wire.dead = True
    wire.run(round(0.02 / PERIOD))
    assert peer.braked, "its controller hangs before its first command"
    wire.dead = False
    wire.run(1)
    assert not peer.braked
    wire.link.problem = "the connection was closed"
    wire.run(2)
    assert peer.braked


def test_it_is_not_held_against_another_program(wire, peer):
    send = stranger()
    for _ in range(round(3.0 / PERIOD)):
        send()
        wire.run(1)
    held = [sent for sent in peer.commands if (sent[:, 4] == HOLD_STIFFNESS).all()]
    assert peer.mode == ""
    assert len(held) * PERIOD < 2 * SETTLES


@pytest.mark.parametrize("buttons", [256, 4])
def test_a_button_of_the_robots_remote_brakes_for_good(free, peer, buttons):
    peer.buttons = buttons
    free.run(5)
    assert free.link.problem == "", "the remote's own business before the first command"
    peer.buttons = 0
    free.run(1)
    free.hold(5)
    assert peer.holds
    peer.buttons = buttons
    free.hold(IN_A_ROW + 1)
    peer.buttons = 0
    free.hold(2)
    assert free.link.problem == "a button of the robot's remote was pressed"
    assert peer.braked
