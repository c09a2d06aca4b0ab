"""`renet deploy` as a stranger runs it, and everything that must end it braked and logged."""

import json
import math
import os
import signal
import sys
import threading
import xml.etree.ElementTree as ET
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from renet import cli
from renet.bundle import Bundle, read_manifest, write_manifest
from renet.deploy import devices
from renet.deploy.main import DEADMAN, RECORDING, DeployCfg, _interruptible, deploy
from renet.deploy.recording import MODES, Recording, read_recording
from renet.deploy.replay import mismatch
from renet.deploy.robots.mujoco import MujocoRobot
from renet.deploy.safety import Mode, SafetyCfg
from renet.deploy.score import SCORE, TIMELINE
from renet.deploy.teleop import ScriptedTeleop, TeleopCommand
from renet.errors import RenetError

QUICK = SafetyCfg(stand_up_seconds=0.5)


def run(out: Path, **options) -> Recording:
    """A run that stands up quickly, read back."""
    cfg = DeployCfg(out=out, **({"safety": QUICK, "seconds": 1.5} | options))
    return read_recording(deploy(cfg) / RECORDING)


def braked_at_the_end(flight: Recording) -> bool:
    ticks = flight.ticks[-25:]
    return bool((ticks["mode"] == MODES.index(Mode.DAMPING)).all() and not ticks["stiffness"].any())


def test_out_of_the_box_it_walks_on_and_switches_within_a_fifth_of_a_second(tmp_path, capsys):
    arguments = "deploy --robot mujoco --camera sim --terrain stairs --fault blackout@5s"
    assert cli.main([*arguments.split(), "--seconds", "8", "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    for words in ("standing_up: armed", "walking: stood up", "op: the image is"):
        assert words in out
    score = json.loads((tmp_path / SCORE).read_text())
    assert score["falls"] == 0
    assert score["complete"]
    assert score["distance_from"] == "simulator"
    assert score["distance_m"] > 2.0
    assert score["walking_seconds"] == pytest.approx(6.0, abs=0.1)
    (delay,) = score["switch_delay_s"]
    assert 0.0 < delay <= 0.2
    assert ET.parse(tmp_path / TIMELINE)
    flight = read_recording(tmp_path / RECORDING)
    assert braked_at_the_end(flight)
    assert mismatch(flight, Bundle.load()) == 0.0
    assert [event.why for event in flight.events][-1] == "the run ends"


def test_the_papers_selector_is_told_to_the_log(tmp_path):
    flight = run(tmp_path, selector="paper", fault=("gaussian@1",))
    beta = Bundle.load().manifest.selector.beta
    assert flight.header["selector"] == "paper"
    assert flight.header["beta"] == beta
    assert flight.events[-2].why == "images unlike those of training"
    assert mismatch(flight, Bundle.load()) == 0.0


def test_a_dry_run_prints_commands_and_never_moves_the_robot(tmp_path, capsys, monkeypatch):
    written = []
    real = MujocoRobot.write
    monkeypatch.setattr(MujocoRobot, "write", lambda s, c: (written.append(c), real(s, c)))
    run(tmp_path, dry_run=True)
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
    assert braked_at_the_end(run(tmp_path, seconds=None))
    score = json.loads((tmp_path / SCORE).read_text())
    assert score["complete"]
    assert score["seconds"] == pytest.approx(1.5, abs=0.05)
    assert (tmp_path / TIMELINE).exists()


def test_a_fall_ends_a_flight_that_nobody_steers(tmp_path):
    flight = run(tmp_path, safety=replace(QUICK, max_tilt=0.02), seconds=60.0)
    assert len(flight.ticks) < 500
    assert flight.events[-1].why.startswith("tilted")


def test_a_flight_never_overwrites_another(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["deploy", "--seconds", "0.1"]) == 0
    (log,) = Path("results/deploy").glob("*/recording.log")
    assert f"Results: {log.parent}\n" in capsys.readouterr().out
    out = Path("mine")
    flights = [run(out, seconds=seconds) for seconds in (0.1, 0.2, 0.3)]
    folders = (out / "earlier-1", out / "earlier-2", out)
    kept = [read_recording(folder / RECORDING) for folder in folders]
    assert [len(f.ticks) for f in kept] == [len(f.ticks) for f in flights]
    assert (out / "earlier-2" / TIMELINE).exists()


@pytest.mark.parametrize(
    ("options", "live", "length", "operator_timeout"),
    [
        ({}, False, 15.0, math.inf),
        ({"teleop": "keyboard"}, True, math.inf, math.inf),
        ({"teleop": "joystick", "seconds": 3.0}, True, 3.0, math.inf),
        ({"robot": "go1", "teleop": "joystick"}, True, math.inf, DEADMAN),
        ({"robot": "go1", "deadman": 2.0}, True, 15.0, 2.0),
    ],
)
def test_who_steers_decides_on_clock_end_and_deadman(options, live, length, operator_timeout):
    cfg = DeployCfg(**options)
    assert (cfg.live, cfg.length, cfg.operator_timeout) == (live, length, operator_timeout)


def test_the_go1s_address_and_power_level_are_options():
    cfg = DeployCfg(robot="go1", camera="none", robot_host="10.0.0.1", power_level=5, dry_run=True)
    robot, _ = devices.make_robot(cfg, Bundle.load(), print)
    assert robot._address == ("10.0.0.1", 8007, 8080, 5)  # type: ignore[attr-defined]


def test_real_time_flies_on_the_threads_and_replays(tmp_path):
    assert mismatch(run(tmp_path, real_time=True), Bundle.load()) == 0.0


def test_a_fault_of_the_scene_is_seen_from_its_onset(tmp_path):
    clear = run(tmp_path / "a").images
    seen = run(tmp_path / "b", fault=("foam@1s",)).images
    np.testing.assert_array_equal(seen[45], clear[45])
    nearer = clear[50].astype(float) - seen[50]
    assert np.median(nearer[24:]) > 0.03


def test_the_replay_camera_shows_a_flights_images(tmp_path):
    a = run(tmp_path / "a")
    b = run(tmp_path / "b", camera="replay", recording=tmp_path / "a" / RECORDING)
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
        ("--out /dev/null", "cannot write to /dev/null"),
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


def test_a_missing_viewer_is_named(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "mjviser", None)
    assert cli.main(["deploy", "--viewer", "--out", str(tmp_path)]) == 2
    assert "pip install mjviser" in capsys.readouterr().err


@pytest.mark.parametrize("teleop", ["keyboard", "joystick"])
def test_the_deadman_reaches_the_operators_device(monkeypatch, teleop):
    given = []
    for name in ("KeyboardTeleop", "JoystickTeleop"):
        monkeypatch.setattr(devices, name, lambda deadman: given.append(deadman))
    for deadman in (2.5, None):
        devices.make_teleop(DeployCfg(robot="go1", teleop=teleop, deadman=deadman))
    assert given == [2.5, DEADMAN]


def test_faults_begin_with_the_run_not_with_the_wait_for_a_first_image(monkeypatch):
    camera = SimpleNamespace(start=lambda: None, latest=iter([None, None, "image"]).__next__)
    robot = SimpleNamespace(connect=lambda: None, now=lambda: 0.0)
    monkeypatch.setattr(devices, "make_robot", lambda *given: (robot, lambda: None))
    monkeypatch.setattr(devices, "make_camera", lambda *given: camera)
    pressed = []
    teleop = SimpleNamespace(command=pressed.append)
    monkeypatch.setattr(devices, "make_teleop", lambda cfg: teleop)
    cfg = DeployCfg(robot="go1", fault=("blackout@5s",), teleop="keyboard")
    _, faulty, *_ = devices.start_devices(cfg, Bundle.load(), print, ExitStack())
    assert faulty._begun is None
    assert pressed, "keys of that time are taken, so that they cannot arm later"


def test_devices_are_closed_robot_first_even_after_half_a_start(tmp_path, monkeypatch):
    closed = []

    def refuse() -> None:
        raise RenetError("the camera does not start")

    def part(name: str) -> SimpleNamespace:
        close = partial(closed.append, name)
        return SimpleNamespace(connect=lambda: None, start=refuse, close=close)

    made = {"robot": (part("robot"), lambda: None), "camera": part("camera")}
    for name, device in (made | {"teleop": part("teleop")}).items():
        monkeypatch.setattr(devices, f"make_{name}", lambda *_, device=device: device)
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
    run(tmp_path, dry_run=True)
    assert printed
    assert not any(printed)
