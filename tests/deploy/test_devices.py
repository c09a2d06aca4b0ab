"""Devices of one run: what is taken before they start, and given back however that ends."""

import os
import threading
from contextlib import ExitStack, nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pytest

from renet.bundle import Bundle
from renet.deploy import devices
from renet.deploy.catalogue import RealSenseCfg, SimCameraCfg
from renet.deploy.cfg import DEADMAN, DeployCfg
from renet.deploy.checklist import Checklist
from renet.deploy.main import deploy
from renet.deploy.robots.base import DriverCfg
from renet.deploy.teleop.gamepad import GamepadTeleop
from renet.deploy.teleop.keyboard import KeyboardTeleop
from renet.errors import RenetError
from renet.folders import lock

from .fakes import Standing

pytestmark = pytest.mark.wall_clock

CONNECTED: list[str] = []
"""Ports that drivers have connected to."""


class Robot(Standing):
    """A driver that knows of no lock."""

    def connect(self) -> None:
        CONNECTED.append(self.port)
        if self.port == "dead":
            raise RenetError("no answer")


@dataclass(frozen=True)
class RobotCfg(DriverCfg):
    port: str

    @property
    def address(self) -> str:
        return self.port

    def build(self, *_) -> Robot:
        robot = Robot()
        robot.port = self.port
        return robot


def test_no_driver_can_forget_the_lock_on_its_robot():
    """A second program is refused before it connects; the lock ends with the first's devices."""
    kind, bundle = f"mine-{os.getpid()}", Bundle.load()

    def start(stack: ExitStack, port: str) -> None:
        cfg = DeployCfg(robot=kind, robot_cfg=RobotCfg(port), camera="none", dry_run=True)
        devices.start_devices(cfg, bundle, print, stack, Checklist(print, patience=False))

    with ExitStack() as first, ExitStack() as second:
        start(first, "usb")
        with pytest.raises(RenetError, match=rf"another program .* drives the {kind} usb: end it"):
            start(second, "usb")
        start(second, "another")
        assert CONNECTED == ["usb", "another"]
    for port in ("dead", "dead", "usb"):
        with suppress(RenetError) if port == "dead" else nullcontext(), ExitStack() as stack:
            start(stack, port)
    assert CONNECTED[2:] == ["dead", "dead", "usb"]


@pytest.mark.parametrize("taken", [True, False])
def test_a_folder_that_cannot_be_used_is_refused_before_the_robot_is_touched(tmp_path, taken):
    driver, before = RobotCfg("serial"), len(CONNECTED)
    out = tmp_path if taken else Path("/proc/nowhere")
    cfg = DeployCfg(
        robot="mine", robot_cfg=driver, camera="none", dry_run=True, out=out, seconds=0.1
    )
    with lock(tmp_path), pytest.raises(RenetError, match=r"(program writes|cannot write) to"):
        deploy(cfg)
    assert len(CONNECTED) == before


@pytest.mark.parametrize(
    ("teleop", "device"), [("keyboard", KeyboardTeleop), ("joystick", GamepadTeleop)]
)
def test_the_deadman_reaches_the_operators_device(monkeypatch, teleop, device):
    monkeypatch.setattr(device, "__init__", lambda self, deadman: setattr(self, "given", deadman))
    for deadman, given in ((2.5, 2.5), (None, DEADMAN)):
        made = devices.make_teleop(
            DeployCfg(robot="go1", teleop=teleop, deadman=deadman), "heading"
        )
        assert (type(made), made.given) == (device, given)


@pytest.mark.parametrize("device", [KeyboardTeleop, GamepadTeleop])
def test_only_what_the_policy_follows_is_offered(monkeypatch, capsys, device):
    monkeypatch.setattr(device, "__init__", lambda self, deadman: None)
    name = {KeyboardTeleop: "keyboard", GamepadTeleop: "joystick"}[device]
    offers = {}
    for told in ("heading", "twist"):
        devices.make_teleop(DeployCfg(teleop=name), told)
        offers[told] = capsys.readouterr().out
    for words in ("sideways", "backward"):
        assert words in offers["twist"]
        assert words not in offers["heading"]
    assert "turn" in offers["heading"]


def test_faults_begin_with_the_run_not_with_the_wait_for_a_first_image(monkeypatch):
    camera = SimpleNamespace(start=lambda: None, latest=iter([None, None, "image"]).__next__)
    robot = SimpleNamespace(connect=lambda: None, now=lambda: 0.0, read=lambda: None)
    monkeypatch.setattr(devices, "make_robot", lambda *given: robot)
    monkeypatch.setattr(RealSenseCfg, "build", lambda *given: camera)
    pressed = []
    teleop = SimpleNamespace(drain=pressed.append)
    monkeypatch.setattr(devices, "make_teleop", lambda *given: teleop)
    cfg = DeployCfg(robot="go1", fault=("blackout@5s",), teleop="keyboard")
    _, faulty, *_ = devices.start_devices(
        cfg, Bundle.load(), print, ExitStack(), Checklist(print, patience=False)
    )
    assert faulty._begun is None
    assert pressed, "keys of that time are taken, so that they cannot arm later"


def test_devices_are_closed_robot_first_even_after_half_a_start(tmp_path, monkeypatch):
    closed = []

    def refuse() -> None:
        raise RenetError("the camera does not start")

    def part(name: str) -> SimpleNamespace:
        close = partial(closed.append, name)
        return SimpleNamespace(connect=lambda: None, start=refuse, close=close)

    for name in ("robot", "teleop"):
        monkeypatch.setattr(devices, f"make_{name}", lambda *_, name=name: part(name))
    monkeypatch.setattr(SimCameraCfg, "build", lambda *_: part("camera"))
    with pytest.raises(RenetError, match="does not start"):
        deploy(DeployCfg(out=tmp_path / "out"))
    assert closed == ["robot", "camera", "teleop"]
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("way", ["raises", "hangs", "works"])
def test_a_device_that_cannot_be_closed_costs_neither_score_nor_program(monkeypatch, way):
    monkeypatch.setattr(devices, "CLOSE_TIMEOUT", 0.2)
    never, said = threading.Event(), []

    class Camera:
        def close(self) -> None:
            if way == "raises":
                raise RuntimeError("the cable is gone")
            if way == "hangs":
                never.wait()

    devices.close_device(Camera(), said.append)
    told = {
        "raises": ["Camera cannot be closed: the cable is gone"],
        "hangs": ["Camera does not close within 0.2 s"],
        "works": [],
    }
    assert said == told[way]
    never.set()
