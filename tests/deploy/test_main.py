"""`renet deploy` as a stranger runs it, and everything that must end it braked and logged."""

import json
import os
import signal
import sys
import threading
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from renet import cli
from renet.deploy import devices
from renet.deploy.bundle import Bundle, read_manifest, write_manifest
from renet.deploy.main import DEADMAN, RECORDING, DeployCfg, _interruptible, deploy
from renet.deploy.recording import MODES, read_recording
from renet.deploy.replay import mismatch
from renet.deploy.robots.mujoco import MujocoRobot
from renet.deploy.safety import Mode, SafetyCfg
from renet.deploy.score import SCORE, TIMELINE
from renet.deploy.teleop import ScriptedTeleop, TeleopCommand
from renet.errors import RenetError

QUICK = SafetyCfg(stand_up_seconds=0.5)


def braked_at_the_end(path: Path) -> bool:
    ticks = read_recording(path / "recording.log").ticks[-25:]
    return bool((ticks["mode"] == MODES.index(Mode.DAMPING)).all() and not ticks["stiffness"].any())


def test_out_of_the_box_it_walks_on_and_switches_within_a_fifth_of_a_second(tmp_path, capsys):
    arguments = "deploy --robot mujoco --camera sim --terrain stairs --fault blackout@5s"
    assert cli.main([*arguments.split(), "--seconds", "8", "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert all(
        word in out for word in ("standing_up: armed", "walking: stood up", "op: the image is")
    )
    score = json.loads((tmp_path / SCORE).read_text())
    assert score["falls"] == 0
    assert score["complete"]
    assert score["distance_from"] == "simulator"
    assert score["distance_m"] > 2.0
    assert score["walking_seconds"] == pytest.approx(6.0, abs=0.1)
    (delay,) = score["switch_delay_s"]
    assert 0.0 < delay <= 0.2
    assert ET.parse(tmp_path / TIMELINE)
    flight = read_recording(tmp_path / "recording.log")
    assert braked_at_the_end(tmp_path)
    assert mismatch(flight, Bundle.load()) == 0.0
    assert [event.why for event in flight.events][-1] == "the run ends"


def test_the_papers_selector_is_told_to_the_log(tmp_path):
    cfg = DeployCfg(
        out=tmp_path, selector="paper", safety=QUICK, seconds=1.5, fault=("gaussian@1",)
    )
    flight = read_recording(deploy(cfg) / "recording.log")
    beta = Bundle.load().manifest.selector.beta
    assert flight.header["selector"] == "paper"
    assert flight.header["beta"] == beta
    assert flight.events[-2].why == "images unlike those of training"
    assert mismatch(flight, Bundle.load()) == 0.0


def test_a_dry_run_prints_commands_and_never_moves_the_robot(tmp_path, capsys, monkeypatch):
    written = []
    real = MujocoRobot.write
    monkeypatch.setattr(MujocoRobot, "write", lambda s, c: (written.append(c), real(s, c)))
    cfg = DeployCfg(out=tmp_path, dry_run=True, seconds=1.5, safety=QUICK)
    deploy(cfg)
    assert len(written) == 1, "limp, before the flight"
    assert not written[0].stiffness.any()
    out = capsys.readouterr().out
    assert "FR_hip" in out
    assert "(Kp 40)" in out
    assert "walking: stood up" in out


@pytest.mark.parametrize("name", ["INT", "TSTP", "QUIT", "TERM", "HUP", "USR1", "USR2"])
def test_a_signal_asks_the_run_to_end(name):
    number = signal.Signals[f"SIG{name}"]
    before = signal.getsignal(number)
    with _interruptible() as asked:
        assert not asked()
        os.kill(os.getpid(), number)
        assert asked()
    assert signal.getsignal(number) is before


def test_a_signal_brakes_and_saves_everything(tmp_path, monkeypatch):
    class Impatient(ScriptedTeleop):
        def command(self, now: float) -> TeleopCommand:
            if abs(now - 1.0) < 0.001:
                os.kill(os.getpid(), signal.SIGTSTP)
            return super().command(now)

    monkeypatch.setattr(devices, "ScriptedTeleop", Impatient)
    deploy(DeployCfg(out=tmp_path, safety=QUICK))
    assert braked_at_the_end(tmp_path)
    score = json.loads((tmp_path / SCORE).read_text())
    assert score["complete"]
    assert score["seconds"] == pytest.approx(1.5, abs=0.05)
    assert (tmp_path / TIMELINE).exists()


def test_a_fall_ends_a_flight_that_nobody_steers(tmp_path):
    tight = replace(QUICK, max_tilt=0.02)
    deploy(DeployCfg(out=tmp_path, safety=tight, seconds=60.0))
    score = json.loads((tmp_path / SCORE).read_text())
    assert score["seconds"] < 10.0
    assert score["events"][-1]["why"].startswith("tilted")


def test_a_flight_never_overwrites_another(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["deploy", "--seconds", "0.1"]) == 0
    (log,) = Path("results/deploy").glob("*/recording.log")
    assert f"Results: {log.parent}\n" in capsys.readouterr().out
    out = Path("mine")
    flights = [
        read_recording(deploy(DeployCfg(out=out, seconds=s)) / RECORDING) for s in (0.1, 0.2, 0.3)
    ]
    kept = [
        read_recording(folder / RECORDING) for folder in (out / "earlier-1", out / "earlier-2", out)
    ]
    assert [len(f.ticks) for f in kept] == [len(f.ticks) for f in flights]
    assert (out / "earlier-2" / TIMELINE).exists()


def test_a_real_robots_operator_must_show_signs_of_life():
    assert DeployCfg(robot="go1").operator_timeout == DEADMAN
    assert DeployCfg(robot="go1", deadman=2.0).operator_timeout == 2.0
    assert DeployCfg(teleop="keyboard").operator_timeout == float("inf")


def test_the_go1s_address_and_power_level_are_options():
    cfg = DeployCfg(robot="go1", camera="none", robot_host="10.0.0.1", power_level=5, dry_run=True)
    robot = devices.make_devices(cfg, Bundle.load(), print).robot
    assert robot._address == ("10.0.0.1", 8007, 8080, 5)  # type: ignore[attr-defined]


def test_operators_fly_in_real_time_and_without_an_end():
    assert DeployCfg().length == 15.0
    assert not DeployCfg().live
    assert DeployCfg(teleop="keyboard").length == float("inf")
    assert DeployCfg(teleop="keyboard").live
    assert DeployCfg(teleop="joystick", seconds=3.0).length == 3.0
    assert DeployCfg(robot="go1", teleop="joystick").live


def test_real_time_flies_on_the_threads_and_replays(tmp_path):
    deploy(DeployCfg(out=tmp_path, real_time=True, seconds=1.5, safety=QUICK))
    flight = read_recording(tmp_path / "recording.log")
    assert mismatch(flight, Bundle.load()) == 0.0


def test_a_fault_of_the_scene_is_seen_from_its_onset(tmp_path):
    cfg = DeployCfg(out=tmp_path / "a", seconds=1.5, safety=QUICK)
    clear = read_recording(deploy(cfg) / "recording.log").images
    foam = replace(cfg, out=tmp_path / "b", fault=("foam@1s",))
    seen = read_recording(deploy(foam) / "recording.log").images
    np.testing.assert_array_equal(seen[45], clear[45])
    nearer = clear[50].astype(float) - seen[50]
    assert np.median(nearer[24:]) > 0.03


def test_the_replay_camera_shows_a_flights_images(tmp_path):
    deploy(DeployCfg(out=tmp_path / "a", seconds=1.5, safety=QUICK))
    source = tmp_path / "a" / "recording.log"
    again = DeployCfg(
        out=tmp_path / "b", seconds=1.5, camera="replay", recording=source, safety=QUICK
    )
    deploy(again)
    a, b = read_recording(source), read_recording(tmp_path / "b" / "recording.log")
    # The second camera spoke first in the same control step: same image, same step.
    for row, image in a.images.items():
        np.testing.assert_array_equal(b.images[row], image)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("--seconds 0", "--seconds must be positive"),
        ("--seed -1", "--seed must not be negative"),
        ("--speed 1.5", "--speed must be from 0 to 1 m/s"),
        ("--speed nan", "--speed must be from 0 to 1 m/s"),
        ("--safety.max-tilt 45", "max_tilt is in rad"),
        ("--deadman 0", "--deadman must be positive"),
        ("--robot go1 --dry-run --power-level 11", "power level must be 1 to 10"),
        ("--fault lightning@5", "lightning"),
        ("--fault blackout", "cannot read the fault 'blackout'"),
        ("--fault blackout:9@1s", "choose 1 to 5"),
        ("--fault glass@1s", "nothing that could be glass"),
        ("--fault blackout@1s --camera none", "needs a camera to spoil"),
        ("--camera replay", "needs --recording"),
        ("--camera replay --recording nowhere", "cannot read the recording nowhere"),
        ("--robot go1", "needs --teleop keyboard or joystick, or --dry-run"),
        ("--robot go1 --camera sim", "looks at a simulation"),
        ("--robot go1 --viewer --dry-run", "look at the robot"),
        ("--robot go1 --host 10.0.0.1 --dry-run", "the robot's is --robot-host"),
        ("--terrain lava", "unknown terrain 'lava': choose one of flat, stairs, rough, "),
        ("--scene nowhere.xml", "cannot read the scene nowhere.xml"),
        ("nowhere", "no bundle at nowhere"),
    ],
)
def test_mistakes_are_told_before_anything_moves(tmp_path, capsys, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["deploy", *arguments.split()]) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_another_robots_bundle_is_refused(tmp_path, bundle_path):
    manifest = read_manifest(bundle_path)
    write_manifest(bundle_path, replace(manifest, robot=replace(manifest.robot, name="Spot")))
    with pytest.raises(RenetError, match="drives a Spot"):
        deploy(DeployCfg(bundle=bundle_path, out=tmp_path))


@pytest.mark.parametrize(
    ("missing", "arguments", "hint"),
    [
        ("mujoco", "--robot mujoco", "pip install 'renet-locomotion[sim]'"),
        ("mjviser", "--viewer", "pip install mjviser"),
    ],
)
def test_missing_packages_are_named(tmp_path, capsys, monkeypatch, missing, arguments, hint):
    for name in [name for name in sys.modules if name.startswith("renet.deploy.robots.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, missing, None)
    assert cli.main(["deploy", *arguments.split(), "--out", str(tmp_path)]) == 2
    assert hint in capsys.readouterr().err


def test_a_results_folder_that_cannot_be_made_is_named(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert cli.main(["deploy", "--out", str(tmp_path / "file")]) == 2
    assert "cannot write the recording" in capsys.readouterr().err


@pytest.mark.parametrize("teleop", ["keyboard", "joystick"])
def test_the_deadman_reaches_the_operators_device(monkeypatch, teleop):
    given = []
    for name in ("KeyboardTeleop", "JoystickTeleop"):
        monkeypatch.setattr(
            f"renet.deploy.teleop.{name}", lambda deadman: given.append(deadman), raising=True
        )
    for deadman in (2.5, None):
        cfg = DeployCfg(robot="go1", camera="none", teleop=teleop, deadman=deadman)
        devices.make_devices(cfg, Bundle.load(), print)
    assert given == [2.5, DEADMAN]


def test_devices_are_closed_robot_first_even_after_half_a_start(tmp_path, monkeypatch):
    closed = []

    class Part:
        def __init__(self, name: str) -> None:
            self.name = name

        def connect(self) -> None:
            pass

        def start(self) -> None:
            raise RenetError("the camera does not start")

        def close(self) -> None:
            closed.append(self.name)

    parts = devices.Devices(Part("robot"), Part("camera"), Part("teleop"))  # type: ignore[arg-type]
    monkeypatch.setattr("renet.deploy.main.make_devices", lambda *arguments: parts)
    with pytest.raises(RenetError, match="does not start"):
        deploy(DeployCfg(out=tmp_path / "out"))
    assert closed == ["robot", "camera", "teleop"]
    assert not (tmp_path / "out").exists()


def test_nothing_is_printed_by_the_thread_that_drives_the_robot(tmp_path, monkeypatch):
    """A terminal may take for ever."""
    driving, printed = [], []
    wait = MujocoRobot.wait
    monkeypatch.setattr(MujocoRobot, "wait", lambda s, until: (driving.append(1), wait(s, until)))

    def show(*words, **options) -> None:
        if driving and not closed:
            printed.append(threading.current_thread() is threading.main_thread())

    closed = []
    monkeypatch.setattr(MujocoRobot, "close", lambda robot: closed.append(1))
    monkeypatch.setattr("builtins.print", show)
    deploy(DeployCfg(out=tmp_path, dry_run=True, seconds=1.5, safety=QUICK))
    assert printed
    assert not any(printed)
