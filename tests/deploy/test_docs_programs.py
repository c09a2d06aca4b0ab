"""The programs on the documentation's pages run, and its tables say what the code does."""

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

from renet import cli
from renet.bundle import read_manifest, write_manifest
from renet.deploy import catalogue
from renet.deploy.cfg import DEADMAN, DeployCfg
from renet.deploy.main import deploy
from renet.deploy.recording.reader import read_recording
from renet.deploy.safety.limits import SafetyCfg
from renet.robots import GO1, robot
from renet.selector.monitors import MONITORS

from .fakes import state

pytestmark = pytest.mark.wall_clock

DOCS = Path(__file__).parents[2] / "docs"
PAGES = {name: (DOCS / f"{name}.md").read_text() for name in ("deploy", "memory", "robots")}
PORT = f"usb{os.getpid()}"
"""Where no other process looks for a robot."""


def program(page: str, marker: str) -> str:
    """The Python block of a page that holds a marker."""
    (block,) = [b for b in re.findall(r"```python\n(.*?)```", PAGES[page], re.S) if marker in b]
    return block


def newest() -> SimpleNamespace:
    """The reading of a robot that stands still, as the page's library gives it."""
    names = ("time", "q", "dq", "torque", "quaternion_wxyz", "gyro")
    return SimpleNamespace(**dict(zip(names, vars(state(time.monotonic())).values(), strict=False)))


@pytest.fixture
def package(tmp_path, monkeypatch) -> None:
    """The page's driver where Python finds it, and one that does not load."""
    info = tmp_path / "mine-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[renet.robots]\na = no_such_module\nb = my_robot\n")
    (tmp_path / "my_robot.py").write_text(program("robots", "my_sdk"))
    (tmp_path / "my_robot.xml").write_text(GO1.mjcf.read_text())
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "my_robot", raising=False)
    for table, name in ((catalogue.ROBOTS, "mine"), (robot._ROBOTS, "My robot")):
        monkeypatch.setitem(table, name, None)  # Taken out again at the end.


@pytest.mark.usefixtures("package")
@pytest.mark.parametrize("end", ["q", "Ctrl-C"])
def test_a_driver_of_a_package_runs_until_it_ends(terminal, monkeypatch, bundle_path, end, capsys):
    """With a bundle for its robot, and somebody at the keyboard."""
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
    manifest = read_manifest(bundle_path)
    write_manifest(bundle_path, replace(manifest, robot=replace(manifest.robot, name="My robot")))
    options = f"--robot mine --port {PORT} --camera none --teleop keyboard --out out"
    assert cli.main(["deploy", str(bundle_path), *options.split()]) == 0
    told = capsys.readouterr().err
    assert "cannot use no_such_module" in told
    assert "my_robot" not in told
    link.close.assert_called_once()
    stiff = [call.args[1].any() for call in link.servo.call_args_list]
    assert any(stiff), "it stood up"
    assert not stiff[-1], "it ends braking"
    run = read_recording(Path("out") / "recording.mcap")
    assert run.complete
    assert run.events[0].why == "armed"
    assert run.header["port"] == PORT


def test_reading_a_log(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    deploy(DeployCfg(seconds=0.2))
    exec(program("deploy", "read_recording"), {})


@pytest.mark.parametrize("name", MONITORS)
def test_every_monitor_is_on_the_page(name):
    assert re.search(rf"\| `{name}` \|.*\| {MONITORS[name].reason} \|", PAGES["memory"])


def test_limits_are_the_codes():
    cfg = SafetyCfg()
    for words in (
        f"`max_state_age` {1000 * cfg.max_state_age:.0f} ms",
        f"`max_tilt` {np.degrees(cfg.max_tilt):.0f}°",
        f"`joint_margin` {cfg.joint_margin:g} rad",
        f"`max_stand_up_error` {cfg.max_stand_up_error:g} rad",
        f"`max_gap` {cfg.max_gap:g} s",
        f"`max_late` {cfg.max_late}",
        f"`target_rate` {cfg.target_rate:.0f} rad/s",
        f"After {DEADMAN:g} s without a key",
    ):
        assert words in PAGES["deploy"]
