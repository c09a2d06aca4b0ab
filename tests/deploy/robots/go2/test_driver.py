"""`renet deploy --robot go2` and `renet simulate`: the whole program, in processes of its own."""

import os
import pty
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="needs renet-locomotion[go2]")

from renet import cli
from renet.deploy.catalogue import Go2Cfg, Ros2Cfg, SimulationCfg
from renet.deploy.cfg import DeployCfg
from renet.deploy.dds import requirements
from renet.deploy.main import deploy
from renet.deploy.recording.reader import read_recording
from renet.deploy.robots.go2.driver import go2_robot
from renet.deploy.safety.limits import SafetyCfg
from renet.errors import RenetError

from ...dds.domain import free_domain
from ...fakes import until

pytestmark = pytest.mark.wall_clock

PATIENT = SafetyCfg(max_gap=9.0, max_state_age=9.0, max_late=999, joint_margin=9.0)
"""How late a step is depends on how busy the computer is."""


def options(**changes) -> list[str]:
    """Of a run whose deadlines a busy computer keeps."""
    safety = {f"safety.{name.replace('_', '-')}": v for name, v in vars(PATIENT).items()}
    given = {"robot": "go2", "interface": "lo", "domain": free_domain(), "camera": "none"}
    return [f"--{name}={value}" for name, value in (safety | given | changes).items()]


@pytest.fixture
def keyboard(go2_bundle, tmp_path) -> Iterator[tuple[subprocess.Popen, int]]:
    """A program that drives the robot, and the terminal it reads."""
    terminal, theirs = pty.openpty()
    command = [sys.executable, "-m", "renet", "deploy", str(go2_bundle), "--teleop=keyboard"]
    streams = {"stdin": theirs, "stdout": theirs, "stderr": theirs}
    run = subprocess.Popen([*command, *options(out=tmp_path)], **streams)
    os.close(theirs)
    yield run, terminal
    run.kill()
    run.wait()
    os.close(terminal)


def test_a_keyboard_lets_a_robot_stand_up_and_end_braked(served, keyboard, tmp_path):
    """Untrained networks: it need not walk well, or far."""
    run, terminal = keyboard
    until(lambda: bool(served.commands))  # It is held where it lies.
    assert served.mode == ""
    until(lambda: served.braked)

    def rise() -> None:
        os.write(terminal, b"r")
        time.sleep(1.5)  # A key counts as released after a second.

    # It is held stiffly from the release on, so that only its height tells.
    until(lambda: served.data.qpos[2] > 0.2, rise)
    os.write(terminal, b"q")
    with suppress(OSError):  # Nobody writes any more.
        while os.read(terminal, 10_000):
            pass
    assert run.wait(10) == 0
    until(lambda: served.braked)
    assert served.wrong == served.refused == 0
    recording = read_recording(tmp_path / "recording.mcap")
    assert "standing_up" in [event.what for event in recording.events]
    assert recording.header["interface"] == "lo"


def test_a_dry_run_reads_the_robot_and_leaves_its_own_mode_alone(served, go2_bundle, tmp_path):
    device = Go2Cfg("lo", free_domain())
    cfg = DeployCfg(
        go2_bundle, "go2", robot_cfg=device, camera="none", dry_run=True, out=tmp_path, seconds=0.5
    )
    deploy(cfg)
    assert served.mode == "normal"
    assert served.commands == []
    ticks = read_recording(tmp_path / "recording.mcap").ticks
    np.testing.assert_allclose(ticks["joint_position"][-1][2::3], -2.65, atol=0.1)


def test_a_go2_bundle_walks_in_simulation_on_its_own_body(go2_bundle, tmp_path):
    """The joints' targets are its own default pose, and its trunk is as high as a Go2's."""
    scene = SimulationCfg(terrain="stairs")
    cfg = DeployCfg(go2_bundle, robot_cfg=scene, out=tmp_path, seconds=2.0, fault=("blackout@1s",))
    deploy(cfg)
    ticks = read_recording(tmp_path / "recording.mcap").ticks
    np.testing.assert_allclose(ticks["position"][95][2::3], -1.8, atol=0.01)
    sag = ticks["base_position"][0][2] - ticks["base_position"][95][2]
    assert 0.0 < sag < 0.1


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"interface": ""}, "--robot go2 needs --interface, its network card: one of lo"),
        ({"interface": "eth77"}, "no network interface 'eth77' here, only lo"),
    ],
)
def test_a_wrong_interface_is_one_line(go2_bundle, tmp_path, capsys, changes, why):
    arguments = options(**changes, out=tmp_path, teleop="auto")
    assert cli.main(["deploy", str(go2_bundle), "--dry-run", *arguments]) == 2
    assert why in capsys.readouterr().err


def test_a_bundle_of_another_robot_is_refused(bundle_path):
    with pytest.raises(RenetError, match="drives a Unitree Go1, --robot go2 is a Unitree Go2"):
        deploy(DeployCfg(bundle_path, "go2", robot_cfg=Go2Cfg("lo"), camera="none", dry_run=True))


def test_a_robot_that_keeps_its_mode_is_refused_before_anything_is_commanded(served):
    served.stubborn = True
    with pytest.raises(RenetError, match="the robot's mode 'normal' does not end"):
        go2_robot("lo", free_domain(), timeout=60.0).connect()
    assert served.commands == []
    assert served.refused == 0


def test_without_cyclone_dds_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setattr(requirements, "find_spec", lambda name: None)
    with pytest.raises(RenetError, match=r"pip install .* -e '\.\[go2\]'"):
        go2_robot("lo")
    with pytest.raises(RenetError, match=r"^--teleop ros2 needs Cyclone DDS: "):
        Ros2Cfg().check()


def test_a_simulated_robot_in_a_process_of_its_own_is_found_and_released():
    command = [sys.executable, "-m", "renet", "simulate", f"--domain={free_domain()}"]
    run = subprocess.Popen([*command, "--seconds=30"], stdout=subprocess.PIPE, text=True)
    robot = go2_robot("lo", free_domain(), timeout=30.0, sink=0.1)
    robot.connect()
    assert robot.read().battery == pytest.approx(0.81)
    robot.close()
    run.send_signal(2)
    output = run.communicate(timeout=30)[0]
    assert run.returncode == 0
    assert "a Go2 lies on 'flat', interface lo" in output
    assert "with a wrong CRC 0, refused in one of its own modes 0" in output
