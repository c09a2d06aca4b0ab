"""The list of a dry run: each step told with its time, all failures at once."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from renet import cli
from renet.bundle import Bundle
from renet.deploy import catalogue, checklist, devices
from renet.deploy.cfg import DeployCfg
from renet.deploy.checklist import Checklist, count_readings, time_models
from renet.deploy.dds import requirements
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
    assert time_models(bundle).endswith(" ms (allowed: 100000 ms)")
    monkeypatch.setattr(checklist, "CONTROL_DT", 1e-9)
    with pytest.raises(RenetError, match=r"19 of 20 at most .* \(allowed: 0 ms\): .* is busy"):
        time_models(bundle)


def test_a_busy_computer_is_told_and_the_joints_are_shown_all_the_same(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(checklist, "CONTROL_DT", 1e-9)
    monkeypatch.chdir(tmp_path)
    assert cli.main(["deploy", "--dry-run", "--camera", "none", "--seconds", "0.2"]) == 0
    lines = capsys.readouterr().out.splitlines()
    slow = next(n for n, line in enumerate(lines) if line.startswith("SLOW "))
    assert any("FR_hip" in line for line in lines[slow + 1 :])


def test_a_missing_terminal_hides_nothing_else(tmp_path, monkeypatch, capsys):
    """Robot and camera are tried, and the camera's fault is told beside it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "stdin", None)

    def start(*given):
        raise RenetError("no camera")

    monkeypatch.setattr(devices, "_start_camera", start)
    assert cli.main(["deploy", "--dry-run", "--teleop", "keyboard"]) == 2
    told = capsys.readouterr()
    marks = [line.split()[0] for line in told.out.splitlines()]
    assert marks[:4] == ["ok", "FAILED", "ok", "FAILED"]
    assert "2 things are in the way: (1) keyboard can steer: the operator's keys" in told.err
    assert told.err.endswith("(2) the camera sends images: no camera\n")


def test_a_go2_without_its_network_card_is_told_of_terminal_and_camera_too(monkeypatch, capsys):
    monkeypatch.setattr(sys, "stdin", None)
    monkeypatch.setattr(requirements, "find_spec", lambda name: True)
    closed = []

    class Camera:
        def start(self):
            raise RenetError("no RealSense is connected")

        def close(self):
            closed.append(self)

    monkeypatch.setattr(catalogue, "realsense", lambda: None)
    monkeypatch.setattr(catalogue, "RealSenseCamera", lambda *given, **options: Camera())
    command = ["deploy", "--robot", "go2", "--dry-run", "--teleop", "keyboard"]
    assert cli.main(command) == 2
    told = capsys.readouterr().err
    assert told.startswith("renet: 3 things are in the way: (1) --robot go2 needs --interface")
    assert "(2) the operator's keys need a terminal" in told
    assert told.endswith("(3) no RealSense is connected\n")
    assert len(closed) == 1
    assert cli.main([word for word in command if word != "--dry-run"]) == 2
    assert "things" not in capsys.readouterr().err, "a real run tries no device before its settings"


def test_a_go2_finds_its_bundle_and_lists_all_that_is_missing(monkeypatch):
    cfg = DeployCfg(robot="go2", dry_run=True)
    assert cfg.robot_cfg.bundle == "go2-parkour"
    monkeypatch.setattr(requirements, "find_spec", lambda name: None)

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
    monkeypatch.setattr(requirements, "find_spec", lambda name: True)
    driver_cfg = catalogue.Go2Cfg(interface="lo")
    cfg = DeployCfg(robot="go2", robot_cfg=driver_cfg, camera="none", dry_run=True)
    assert cfg.load_bundle().name == "go2-parkour"
    other = DeployCfg(
        "go1-parkour", robot="go2", robot_cfg=driver_cfg, camera="none", teleop="auto", seed=-1
    )
    with pytest.raises(RenetError, match=r"seed .*needs --teleop.*drives a Unitree Go1, --robot"):
        other.load_bundle()


def test_a_dry_run_tells_its_list(tmp_path, monkeypatch, capsys):
    # A busy computer is quick enough, too.
    monkeypatch.setattr(checklist, "CONTROL_DT", 100.0)
    monkeypatch.chdir(tmp_path)
    assert cli.main(["deploy", "--dry-run", "--camera", "sim", "--seconds", "0.2"]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("ok ")]
    for line, words in zip(
        lines,
        (
            "go1-parkour is whole",
            "auto can steer",
            "mujoco answers",
            "sends images",
            "quick enough: half of the steps",
        ),
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
