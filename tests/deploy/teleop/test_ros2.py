"""ROS 2's Twist from another process, by its own names and types."""

import json
import math
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="needs renet-locomotion[go2]")

from renet.deploy.catalogue import Ros2Cfg
from renet.deploy.recording.reader import read_recording
from renet.deploy.recording.tick import MODES
from renet.deploy.robots.base import heading
from renet.deploy.safety.machine import Mode
from renet.deploy.teleop.base import TeleopCommand
from renet.deploy.teleop.ros2 import TOPIC, Ros2Teleop, TwistStamped, domain_of
from renet.errors import RenetError

from ..dds.domain import free_domain
from ..fakes import until

pytestmark = pytest.mark.wall_clock

PUBLISHER = Path(__file__).with_name("ros2_publisher.py")
SILENCE = Ros2Cfg.silence
TOPICS = count()


class Node:
    """A publisher in a process of its own."""

    def __init__(self, topic: str, *frame: str) -> None:
        command = [sys.executable, str(PUBLISHER), str(free_domain()), topic, *frame]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        self._process = subprocess.Popen(command, **pipes)
        assert self._process.stdout.readline() == "ready\n"

    def send(self, forward: float, left: float = 0.0, turn_rate: float = 0.0) -> None:
        self.write([forward, left, 0.0, 0.0, 0.0, turn_rate])

    def write(self, values: list[float]) -> None:
        self._process.stdin.write(json.dumps(values) + "\n")
        self._process.stdin.flush()

    def end(self) -> None:
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()


@pytest.fixture
def topic() -> str:
    """A name for this test alone: a publisher may seem to be there after it has left."""
    return f"cmd_vel_{next(TOPICS)}"


@pytest.fixture
def node(topic) -> Iterator[Node]:
    node = Node(topic)
    yield node
    node.end()


@pytest.fixture
def teleop(topic) -> Ros2Teleop:
    """An operator who is armed."""
    teleop = Ros2Teleop(f"/{topic}", free_domain(), "lo", SILENCE, keys=None, rises=True)
    assert teleop.command(0.0) == TeleopCommand(arm=True)
    return teleop


def hear(teleop: Ros2Teleop, node: Node, now: float, *velocity: float) -> TeleopCommand:
    """What is asked for once a message has come."""
    asked = TeleopCommand(*velocity)
    until(lambda: teleop.command(now) == asked, lambda: node.send(*velocity))
    return teleop.command(now)


def refused(teleop: Ros2Teleop, now: float) -> bool:
    """Whether the newest message was left out."""
    teleop.command(now)
    return "not finite" in teleop.problem


def test_forward_turn_sideways_back_and_stop(teleop, node):
    for velocity in ((0.6,), (0.5, 0.0, -0.8), (0.0, 0.3), (-0.4,), (0.0,)):
        assert not hear(teleop, node, 1.0, *velocity).stop
    assert teleop.problem == ""


@pytest.mark.parametrize("frame", ["", "base", "base_link", "base_footprint"])
def test_stamped_messages_steer_whatever_their_frame(teleop, topic, frame):
    """Names of 0 to 14 letters: the numbers behind them are aligned to eight bytes."""
    stamped = Node(topic, frame)
    for velocity in ((0.5, 0.1, -0.8), (-0.4,)):
        hear(teleop, stamped, 1.0, *velocity)
    assert teleop.problem == ""
    until(lambda: refused(teleop, 1.1), lambda: stamped.write([math.nan] * 6))
    assert teleop.command(1.01 + SILENCE) == TeleopCommand()
    stamped.end()


def test_the_newest_message_counts_whatever_its_type(teleop, node, topic):
    stamped = Node(topic, "base_link")
    hear(teleop, node, 1.0, 0.6)
    hear(teleop, stamped, 1.1, 0.2)
    hear(teleop, node, 1.2, 0.5)
    teleop.command(3.0)
    hear(teleop, stamped, 3.1, 0.3)
    assert "2 publishers on" in teleop.problem
    stamped.end()


@pytest.mark.parametrize("size", [0, 3, 4, 8, 15, 40])
def test_a_stamped_message_that_was_cut_is_none(size):
    whole = b"\0\1\0\0" + bytes(8) + b"\5\0\0\0base\0" + bytes(7) + bytes(48)
    assert TwistStamped.deserialize(whole).values is not None
    assert TwistStamped.deserialize(whole[:size]).values is None
    endless = whole[:12] + b"\xff" * 4 + whole[16:]
    assert TwistStamped.deserialize(endless).values is None


def test_a_silent_topic_stops_the_robot(teleop, node):
    assert "no message on" in teleop.problem, "nor was there one before"
    hear(teleop, node, 1.0, 0.6)
    assert teleop.command(1.0 + SILENCE).forward == 0.6
    assert teleop.problem == ""
    assert teleop.command(1.01 + SILENCE) == TeleopCommand()
    assert "for 0.5 s: the robot stands" in teleop.problem
    hear(teleop, node, 2.0, 0.4)
    assert teleop.problem == ""


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", [0, 2, 5])
def test_a_value_that_is_no_number_is_left_out(teleop, node, wrong, place):
    hear(teleop, node, 1.0, 0.6)
    values = [0.3] * 6
    values[place] = wrong
    until(lambda: refused(teleop, 1.1), lambda: node.write(values))
    assert teleop.command(1.1).forward == 0.6
    assert teleop.command(1.01 + SILENCE) == TeleopCommand(), "it is no sign of life"
    hear(teleop, node, 2.0, 0.2)
    assert teleop.problem == ""


def test_more_publishers_than_one_are_told(teleop, node, topic):
    hear(teleop, node, 1.0, 0.6)
    another = Node(topic)
    hear(teleop, another, 1.5, 0.2)

    def counted() -> bool:
        counted.now += 2.0
        hear(teleop, node, counted.now, 0.3)
        return "2 publishers on" in teleop.problem

    counted.now = 2.0
    until(counted)
    another.end()
    until(lambda: not counted() and teleop.problem == "")


def test_keys_arm_and_stop(topic, node):
    """And do not steer."""
    drained = []
    keys = SimpleNamespace(quit=False, command=lambda now: asked, drain=drained.append)
    asked = TeleopCommand(forward=1.0)
    teleop = Ros2Teleop(topic, free_domain(), "lo", SILENCE, keys=keys, rises=False)
    teleop.drain(0.5)
    assert drained == [0.5]
    hear(teleop, node, 1.0, 0.3)
    asked = TeleopCommand(arm=True)
    assert teleop.command(1.0) == TeleopCommand(forward=0.3, arm=True)
    asked = TeleopCommand(stop=True)
    assert teleop.command(1.0).stop
    assert teleop.attended
    keys.quit = True
    assert teleop.quit
    simulated = Ros2Teleop(topic, free_domain(), "lo", SILENCE, keys=keys, rises=True)
    simulated.drain(0.5)
    asked = TeleopCommand(forward=1.0)
    assert simulated.command(1.0) == TeleopCommand(arm=True), "once, and after it was drained"
    assert simulated.command(1.0) == TeleopCommand()


def test_a_real_robot_needs_a_terminal(monkeypatch):
    monkeypatch.setattr(sys, "stdin", None)
    with pytest.raises(RenetError, match="keys need a terminal"):
        Ros2Cfg(ros_interface="lo", ros_domain=free_domain()).build(0.5, simulated=False)


def test_a_topic_that_cannot_be_read_leaves_the_terminal_as_it_was(terminal):
    before = termios.tcgetattr(sys.stdin.fileno())
    with pytest.raises(RenetError, match="no network interface 'eth77' here"):
        Ros2Cfg(ros_interface="eth77", ros_domain=free_domain()).build(0.5, simulated=False)
    assert termios.tcgetattr(sys.stdin.fileno()) == before


def test_a_domain_is_the_given_one_or_ros_own(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    assert (domain_of(None), domain_of(0)) == (7, 0)
    monkeypatch.setenv("ROS_DOMAIN_ID", "")
    assert domain_of(None) == 0
    monkeypatch.setenv("ROS_DOMAIN_ID", "seven")
    with pytest.raises(RenetError, match="ROS_DOMAIN_ID must be from 0 to 232, got seven"):
        domain_of(None)


@pytest.mark.parametrize("name", ["cmd_vel", "/robot/cmd_vel", "_a1"])
def test_topics(name):
    assert TOPIC.fullmatch(name)
    for wrong in (f"{name}/", f"{name} ", f"//{name}", f"~/{name}", f"{name}/1a", ""):
        assert not TOPIC.fullmatch(wrong)


def deploy(node: Node, topic: str, out: Path, *options: str, phases: list[tuple]) -> tuple:
    """`renet deploy` on stairs, sent a velocity [v_x, v_y, ω_z] for each phase's seconds.

    Returns what it printed, and the ticks of its recording that walk.
    """
    command = [sys.executable, "-m", "renet", "deploy", "--robot=mujoco", "--camera=sim"]
    command += ["--terrain=stairs", "--teleop=ros2", f"--topic={topic}", "--ros-interface=lo"]
    command += [f"--ros-domain={free_domain()}", f"--out={out}", *options]
    # A busy computer must not end the walk.
    command += ["--safety.max-gap=9", "--safety.max-state-age=9", "--safety.max-late=999"]
    pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "text": True}
    run = subprocess.Popen(command, **pipes)
    lines = []
    for line in run.stdout:
        lines.append(line)
        if "walking: stood up" in line:
            break
    for seconds, velocity in phases:
        for _ in range(round(10 * seconds)):
            node.send(*velocity)
            time.sleep(0.1)
    lines += run.stdout
    assert run.wait() == 0
    ticks = read_recording(out / "recording.mcap").ticks
    return "".join(lines), ticks[ticks["mode"] == MODES.index(Mode.WALKING)]


def asked_for(ticks: np.ndarray, velocity: tuple[float, float, float]) -> np.ndarray:
    """The ticks at which this was the operator's velocity."""
    asked = ticks[["forward", "left", "turn_rate"]]
    return ticks[asked == np.array(velocity, [(name, "f8") for name in asked.dtype.names])]


def forward_speed(ticks: np.ndarray) -> float:
    """Mean speed along the robot's own heading, m/s, from its true positions."""
    moved = np.diff(ticks["base_position"][:, :2], axis=0)
    yaw = np.array([heading(quaternion) for quaternion in ticks["quaternion"][1:]])
    ahead = moved[:, 0] * np.cos(yaw) + moved[:, 1] * np.sin(yaw)
    return ahead.sum() / np.ptp(ticks["now"])


def test_the_whole_program_walks_turns_and_stands_in_silence(node, topic, tmp_path):
    """On stairs, with the shipped bundle; backward, which it cannot, is refused and told."""
    ahead, left, back = (0.6, 0.0, 0.0), (0.5, 0.0, 0.8), (-0.4, 0.0, 0.0)
    phases = [(4.0, ahead), (2.0, left), (0.5, back)]
    told, walking = deploy(node, topic, tmp_path, "--seconds=12", phases=phases)
    for words in ("no message on", "refused: this policy cannot walk backward or sideways"):
        assert words in told
    for velocity in (ahead, left, back):
        assert asked_for(walking, velocity).size
    assert walking["told"][walking["turn_rate"] > 0.0, 1].max() > 0.1, "it is told to turn left"
    assert (walking["told"][walking["forward"] < 0.0, 0] == 0.0).all()
    silent = np.flatnonzero(walking["forward"] != 0.0)[-1] + 1
    assert (walking["told"][silent:, 0] == 0.0).all()
    assert np.hypot(*walking["base_position"][silent - 1, :2]) > 0.5, "it walked"


def test_a_policy_that_can_be_driven_turns_on_the_spot_and_walks_back(node, topic, tmp_path):
    """Forward, stop, round and back, as a separate process publishes it; in silence it stands."""
    ahead, stop, spot, back = (0.6, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (-0.6, 0.0, 0.0)
    phases = [(1.5, ahead), (1.0, stop), (3.0, spot), (3.0, back)]
    options = ["--bundle=go1-driven", "--mode=camera", "--seconds=14"]
    told, walking = deploy(node, topic, tmp_path, *options, phases=phases)
    assert "refused" not in told
    for velocity in (ahead, spot, back):
        # The first half second is for changing from one to the next.
        ticks = asked_for(walking, velocity)[25:]
        assert np.allclose(ticks["told"][:, :2], velocity[:2], atol=1e-6)
        # A robot that is not told to turn is led back to its heading.
        assert np.abs(ticks["told"][:, 2] - velocity[2]).mean() < 0.3
        walked = (forward_speed(ticks), 0.0, ticks["angular_velocity"][:, 2].mean())
        assert walked == pytest.approx(velocity, abs=0.25)
    silent = np.flatnonzero(walking["forward"] != 0.0)[-1] + 1
    still = walking["base_position"][silent + 50 :, :2]
    assert np.ptp(still, axis=0).max() < 0.1, "it stands"
