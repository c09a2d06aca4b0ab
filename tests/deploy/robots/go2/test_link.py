"""The Go2's link against the fake robot, message by message, in the robot's own time."""

import json
import math
from types import SimpleNamespace

import pytest

pytest.importorskip("cyclonedds", reason="needs renet-locomotion[go2]")

from cyclonedds.core import DDSException

from renet.deploy.robots.go2.link import COMMANDS, QUIET, RELEASE, STATES, reading
from renet.deploy.robots.go2.messages import LowCmd, LowState, crc
from renet.deploy.robots.go2.network import Network
from renet.deploy.robots.go2.switch import CHECK_EVERY, SELECT_MODE, MotionSwitcher
from renet.deploy.robots.real.braking import PERIOD
from renet.interface import JOINTS

from ...fakes import command
from ..dds import free_domain
from ..peer import VENDOR


def stranger(head=(0xFE, 0xEF), checksum: int | None = None):
    """Another program: a participant of its own, and a function that sends a stiff command."""
    writer = Network("lo", free_domain()).writer(COMMANDS, LowCmd)

    def send() -> None:
        sample = LowCmd()
        sample.values["head"] = head
        sample.values["motor_cmd"]["mode"], sample.values["motor_cmd"]["kp"] = 1, 77.0
        sample.values["crc"] = crc(sample.raw) if checksum is None else checksum
        writer.write(sample)

    return send


def test_motors_are_numbered_as_joints_are():
    assert list(JOINTS) == VENDOR


def test_a_battery_that_says_nothing_is_not_empty():
    sample = LowState()
    assert math.isnan(reading(sample.values, 0.0).battery)
    sample.values["bms_state"]["soc"] = 57
    assert reading(sample.values, 0.0).battery == 0.57


def test_its_own_controller_has_ended_before_the_first_command(wire, peer):
    assert peer.mode
    wire.start()
    assert peer.mode == ""
    wire.run(100)
    assert peer.commands == [], "nothing is sent before the controller commands"
    wire.hold(5)
    assert len(peer.commands) == 5
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
    for _ in range(round(1.0 / PERIOD)):
        send()
        wire.run(1)
    assert wire.link.state is None
    wire.run(round(QUIET / PERIOD) + 2)
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


def test_a_state_is_taken_whatever_its_crc_says_and_never_from_the_past(free):
    """What a real robot's states hold there is not known, and the vendor does not look."""
    writer = Network("lo", free_domain()).writer(STATES, LowState)
    sample = LowState()
    for tick, time in ((2**20, 77.0), (2**19, 78.0)):
        sample.values["tick"], sample.values["crc"] = tick, 12345
        writer.write(sample)
        free.link.exchange(time)
    assert free.link.state.time == 77.0


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
    free.hold(2)
    peer.buttons = 0
    free.hold(2)
    assert free.link.problem == "a button of the robot's remote was pressed"
    assert peer.braked
