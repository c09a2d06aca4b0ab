"""The programs in docs/runtime.md run, and its tables say what the code does."""

import os
import re
import signal
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from renet import cli, descriptions
from renet.bundle import read_manifest, write_manifest
from renet.deploy import catalogue
from renet.deploy.cfg import DEADMAN, DeployCfg
from renet.deploy.main import deploy
from renet.deploy.recording.recorder import read_recording
from renet.deploy.safety.limits import SafetyCfg
from renet.descriptions import GO1
from renet.selector.monitors import MONITORS

from .fakes import state

PAGE = (Path(__file__).parents[2] / "docs" / "runtime.md").read_text()
PORT = f"usb{os.getpid()}"
"""Where no other process looks for a robot."""


def program(marker: str) -> str:
    """The Python block that holds a marker."""
    (found,) = [b for b in re.findall(r"```python\n(.*?)```", PAGE, re.S) if marker in b]
    return found


def newest() -> SimpleNamespace:
    """The reading of a robot that stands still, as the page's library gives it."""
    names = ("time", "q", "dq", "torque", "quaternion_wxyz", "gyro")
    return SimpleNamespace(**dict(zip(names, vars(state(time.monotonic())).values(), strict=False)))


@pytest.mark.parametrize("end", ["q", "Ctrl-C"])
def test_another_robot_in_a_page_until_it_ends(terminal, tmp_path, monkeypatch, bundle_path, end):
    """The page's program, then `renet deploy` with a bundle for its robot and somebody's hand."""
    link = Mock(newest=newest)

    def servo(position, stiffness, damping) -> None:
        if not stiffness.any():
            os.write(terminal, b"r" * (link.servo.call_count % 100 == 1))  # May come too early.
        elif end == "q":
            os.write(terminal, b"q")
        else:
            os.kill(os.getpid(), signal.SIGINT)

    link.servo.side_effect = servo
    monkeypatch.setitem(sys.modules, "my_sdk", SimpleNamespace(open=lambda port: link))
    monkeypatch.setitem(catalogue.ROBOTS, "mine", None)
    monkeypatch.setitem(descriptions.DESCRIPTIONS, "My robot", None)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_robot.xml").write_text(GO1.mjcf.read_text())
    manifest = read_manifest(bundle_path)
    robot = replace(manifest.robot, name="My robot")
    write_manifest(bundle_path, replace(manifest, robot=robot))
    exec(program("my_sdk"), {"__name__": "my_robot"})
    options = f"--robot mine --port {PORT} --camera none --teleop keyboard --out out"
    assert cli.main(["deploy", str(bundle_path), *options.split()]) == 0
    link.close.assert_called_once()
    stiff = [call.args[1].any() for call in link.servo.call_args_list]
    assert any(stiff), "it stood up"
    assert not stiff[-1], "it ends braking"
    run = read_recording(tmp_path / "out" / "recording.log")
    assert run.complete
    assert run.events[0].why == "armed"
    assert run.header["port"] == PORT
    body = program("my_sdk").split("class MyRobot:")[1].split("\n\n\n")[0]
    assert len(body.splitlines()) < 30


def test_reading_a_log(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    deploy(DeployCfg(seconds=0.2))
    exec(program("read_recording"), {})


@pytest.mark.parametrize("name", MONITORS)
def test_every_monitor_is_on_the_page(name):
    assert re.search(rf"\| `{name}` \|.*\| {MONITORS[name].reason} \|", PAGE)


def test_limits_are_the_codes():
    cfg = SafetyCfg()
    for name, value in (
        ("max_state_age", f"{1000 * cfg.max_state_age:.0f} ms"),
        ("max_tilt", f"{np.degrees(cfg.max_tilt):.0f}°"),
        ("joint_margin", f"{cfg.joint_margin:g} rad"),
        ("max_stand_up_error", f"{cfg.max_stand_up_error:g} rad"),
        ("max_gap", f"{cfg.max_gap:g} s"),
        ("max_late", f"{cfg.max_late}"),
        ("target_rate", f"{cfg.target_rate:.0f} rad/s"),
    ):
        assert f"`{name}` {value}" in PAGE
    assert f"{DEADMAN:g} s with a real robot" in PAGE
