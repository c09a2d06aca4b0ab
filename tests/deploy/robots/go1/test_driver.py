"""The real driver and the vendor's real library against a simulated robot behind a socket."""

import os
import re
import socket
import threading
import time
from collections.abc import Iterator
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

sdk = pytest.importorskip(
    "unitree_legged_sdk.robot_interface", reason="needs renet-locomotion[go1] (Python 3.11 or 3.12)"
)

from renet.bundle import Bundle  # noqa: E402
from renet.deploy.catalogue import Go1Cfg  # noqa: E402
from renet.deploy.cfg import DeployCfg  # noqa: E402
from renet.deploy.controller import Controller  # noqa: E402
from renet.deploy.main import deploy  # noqa: E402
from renet.deploy.recording.recorder import read_recording  # noqa: E402
from renet.deploy.robots.base import JointCommand  # noqa: E402
from renet.deploy.robots.go1 import driver, link  # noqa: E402
from renet.deploy.robots.go1.driver import Go1Robot  # noqa: E402
from renet.deploy.robots.go1.link import LOW_LEVEL, MOTORS, Go1Link  # noqa: E402
from renet.deploy.robots.real.braking import PERIOD  # noqa: E402
from renet.deploy.safety.limits import SafetyCfg  # noqa: E402
from renet.deploy.safety.machine import Mode  # noqa: E402
from renet.errors import RenetError  # noqa: E402
from renet.interface import JOINTS  # noqa: E402
from renet.training.export import robot_spec  # noqa: E402

from ...fakes import command  # noqa: E402
from ...waiting import until  # noqa: E402
from ..go1_peer import VENDOR, Peer, free_port, wire_of  # noqa: E402
from ..peer import STEP, Wire  # noqa: E402

ROBOT = robot_spec()
REFUSING = """
import os
def refuse(*arguments):
    raise PermissionError(1, "Operation not permitted")
os.sched_setscheduler = refuse
"""


@pytest.fixture
def peer() -> Iterator[Peer]:
    peer = Peer()
    yield peer
    peer.close()


@pytest.fixture
def wire(peer) -> Wire:
    return wire_of(peer)


def test_order_and_signs_are_those_of_the_vendors_own_limits():
    """The library clamps motor by motor: only a knee must never be above -0.8 rad."""
    udp = sdk.UDP(LOW_LEVEL, 0, "127.0.0.1", free_port())
    ranges = []
    for extreme in (-10.0, 10.0):
        packet = sdk.LowCmd()
        udp.InitCmdData(packet)
        for motor in MOTORS:
            packet.motorCmd[motor].q = extreme
        sdk.Safety(sdk.LeggedType.Go1).PositionLimit(packet)
        ranges.append([packet.motorCmd[motor].q for motor in MOTORS])
    # Its ranges are an older robot's, within 0.2 rad but for the thigh's upper end.
    np.testing.assert_allclose(ranges[0], ROBOT.lower, atol=0.2)
    ends = [joint for joint, name in enumerate(JOINTS) if "thigh" not in name]
    np.testing.assert_allclose(np.array(ranges[1])[ends], np.array(ROBOT.upper)[ends], atol=0.2)
    assert [VENDOR[motor] for motor in MOTORS] == list(JOINTS)


def test_a_command_arrives_motor_by_motor(wire, peer):
    targets = np.array(ROBOT.default_position) + np.linspace(-0.3, 0.3, 12)
    gains = np.linspace(10, 40, 12), np.linspace(0.5, 3, 12)
    wire.send(JointCommand(targets, *gains), 1)
    arrived = peer.commands[-1][list(MOTORS)]
    assert (arrived[:, 0] == 10).all()
    np.testing.assert_allclose(arrived[:, 1], targets, atol=1e-6)
    np.testing.assert_allclose(arrived[:, 4], gains[0], atol=1 / 32)
    np.testing.assert_allclose(arrived[:, 5], gains[1], atol=1 / 16)


def test_a_reading_arrives_joint_by_joint(wire, peer):
    peer.silent = True
    wire.run(2)
    assert wire.link.state is None, "the library's empty packet is no reading"
    peer.silent = False
    peer.pose(np.array(ROBOT.default_position)[list(MOTORS)] + np.linspace(-0.3, 0.3, 12))
    wire.send(command(), 20)
    wire.link.exchange(wire.now)  # The answer to the last command comes with the next.
    truth, read = peer.robot.read(), wire.link.state
    assert len(set(np.round(truth.joint_position, 3))) == 12, "no two joints alike"
    for name in ("joint_position", "joint_velocity", "quaternion", "angular_velocity"):
        np.testing.assert_allclose(getattr(read, name), getattr(truth, name), atol=1e-5)
    np.testing.assert_allclose(read.joint_torque, truth.joint_torque, atol=1 / 256)
    assert (read.time, read.temperature) == (wire.now, 30.0)


@pytest.mark.parametrize(("charge", "battery"), [(57, 0.57), (1, 0.01), (0, 0.0)])
def test_an_empty_battery_is_not_an_unknown_one(wire, charge, battery):
    motor = SimpleNamespace(q=0.0, dq=0.0, tauEst=0.0, temperature=1)
    imu = SimpleNamespace(quaternion=[1, 0, 0, 0], gyroscope=[0, 0, 0])
    bms = SimpleNamespace(SOC=charge)
    wire.link._in = SimpleNamespace(motorState=[motor] * 20, imu=imu, bms=bms)
    assert wire.link._reading(0.0).battery == battery


@pytest.mark.parametrize("failure", ["silent", "garbled"])
def test_a_robot_that_falls_silent_or_sends_a_wrong_crc_is_braked(wire, peer, bundle_path, failure):
    controller = Controller(Bundle.load(bundle_path), SafetyCfg(stand_up_seconds=0.1))
    wire.run(5)
    wire.control(controller, 10, arm=True)
    assert controller.machine.mode is Mode.WALKING
    setattr(peer, failure, True)
    last = wire.link.state.time
    wire.control(controller, 5)
    assert wire.link.state.time <= last + 2 * PERIOD, "no reading is made up"
    assert controller.machine.mode is Mode.DAMPING
    assert "ms old" in controller.machine.reason
    assert peer.braked


def test_a_dead_robot_leaves_an_old_reading_and_the_driver_alive(wire, peer):
    wire.run(5)
    last = wire.link.state.time
    peer.close()
    for _ in range(100):
        wire.now += PERIOD
        wire.link.exchange(wire.now)
    assert wire.link.state.time <= last + 2 * PERIOD


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
    peer.ticks = 2**32 - 6
    wire.run(2)
    wire.link._tick = 2**32 - 8
    wire.run(8)
    assert wire.link._tick < 10, "the counter goes on from zero"


def test_the_power_level_is_the_vendors_guards(peer):
    asked = []
    for level in (1, 10):
        link = Go1Link("127.0.0.1", peer.port, free_port(), level)

        class Guard:
            def PowerProtect(self, out, state, level):
                asked.append(level)
                return 0

        link._safety = Guard()
        for step in range(3):
            link.exchange(PERIOD * step)
            peer.serve()
    assert set(asked) == {1, 10}


def test_the_vendors_guard_brakes_for_good(wire, peer):
    wire.send(command(), 5)
    assert wire.link.problem == ""
    peer.overloaded = True
    wire.run(100)
    peer.overloaded = False
    wire.send(command(), 5)
    assert "too much power" in wire.link.problem
    assert peer.braked


def test_the_shipped_bundle_stands_up_walks_and_brakes_over_the_wire(wire, peer):
    """From the floor, with no strength in its legs, to 0.3 m further and back to braking."""
    controller = Controller(Bundle.load(None))
    wire.run(400)
    assert peer.robot.base_position[2] < 0.15, "it lies"
    lying, first = wire.link.state.joint_position, len(peer.commands)
    wire.control(controller, 101, arm=True)
    targets = np.array(peer.commands[first::STEP])[1:, list(MOTORS), 1]
    assert np.abs(targets[0] - np.clip(lying, ROBOT.lower, ROBOT.upper)).max() < 0.1
    assert np.abs(np.diff(targets, axis=0)).max() < 0.05, "no jerk while it rises"
    np.testing.assert_allclose(targets[-1], ROBOT.default_position, atol=0.05)
    assert peer.robot.base_position[2] > 0.22, "it stands"
    start = peer.robot.base_position
    wire.control(controller, 100, speed=0.6)
    assert controller.machine.mode is Mode.WALKING
    assert peer.robot.base_rotation[2, 2] > 0.5
    assert np.linalg.norm((peer.robot.base_position - start)[:2]) > 0.3, "it walks"
    wire.control(controller, 2, stop=True)
    assert controller.machine.reason == "operator stop"
    assert peer.braked


@pytest.fixture
def served(peer) -> Iterator[Peer]:
    with peer.serving():
        yield peer


def test_a_connection_that_only_looked_leaves_the_robot_limp(served):
    robot = served.make_driver(sink=0.3)
    robot.connect()
    robot.close()
    for sent in served.commands:
        assert (sent[:, 0] == 10).all(), "a servo"
        assert (sent[:, 4:] == 0).all()


@pytest.fixture
def dry_run(served, monkeypatch, tmp_path) -> partial[DeployCfg]:
    """Settings that watch the served robot."""
    robot = partial(Go1Robot, port=served.port, local_port=free_port())
    monkeypatch.setattr(driver, "Go1Robot", robot)
    address = Go1Cfg(robot_host="127.0.0.1")
    fixed = {"robot": "go1", "driver": address, "camera": "none", "dry_run": True}
    return partial(DeployCfg, **fixed, out=tmp_path)


def test_a_dry_run_tells_what_moves_and_commands_nothing(served, dry_run, tmp_path, capsys):
    """The joint-order check of docs/robot.md: a robot that sinks moves its own joints."""
    gravity = served.robot.model.opt.gravity
    gravity[2] = -0.01  # Something must always move: a sensor trembles.

    def let_go() -> None:
        until((tmp_path / "recording.log").exists)
        time.sleep(1.0)
        gravity[2] = -50.0

    threading.Thread(target=let_go).start()
    # Where it is when it is armed depends on how busy the computer is.
    patient = SafetyCfg(max_gap=9.0, max_state_age=9.0, max_late=999, joint_margin=9.0)
    deploy(dry_run(seconds=3.5, safety=patient))
    shown = capsys.readouterr().out
    assert "rad: front right, knee folds" in shown
    # Which line is printed depends on when it stood; the gain says that it would have acted.
    assert re.search(r"FR_hip [+-]\d\.\d\d \(Kp 40\)", shown), "what it would have commanded"
    assert all((sent[:, 4:] == 0).all() for sent in served.commands)
    assert len(read_recording(tmp_path / "recording.log").ticks) > 10


def test_what_the_system_refuses_the_sender_is_printed_once(dry_run, monkeypatch, tmp_path, capsys):
    (tmp_path / "sitecustomize.py").write_text(REFUSING)  # Every Python process reads it.
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    deploy(dry_run(seconds=0.5))
    told = re.findall(r".*to the process that talks to the Go1", capsys.readouterr().out)
    assert len(told) == 1
    assert told[0].startswith("the system refused real-time priority (Operation not permitted)")


def test_no_robot_is_one_clear_line():
    with pytest.raises(RenetError, match=r"no answer from a Go1 at 127.0.0.1.*cable"):
        Go1Robot("127.0.0.1", free_port(), free_port(), timeout=0.5).connect()


def test_a_name_of_the_robot_is_its_address():
    named = Go1Robot("localhost", 1)
    assert named._settings == Go1Robot("127.0.0.1", 1)._settings
    with pytest.raises(RenetError, match="no robot at 'no such host'"):
        Go1Robot("no such host")


def test_a_port_that_is_taken_is_refused():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("0.0.0.0", 0))
        port = other.getsockname()[1]
        with pytest.raises(RenetError, match=f"port {port} is taken: another program"):
            Go1Robot("127.0.0.1", free_port(), port).connect()


def test_without_the_vendors_module_the_error_says_what_to_install(monkeypatch):
    def missing(name: str):
        raise ImportError(f"No module named {name!r}")

    monkeypatch.setattr(link.importlib, "import_module", missing)
    with pytest.raises(RenetError, match=r"\.\[go1\]'.*unitree_legged_sdk"):
        link.unitree()
