"""Devices of one run: what is taken before they start, and given back however that ends."""

import os
from contextlib import ExitStack
from dataclasses import dataclass

import pytest

from renet.bundle import Bundle
from renet.deploy import devices
from renet.deploy.catalogue import ROBOTS
from renet.deploy.cfg import DeployCfg
from renet.deploy.robots.driver import DriverCfg
from renet.errors import RenetError

from .fakes import Standing


class Robot(Standing):
    """A driver that knows of no lock."""

    def __init__(self, bad: bool) -> None:
        super().__init__()
        self.bad, self.connected = bad, False

    def connect(self) -> None:
        self.connected = True
        if self.bad:
            raise RenetError("no answer")


@dataclass(frozen=True)
class RobotCfg(DriverCfg):
    port: str = "usb"
    bad: bool = False

    @property
    def address(self) -> str:
        return self.port

    def build(self, *given) -> Robot:
        return Robot(self.bad)


def test_no_driver_can_forget_the_lock_on_its_robot(monkeypatch):
    """A second program is refused before it connects; the lock ends with the first's devices."""
    kind = f"mine-{os.getpid()}"
    monkeypatch.setitem(ROBOTS, kind, RobotCfg)
    bundle, connected = Bundle.load(), []
    monkeypatch.setattr(Robot, "close", lambda robot: connected.append(robot), raising=False)

    def start(stack: ExitStack, **options) -> Robot:
        cfg = DeployCfg(robot=kind, driver=RobotCfg(**options), camera="none", dry_run=True)
        return devices.start_devices(cfg, bundle, print, stack)[0]

    with ExitStack() as first, ExitStack() as second:
        assert start(first).connected
        monkeypatch.setattr(Robot, "connect", lambda robot: pytest.fail("it was disturbed"))
        with pytest.raises(RenetError, match=rf"another program .* drives the {kind} usb: end it"):
            start(second)
        monkeypatch.undo()
        monkeypatch.setitem(ROBOTS, kind, RobotCfg)
        assert start(second, port="another").connected
    with pytest.raises(RenetError, match="no answer"), ExitStack() as third:
        start(third, bad=True)
    with ExitStack() as fourth:
        assert start(fourth).connected
