"""The programs in docs/runtime.md run, and its tables say what the code does."""

import os
import re
import signal
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

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


class Link:
    """A robot that stands still, remembers what it was told, and says when it lies or stands."""

    def __init__(self) -> None:
        self.told: list[np.ndarray] = []
        self.closed = False
        self.on_lying = self.on_standing = lambda: None

    def newest(self) -> SimpleNamespace:
        names = ("time", "q", "dq", "torque", "quaternion_wxyz", "gyro")
        reading = vars(state(time.monotonic())).values()
        return SimpleNamespace(**dict(zip(names, reading, strict=False)))

    def servo(self, position, stiffness, damping) -> None:
        self.told.append(stiffness)
        if stiffness.any():
            self.on_standing()
        elif len(self.told) % 100 == 1:
            self.on_lying()

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def link(tmp_path, monkeypatch) -> Link:
    """The page's robot, in a folder that holds its description."""
    link = Link()
    monkeypatch.setitem(sys.modules, "my_sdk", SimpleNamespace(open=lambda port: link))
    monkeypatch.setitem(catalogue.ROBOTS, "mine", None)
    monkeypatch.setitem(descriptions.DESCRIPTIONS, "My robot", None)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_robot.xml").write_text(GO1.mjcf.read_text())
    return link


@pytest.mark.parametrize("end", ["q", "Ctrl-C"])
def test_another_robot_in_a_page_until_it_ends(link, terminal, tmp_path, bundle_path, end):
    """The page's program, then `renet deploy` with a bundle for its robot and somebody's hand."""
    link.on_lying = lambda: os.write(terminal, b"r")  # Again: the first may come too early.
    interrupt = partial(os.kill, os.getpid(), signal.SIGINT)
    link.on_standing = interrupt if end == "Ctrl-C" else partial(os.write, terminal, b"q")
    manifest = read_manifest(bundle_path)
    robot = replace(manifest.robot, name="My robot")
    write_manifest(bundle_path, replace(manifest, robot=robot))
    exec(program("my_sdk"), {"__name__": "my_robot"})
    options = f"--robot mine --port {PORT} --camera none --teleop keyboard --out out"
    assert cli.main(["deploy", str(bundle_path), *options.split()]) == 0
    assert link.closed
    assert any(stiffness.any() for stiffness in link.told), "it stood up"
    assert not link.told[-1].any(), "it ends braking"
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
