"""The real driver and the vendor's real library against a simulated robot behind a socket."""

import os
import re
import socket
from functools import partial
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from renet.bundle import Bundle
from renet.deploy import catalogue
from renet.deploy.cfg import DeployCfg
from renet.deploy.controller import Controller
from renet.deploy.joint_display import JointDisplay
from renet.deploy.main import deploy
from renet.deploy.recording.reader import read_recording
from renet.deploy.robots.base import RobotState
from renet.deploy.robots.go1 import link
from renet.deploy.robots.go1.driver import go1_robot
from renet.deploy.robots.real.identity import RESTARTED
from renet.deploy.safety.limits import SafetyCfg
from renet.deploy.safety.machine import Mode
from renet.errors import RenetError
from renet.interface import JOINTS
from renet.training.export import robot_spec

from ..go1_peer import free_port
from ..peer import KINDS, VENDOR

pytestmark = pytest.mark.wall_clock

ROBOT = robot_spec()
REFUSING = """
import os
def refuse(*arguments):
    raise PermissionError(1, "Operation not permitted")
os.sched_setscheduler = refuse
"""


def test_order_and_signs_are_those_of_the_vendors_own_limits():
    """The library clamps motor by motor: only a knee must never be above -0.8 rad."""
    sdk = pytest.importorskip(KINDS["go1"], reason="needs renet-locomotion[go1]")
    udp = sdk.UDP(link.LOW_LEVEL, 0, "127.0.0.1", free_port())
    ranges = []
    for extreme in (-10.0, 10.0):
        packet = sdk.LowCmd()
        udp.InitCmdData(packet)
        for motor in link.MOTORS:
            packet.motorCmd[motor].q = extreme
        sdk.Safety(sdk.LeggedType.Go1).PositionLimit(packet)
        ranges.append([packet.motorCmd[motor].q for motor in link.MOTORS])
    # Its ranges are an older robot's, within 0.2 rad but for the thigh's upper end.
    np.testing.assert_allclose(ranges[0], ROBOT.lower, atol=0.2)
    ends = [joint for joint, name in enumerate(JOINTS) if "thigh" not in name]
    np.testing.assert_allclose(np.array(ranges[1])[ends], np.array(ROBOT.upper)[ends], atol=0.2)
    assert [VENDOR[motor] for motor in link.MOTORS] == list(JOINTS)


def test_the_librarys_empty_packet_and_one_with_a_wrong_crc_are_no_readings(wire, peer):
    peer.silent = True
    wire.run(2)
    assert wire.link.state is None
    peer.silent = False
    wire.start()
    peer.garbled = True
    wire.run(2)
    last = wire.link.state.time
    wire.run(50)
    assert wire.link.state.time == last


def test_another_robot_at_its_address_brakes_for_good(free, peer):
    """One reading of another serial number is a damaged one."""
    free.hold(5)
    for serial, count, problem in (((7, 8), 1, ""), ((0, 0), 3, ""), ((7, 8), 5, RESTARTED)):
        peer.serial = serial
        for _ in range(count):
            free.hold(1)
        assert free.link.problem == problem
    assert peer.braked


def test_a_robot_that_is_started_again_brakes_for_good(wire, peer):
    peer.ticks = 10_000_000
    wire.start()
    wire.hold(5)
    peer.ticks = 0
    for _ in range(5):
        wire.hold(1)
    assert wire.link.problem == RESTARTED
    assert peer.braked


def test_motors_that_leave_their_mode_are_a_fault_of_the_robot(free, peer):
    for _ in range(100):
        free.hold(1)
    assert free.link.state.fault == ""
    peer.mode = 0
    for _ in range(5):
        free.hold(1)
    assert free.link.state.fault == "the motor of FR_hip_joint has left its mode"


@pytest.mark.parametrize(("charge", "battery"), [(57, 0.57), (1, 0.01), (0, 0.0)])
def test_an_empty_battery_is_not_an_unknown_one(wire, charge, battery):
    motor = SimpleNamespace(mode=10, q=0.0, dq=0.0, tauEst=0.0, temperature=1)
    imu = SimpleNamespace(quaternion=[1, 0, 0, 0], gyroscope=[0, 0, 0])
    bms = SimpleNamespace(SOC=charge, cell_vol=[3700] * 6)
    wire.link._in = SimpleNamespace(motorState=[motor] * 20, imu=imu, bms=bms)
    reading = wire.link._reading(0.0)
    assert (reading.battery, reading.voltage) == (battery, 22.2)


def test_a_reordered_older_reading_is_no_news(wire, peer):
    wire.run(5)
    peer.ticks -= 1000
    wire.run(2)  # One answer was on its way.
    newest = wire.link.state.time
    wire.run(5)
    assert wire.link.state.time == newest
    peer.ticks += 2000
    wire.run(3)
    assert wire.link.state.time > newest


def test_the_power_level_is_the_vendors_guards(peer):
    for level in (1, 10):
        wire = peer.wire(power_level=level)
        wire.link._safety = Mock(PowerProtect=Mock(return_value=0))
        wire.run(3)
        assert wire.link._safety.PowerProtect.call_args.args[2] == level


def test_the_vendors_guard_brakes_for_good(free, peer):
    free.hold(5)
    assert free.link.problem == ""
    peer.overloaded = True
    free.run(100)
    peer.overloaded = False
    free.hold(5)
    assert free.link.problem == "the vendor's guard says that the motors draw too much power"
    assert peer.braked


def test_the_shipped_bundle_walks_over_the_wire(free, peer):
    controller = Controller(Bundle.load(None))
    free.run(400)
    free.control(controller, 101, arm=True)
    start = peer.robot.base_position
    free.control(controller, 100, forward=0.6)
    assert controller.machine.mode is Mode.WALKING
    assert peer.robot.base_rotation[2, 2] > 0.5
    assert np.linalg.norm((peer.robot.base_position - start)[:2]) > 0.3


@pytest.fixture
def dry_run(served, monkeypatch, tmp_path) -> partial[DeployCfg]:
    """Settings that watch the served robot."""
    robot = partial(go1_robot, port=served.port, local_port=free_port())
    monkeypatch.setattr(catalogue, "go1_robot", robot)
    address = catalogue.Go1Cfg(robot_host="127.0.0.1")
    fixed = {"robot": "go1", "robot_cfg": address, "camera": "none", "dry_run": True}
    return partial(DeployCfg, **fixed, out=tmp_path)


def test_a_dry_run_tells_what_moves(served, dry_run, tmp_path, capsys, monkeypatch):
    """The joint-order check of docs/deploy.md, on a limp robot whose knee somebody straightens."""
    served.robot.model.opt.gravity[2] = -0.01  # Something must always move: a sensor trembles.
    knee = served.data.joint("FR_calf_joint")
    step = JointDisplay.step

    def step_and_straighten(display: JointDisplay, state: RobotState | None) -> None:
        step(display, state)
        # What was seen first is what turns are told from, however busy the computer is.
        if state is not None:
            knee.qfrc_applied[:] = 5.0

    monkeypatch.setattr(JointDisplay, "step", step_and_straighten)
    # How far it straightens, and how late, is of no interest to a dry run.
    patient = SafetyCfg(max_gap=9.0, max_state_age=9.0, max_late=999, joint_margin=9.0)
    deploy(dry_run(seconds=3.5, safety=patient))
    shown = capsys.readouterr().out
    assert re.search(r"FR_calf \+\d\.\d\d to -\d\.\d\d rad: front right, knee straightens", shown)
    # Which line is printed depends on when it stood; the gain says that it would have acted.
    assert re.search(r"FR_hip [+-]\d\.\d\d \(Kp 40\)", shown), "what it would have commanded"
    assert all((sent[:, 4:] == 0).all() for sent in served.commands)
    assert len(read_recording(tmp_path / "recording.mcap").ticks) > 10


def test_what_the_system_refuses_the_sender_is_printed_once(dry_run, monkeypatch, tmp_path, capsys):
    (tmp_path / "sitecustomize.py").write_text(REFUSING)  # Every Python process reads it.
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    deploy(dry_run(seconds=0.5))
    (line,) = re.findall(r".*to the process that talks to the Go1", capsys.readouterr().out)
    assert line.startswith("the system refused real-time priority (Operation not permitted)")


def test_a_name_of_the_robot_is_its_address():
    assert go1_robot("localhost", 1).settings == go1_robot("127.0.0.1", 1).settings
    with pytest.raises(RenetError, match="no robot at 'no such host'"):
        go1_robot("no such host")


def test_a_port_that_is_taken_is_refused():
    pytest.importorskip(KINDS["go1"], reason="needs renet-locomotion[go1]")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("0.0.0.0", 0))
        port = other.getsockname()[1]
        robot = go1_robot("127.0.0.1", free_port(), port)
        for start in (robot.connect, lambda: link.Go1Link("127.0.0.1", free_port(), port, 10)):
            with pytest.raises(RenetError, match=f"port {port} is taken: another program"):
                start()


def test_without_the_vendors_module_the_error_says_what_to_install(monkeypatch):
    missing = Mock(side_effect=ImportError("No module named 'unitree_legged_sdk'"))
    monkeypatch.setattr(link.importlib, "import_module", missing)
    with pytest.raises(RenetError, match=r"\.\[go1\]'.*\(No module named 'unitree_legged_sdk'\)"):
        link.unitree()
