"""The list of a dry run: each step told with its time, all failures at once."""

from types import SimpleNamespace

import numpy as np
import pytest

from renet import cli
from renet.bundle import Bundle
from renet.deploy import catalogue, checklist
from renet.deploy.cfg import DeployCfg
from renet.deploy.checklist import Checklist, count_readings, time_models
from renet.deploy.robots.go2 import driver
from renet.errors import Problems, RenetError, collected, demand_none


def test_every_step_is_told_and_every_failure_at_the_end():
    said = []
    steps = Checklist(said.append, patience=True)
    with steps.step("robot") as remarks:
        remarks.append("50 a second")
    for name in ("camera", "disk"):
        with steps.step(name):
            raise RenetError(f"no {name}: connect one")
    assert [line.split()[0] for line in said] == ["ok", "FAILED", "FAILED"]
    assert said[0].endswith(" s  robot: 50 a second")
    assert said[1].endswith(" s  camera: no camera: connect one")
    with pytest.raises(RenetError, match=r"2 things .*\(1\) camera: .*; \(2\) disk: no disk"):
        steps.finish()


def test_a_real_run_ends_with_its_first_failure_and_tells_nothing():
    said = []
    steps = Checklist(said.append, patience=False)
    with steps.step("robot"):
        pass
    with pytest.raises(RenetError, match=r"^no camera$"), steps.step("camera"):
        raise RenetError("no camera")
    steps.finish()
    assert said == []


class Robot:
    """Sends a reading every so many seconds of its clock."""

    def __init__(self, period: float) -> None:
        self.period, self.clock = period, 0.0

    def now(self) -> float:
        return self.clock

    def wait(self, until: float) -> None:
        self.clock = until

    def read(self):
        if self.period == np.inf:
            return None
        return SimpleNamespace(time=self.clock // self.period, battery=0.5)


def test_readings_are_counted_by_the_robots_clock():
    assert count_readings(Robot(0.01)) == "101 a second, battery 50%"
    for period, rate in ((0.05, "2[01]"), (np.inf, "0")):
        with pytest.raises(RenetError, match=rf"^{rate} readings a second, and at least 50"):
            count_readings(Robot(period))


def test_models_are_timed_against_a_control_step(monkeypatch):
    bundle = Bundle.load()
    monkeypatch.setattr(checklist, "CONTROL_DT", 100.0)
    assert time_models(bundle).count(" ms") == 2
    monkeypatch.setattr(checklist, "CONTROL_DT", 1e-9)
    with pytest.raises(RenetError, match="a control step has 0 ms: end other programs"):
        time_models(bundle)


def test_a_go2_finds_its_bundle_and_lists_all_that_is_missing(monkeypatch):
    cfg = DeployCfg(robot="go2", dry_run=True)
    assert cfg.driver.bundle == "go2-parkour"
    monkeypatch.setattr(driver, "find_spec", lambda name: None)

    def missing():
        raise RenetError("the camera needs its driver")

    monkeypatch.setattr(catalogue, "realsense", missing)
    monkeypatch.setattr("socket.if_nameindex", lambda: [(1, "lo"), (2, "eth0")])
    with pytest.raises(Problems) as told:
        cfg.load_bundle()
    first, second, third = told.value.problems
    assert first == "--robot go2 needs --interface, its network card: one of lo, eth0"
    assert second.startswith("the Go2 needs Cyclone DDS: ")
    assert third == "the camera needs its driver"


def test_a_go2_with_all_it_needs_loads_its_own_bundle(monkeypatch):
    monkeypatch.setattr(driver, "find_spec", lambda name: True)
    driver_cfg = catalogue.Go2Cfg(interface="lo")
    cfg = DeployCfg(robot="go2", driver=driver_cfg, camera="none", dry_run=True)
    assert cfg.load_bundle().name == "go2-parkour"
    other = DeployCfg(
        "go1-parkour", robot="go2", driver=driver_cfg, camera="none", teleop="auto", seed=-1
    )
    with pytest.raises(RenetError, match=r"seed .*needs --teleop.*drives a Unitree Go1, --robot"):
        other.load_bundle()


def test_a_dry_run_tells_its_list(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["deploy", "--dry-run", "--camera", "sim", "--seconds", "0.2"]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("ok ")]
    for line, words in zip(
        lines,
        ("go1-parkour is whole", "mujoco answers", "sends images", "quick enough: "),
        strict=True,
    ):
        assert words in line


def test_problems_within_problems_are_one_list():
    found: list[str] = []
    with collected(found):
        demand_none(["a", "b"])
    with collected(found):
        demand_none(["c"])
    with collected(found):
        demand_none([])
    assert found == ["a", "b", "c"]
