"""A run whose loop hangs in foreign code, where Python handles no signal, ends braked."""

import os
import signal
import subprocess
import sys
import time
from itertools import takewhile

import pytest

from renet.deploy.main import RECORDING
from renet.deploy.recording.reader import read_recording
from renet.deploy.safety.watchdog import HANGS, interruptible

pytestmark = pytest.mark.wall_clock

HANGING = """
import hashlib, os, sys
from renet.pilot.policy import BundlePolicy
from renet.cli import main
from renet.deploy.robots.sim.mujoco import MujocoRobot

act, write = BundlePolicy._act, MujocoRobot.write

def hang(policy, *arguments):
    if policy._step == 20:
        os.write(1, b"hangs\\n")
        hashlib.pbkdf2_hmac("sha256", b"", b"", 2**31 - 1)  # Minutes in C, as an endless model.
    return act(policy, *arguments)

def told(robot, command):
    write(robot, command)
    os.write(1, b"stiff\\n" if command.stiffness.any() else b"braked\\n")  # Whole lines.

BundlePolicy._act, MujocoRobot.write = hang, told
main(["deploy", "--camera", "none", "--safety.stand-up-seconds", "0.2", "--out", sys.argv[1]])
"""


@pytest.mark.parametrize("numbers", [(), (signal.SIGINT, signal.SIGTERM)])
def test_a_model_that_never_returns_ends_the_run_braked(tmp_path, numbers):
    out = tmp_path / "out"
    command = [sys.executable, "-c", HANGING, str(out)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as program:
        assert list(takewhile("hangs\n".__ne__, program.stdout))[-1] == "stiff\n"
        for number in numbers:
            program.send_signal(number)
        begun = time.monotonic()
        rest, errors = program.stdout.read(), program.stderr.read()
        assert time.monotonic() - begun < 30.0, "not the minutes that the model takes"
    assert program.returncode == 2
    assert errors == "renet: the control loop hangs since 6 s: the run ends, braked\n"
    commands = [line for line in rest.splitlines() if line in ("stiff", "braked")]
    assert commands[0] == "braked"
    run = read_recording(out / RECORDING)
    assert run.complete
    assert (run.events[-1].what, run.events[-1].why) == ("damping", HANGS)


LATE = """
import time
from renet.deploy.safety import watchdog

watchdog.HANG_SECONDS = 0.5

def close():
    print("braked", flush=True)
    time.sleep(2.0)

with watchdog.watchdog(close) as step:
    time.sleep(1.5)
    step()
    print("walks on", flush=True)
"""


def test_a_loop_that_returns_after_the_braking_does_not_walk_on():
    program = subprocess.run([sys.executable, "-c", LATE], capture_output=True, text=True)
    assert (program.returncode, program.stdout) == (2, "braked\n")


@pytest.mark.parametrize("name", ["INT", "TSTP", "QUIT", "TERM", "HUP", "USR1", "USR2"])
def test_a_signal_asks_the_run_to_end(name):
    number = signal.Signals[f"SIG{name}"]
    before = signal.getsignal(number)
    with interruptible() as interrupted:
        assert not interrupted()
        os.kill(os.getpid(), number)
        assert interrupted()
    assert signal.getsignal(number) is before


def test_a_terminal_that_is_gone_or_hangs_keeps_nobody_from_braking():
    full = "import os; r, w = os.pipe(); os.dup2(w, 2); os.set_blocking(2, False)\n"
    full += "while True:\n try: os.write(2, bytes(65536))\n except BlockingIOError: break\n"
    full += "os.set_blocking(2, True)\n"
    for ill in ("import os, sys; os.close(2); sys.stderr = None\n", full):
        program = [
            sys.executable,
            "-c",
            ill + LATE.replace("0.5", "0.5\nwatchdog.CLOSE_SECONDS = 3.0"),
        ]
        ended = subprocess.run(program, stdout=subprocess.PIPE, text=True, timeout=60)
        assert (ended.returncode, ended.stdout) == (2, "braked\n")
