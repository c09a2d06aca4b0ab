"""Whatever kills or stalls the program, the robot is braked and nothing waits for ever."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace

import pytest

from renet.bundle import Bundle
from renet.deploy.controller import Controller
from renet.deploy.loop import run_control_loop
from renet.deploy.recording import recorder
from renet.deploy.recording.reader import read_recording
from renet.deploy.recording.recorder import Recorder
from renet.deploy.safety.watchdog import interruptible
from renet.deploy.teleop.scripted import ScriptedTeleop
from renet.terminal import Terminal

from ..deploy.fakes import QUICK, Standing, until
from ..deploy.robots.peer import KINDS, Peer, make_peer

pytestmark = pytest.mark.wall_clock

CONTROLLER = """
import ctypes, json, os, pkgutil, resource, signal, sys, time
import numpy as np
from renet.deploy.robots.base import JointCommand

def main():
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # Under nohup the tests ignore it.
    driver = pkgutil.resolve_name(sys.argv[1])
    robot = driver(*json.loads(sys.argv[2]), timeout=60.0, sink=0.3)
    robot.connect()
    default = np.tile([0.1, 0.9, -1.8, -0.1, 0.9, -1.8], 2)
    stiff = JointCommand(default, np.full(12, 40.0), np.ones(12))
    for step in range(10**9):
        robot.write(stiff)
        robot.wait(robot.now() + 0.02)
        if step == 25:
            print("up", flush=True)
            {how}

main()
"""
AT_ONCE = 10
"""Stiff commands that may still reach the robot after the end: 20 ms at 500 Hz."""


@pytest.fixture(params=KINDS)
def peer(request) -> Iterator[Peer]:
    with make_peer(request.param) as peer, peer.serving():
        peer.still = True
        yield peer


@pytest.fixture
def controller(peer: Peer) -> Iterator[Callable[..., subprocess.Popen]]:
    """Starts a process that commands the robot stiffly and then does something."""
    started: list[subprocess.Popen] = []

    def start(how: str = "pass") -> subprocess.Popen:
        code = CONTROLLER.replace("{how}", how)
        driver, address = peer.driver
        arguments = [sys.executable, "-c", code, driver, json.dumps(address)]
        process = subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
        started.append(process)
        assert process.stdout is not None
        assert process.stdout.readline() == b"up\n"
        assert peer.stiff > 0
        return process

    yield start
    for process in started:
        end(process)


def silent(peer: Peer) -> bool:
    """Whether nothing has reached the robot for 50 of the sender's cycles."""
    sent = len(peer.commands)
    time.sleep(0.1)
    return len(peer.commands) == sent


def end(process: subprocess.Popen) -> None:
    process.kill()
    process.wait()
    process.stdout.close()


@pytest.mark.parametrize("name", ["KILL", "STOP", "TERM", "HUP"])
def test_a_signal_that_ends_or_stops_the_controller_brakes_at_once(peer, controller, name):
    process = controller()
    process.send_signal(signal.Signals[f"SIG{name}"])
    killed = time.time_ns()
    until(lambda: peer.braked)
    late = [s for s, at in zip(peer.commands, peer.arrivals, strict=False) if at > killed]
    assert sum(bool(sent[:, 4].any()) for sent in late) <= AT_ONCE
    end(process)
    until(lambda: silent(peer))
    assert peer.braked, "and it stays braked"


def test_a_controller_that_was_stopped_and_goes_on_is_obeyed_again_by_new_commands(
    peer, controller
):
    process = controller()
    process.send_signal(signal.SIGSTOP)
    until(lambda: peer.braked)
    process.send_signal(signal.SIGCONT)
    until(lambda: not peer.braked)
    end(process)
    until(lambda: peer.braked)


@pytest.mark.parametrize(
    "how",
    [
        "os._exit(0)",
        "os.abort()",
        "1 / 0",
        "ctypes.string_at(0)",
        "resource.setrlimit(resource.RLIMIT_DATA, (0, 0)); bytearray(1 << 40)",
        "ctypes.PyDLL(None).sleep(60)",  # Holds the interpreter: not even signs of life.
        "time.sleep(60)",
        "while True: pass",
        "os.close(robot._pipe); time.sleep(60)",
        "os.kill(os.getppid(), 0); os.kill(os.getpid(), signal.SIGTTOU); time.sleep(60)",
    ],
)
def test_a_controller_that_crashes_or_hangs_by_itself_brakes(peer, controller, how):
    process = controller(how)
    until(lambda: peer.braked)
    end(process)
    until(lambda: peer.braked)


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    return Bundle.load()


def walk(bundle: Bundle, robot: Standing, seconds=1.0, log=None, **options) -> Controller:
    controller = Controller(bundle, QUICK)
    done = options.pop("done", lambda: robot.time >= seconds)
    run_control_loop(robot, None, ScriptedTeleop(0.5), controller, log, done=done, **options)
    return controller


@pytest.mark.parametrize("error", [OSError("gone"), KeyboardInterrupt(), MemoryError()])
@pytest.mark.parametrize("where", ["wait", "done"])
def test_a_loop_that_fails_brakes_before_it_ends(bundle, error, where):
    robot = Standing()

    def fails() -> bool:
        if robot.time > 0.5:
            assert not robot.braked
            raise error
        return False

    if where == "wait":
        robot.wait_fails = error
    with pytest.raises(type(error)):
        walk(bundle, robot, done=fails if where == "done" else lambda: False)
    assert robot.braked
    assert len(robot.told) < 40


def test_a_recorder_without_memory_does_not_end_the_run(bundle):
    def no_memory(*arguments):
        raise MemoryError

    robot = Standing()
    walk(bundle, robot, log=SimpleNamespace(append=no_memory, problem=""))
    assert robot.braked
    assert len(robot.told) > 70


def test_a_driver_that_takes_nothing_once_is_asked_to_brake_again(bundle):
    robot, failures = Standing(), [OSError()] * 3
    real = robot.write

    def write(command) -> None:
        if robot.time > 0.5 and failures:
            raise failures.pop()
        real(command)

    robot.write, robot.wait_fails = write, KeyboardInterrupt()
    with pytest.raises(KeyboardInterrupt):
        walk(bundle, robot)
    assert robot.braked


class Hang:
    """Blocks whoever calls it until it is let go."""

    def __init__(self) -> None:
        self.reached, self.go = threading.Event(), threading.Event()

    def __call__(self, *arguments, **named) -> None:
        self.reached.set()
        self.go.wait(60)


@pytest.fixture
def hang() -> Iterator[Hang]:
    hang = Hang()
    yield hang
    hang.go.set()


def test_a_hung_disk_neither_delays_a_step_nor_grows_the_queue_nor_hangs_the_end(
    bundle, tmp_path, monkeypatch, hang
):
    monkeypatch.setattr(recorder.os, "fsync", hang)
    monkeypatch.setattr(recorder, "DISK_SECONDS", 0.1)
    log = Recorder(tmp_path / "a.mcap", {})
    robot, told = Standing(), []
    controller = walk(bundle, robot, 40.0, log, on_step=lambda *step: told.append(log.problem))
    log.close()
    assert hang.reached.is_set()
    assert controller.machine.reason == "the run ends", "every step was made"
    assert log._chunks.qsize() <= recorder.MAX_CHUNKS
    assert "the disk does not keep up" in log.problem
    assert told[0] == "", "it was told while the robot walked"
    assert told[-1] == log.problem
    assert log.hung


def test_a_simulation_waits_for_a_disk_that_is_slower(bundle, tmp_path, monkeypatch):
    monkeypatch.setattr(recorder.os, "fsync", lambda descriptor: time.sleep(0.002))
    log = Recorder(tmp_path / "a.mcap", {}, patient=True)
    log._chunks.maxsize = 1
    walk(bundle, Standing(), 10.0, log)
    log.close()
    assert log.problem == ""
    assert read_recording(log.path).ticks["now"][-1] == pytest.approx(10.5, abs=0.05)


def test_a_hung_terminal_loses_lines_and_nothing_else(monkeypatch, hang):
    monkeypatch.setattr("builtins.print", hang)
    terminal = Terminal()
    for number in range(5000):
        terminal.say(str(number))
    assert terminal._lines.qsize() <= 1000
    terminal.close()


def test_a_second_ctrl_c_interrupts_and_the_first_does_not():
    before = signal.getsignal(signal.SIGINT)
    with interruptible() as asked:
        assert not asked()
        os.kill(os.getpid(), signal.SIGINT)
        assert asked()
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before
