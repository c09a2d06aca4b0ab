"""`renet deploy` as a stranger runs it, and everything that must end it braked and logged."""

import io
import json
import math
import os
import signal
import sys
import threading
import xml.etree.ElementTree as ET
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import tyro

from renet import cli
from renet.bundle import Bundle, read_manifest, write_manifest
from renet.deploy import cfg, devices, main
from renet.deploy.catalogue import Go1Cfg, ReplayCfg, SimulationCfg
from renet.deploy.cfg import DEADMAN, DeployCfg
from renet.deploy.main import RECORDING, deploy
from renet.deploy.recording.reader import Recording, read_recording
from renet.deploy.recording.replay import replay_error
from renet.deploy.recording.score import SCORE, score_run, write_score
from renet.deploy.recording.tick import MODES
from renet.deploy.recording.timeline import TIMELINE
from renet.deploy.robots.sim.mujoco import MujocoRobot
from renet.deploy.safety.machine import Mode
from renet.deploy.teleop import gamepad
from renet.deploy.teleop.base import TeleopCommand
from renet.deploy.teleop.scripted import ScriptedTeleop
from renet.errors import RenetError
from renet.folders import lock
from renet.interface import TRUNK
from renet.robots import GO1, Motor, register_robot, robot

from .fakes import BRISK, live

pytestmark = pytest.mark.wall_clock

NEEDS_DDS = pytest.mark.skipif(
    find_spec("cyclonedds") is None, reason="needs renet-locomotion[go2]"
)


def run(out: Path, **options) -> Recording:
    """A run that stands up quickly, read back."""
    cfg = DeployCfg(out=out, **({"safety": BRISK, "seconds": 1.5} | options))
    return read_recording(deploy(cfg) / RECORDING)


def braked_at_the_end(flight: Recording) -> bool:
    ticks = flight.ticks[-25:]
    return bool((ticks["mode"] == MODES.index(Mode.DAMPING)).all() and not ticks["stiffness"].any())


def test_out_of_the_box_it_remembers_the_gap_and_crosses_it_with_its_camera_black(tmp_path, capsys):
    arguments = "deploy --camera sim --terrain gap --level 5 --fault blackout@3.3s"
    assert cli.main([*arguments.split(), "--seconds", "10", "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    story = "sees → remembers → crossed the gap; "
    for words in ("standing_up: armed", "walking: stood up", "remembers: the image is", story):
        assert words in out
    score = json.loads((tmp_path / SCORE).read_text())
    expected = {"falls": 0, "complete": True, "distance_from": "simulator"}
    assert score | expected | {"switch_delay_s": [None]} == score
    assert score["distance_m"] > 4.0
    assert score["walking_seconds"] == pytest.approx(8.0, abs=0.1)
    assert score["memory_share"] > 0.7
    assert ET.parse(tmp_path / TIMELINE)
    flight = read_recording(tmp_path / RECORDING)
    assert braked_at_the_end(flight)
    assert replay_error(flight, Bundle.load()) == 0.0
    assert [event.why for event in flight.events][-1] == "the run ends"


@pytest.mark.parametrize(("mode", "crosses"), [("switch", False), ("memory", True)])
def test_the_two_walks_of_the_readme_differ(tmp_path, mode, crosses):
    arguments = "deploy --camera sim --terrain gap --level 6 --fault unplugged@3.2s --mode"
    assert cli.main([*arguments.split(), mode, "--seconds", "10", "--out", str(tmp_path)]) == 0
    score = json.loads((tmp_path / SCORE).read_text())
    assert (score["crossed"] == "crossed the gap") == crosses


def test_a_terminal_without_arrows_ends_no_run(tmp_path, monkeypatch):
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", stream)
    arguments = ["deploy", "--seconds=3.2", "--fault=blackout@2.5s", f"--out={tmp_path}"]
    assert cli.main(arguments) == 0
    assert b"sees ? remembers" in stream.buffer.getvalue()  # type: ignore[attr-defined]


def test_the_papers_selector_is_told_to_the_log(tmp_path):
    flight = run(tmp_path, mode="switch", fault=("gaussian@1",))
    assert flight.header["mode"] == "switch"
    beta = Bundle.load().manifest.selector.beta
    assert flight.header["thresholds"] == {"reconstruction": beta}
    assert flight.events[-2].why == "images unlike those of training"
    assert replay_error(flight, Bundle.load()) == 0.0


def test_nothing_is_printed_by_the_thread_that_drives_the_robot(tmp_path, monkeypatch):
    """A terminal may take for ever. Seen in a dry run, which prints much and moves nothing."""
    written, lines, printers, driven = [], [], set(), threading.Event()
    write, wait = MujocoRobot.write, MujocoRobot.wait
    monkeypatch.setattr(MujocoRobot, "write", lambda s, c: (written.append(c), write(s, c)))
    monkeypatch.setattr(MujocoRobot, "wait", lambda s, until: (driven.set(), wait(s, until)))
    monkeypatch.setattr(MujocoRobot, "close", lambda robot: driven.clear())

    def show(*words, **options) -> None:
        lines.extend(words)
        if driven.is_set():
            printers.add(threading.current_thread())

    monkeypatch.setattr("builtins.print", show)
    run(tmp_path, dry_run=True)
    (limp,) = written  # Before the flight.
    assert not limp.stiffness.any()
    for words in ("FR_hip", "(Kp 40)", "walking: stood up"):
        assert any(words in line for line in lines)
    assert printers
    assert threading.main_thread() not in printers


def test_a_dry_run_and_its_replay_know_that_the_robot_is_limp(tmp_path, monkeypatch):
    """Its joints stand still, which brakes a robot that motors hold."""
    still = np.zeros(12)
    monkeypatch.setattr(MujocoRobot, "read", lambda robot: live(robot.now(), joint_velocity=still))
    flight = run(tmp_path, camera="none", dry_run=True)
    assert flight.events[-1].why == "the run ends"
    assert replay_error(flight, Bundle.load()) == 0.0


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
    flight = run(tmp_path, safety=replace(BRISK, max_tilt=0.02), seconds=60.0)
    assert len(flight.ticks) < 500
    assert flight.events[-1].why.startswith("tilted")


def test_a_flight_never_overwrites_another(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["deploy", "--seconds", "0.1"]) == 0
    (log,) = Path("results/deploy").glob("*/recording.mcap")
    assert f"Results: {log.parent}\n" in capsys.readouterr().out
    out = Path("mine")
    flights = [len(run(out, seconds=seconds).ticks) for seconds in (0.1, 0.2, 0.3)]
    folders = (out / "earlier-1", out / "earlier-2", out)
    assert [len(read_recording(folder / RECORDING).ticks) for folder in folders] == flights
    assert (out / "earlier-2" / TIMELINE).exists()


def test_its_folder_is_nobody_elses_until_the_score_is_written(tmp_path, monkeypatch):
    def write_locked(*arguments):
        with pytest.raises(RenetError, match="another program writes to"), lock(tmp_path):
            pass
        return write_score(*arguments)

    monkeypatch.setattr(main, "write_score", write_locked)
    run(tmp_path, seconds=0.1)
    assert (tmp_path / SCORE).exists()
    with lock(tmp_path):
        pass


@pytest.mark.parametrize(
    ("options", "live", "length", "operator_timeout"),
    [
        ({}, False, 15.0, math.inf),
        ({"teleop": "keyboard"}, True, math.inf, math.inf),
        ({"teleop": "joystick", "seconds": 3.0}, True, 3.0, math.inf),
        ({"robot": "go1", "teleop": "joystick"}, True, math.inf, DEADMAN),
        ({"robot": "go1", "teleop": "ros2"}, True, math.inf, 0.5),
        ({"teleop": "ros2", "deadman": 2.0}, True, math.inf, 2.0),
        ({"robot": "go1", "deadman": 2.0}, True, 15.0, 2.0),
    ],
)
def test_who_steers_decides_on_clock_end_and_deadman(options, live, length, operator_timeout):
    cfg = DeployCfg(**options)
    assert (cfg.live, cfg.length, cfg.operator_timeout) == (live, length, operator_timeout)


def test_the_go1s_address_and_power_level_are_options():
    arguments = ["--robot", "go1", "--robot-host", "10.0.0.1", "--power-level", "5"]
    cfg = tyro.cli(DeployCfg, args=arguments, default=DeployCfg.defaults(arguments))
    assert cfg.robot_cfg == Go1Cfg("10.0.0.1", 5)
    robot = devices.make_robot(cfg, Bundle.load())
    assert robot.settings == ("10.0.0.1", 8007, 8080, 5)  # type: ignore[attr-defined]


def test_real_time_flies_on_the_threads_and_replays(tmp_path):
    flight = run(tmp_path, robot_cfg=SimulationCfg(real_time=True))
    assert replay_error(flight, Bundle.load()) == 0.0


def test_a_flights_images_are_shown_again_and_a_fault_of_the_scene_from_its_onset(tmp_path):
    clear = run(tmp_path / "a").images
    lens = ReplayCfg(tmp_path / "a" / RECORDING)
    again = run(tmp_path / "b", camera="replay", camera_cfg=lens).images
    # The second camera spoke first in the same control step: same image, same step.
    for row, image in clear.items():
        np.testing.assert_array_equal(again[row], image)
    seen = run(tmp_path / "c", fault=("foam@1s",)).images
    np.testing.assert_array_equal(seen[45], clear[45])
    nearer = clear[50].astype(float) - seen[50]
    assert np.median(nearer[24:]) > 0.03


def test_a_run_on_ones_own_ground_says_so(tmp_path, capsys):
    np.save(tmp_path / "hills.npy", np.random.default_rng(1).uniform(-0.02, 0.02, (80, 80)))
    flight = run(tmp_path / "run", robot_cfg=SimulationCfg(scene=tmp_path / "hills.npy"))
    assert (flight.header["terrain"], flight.header["level"]) == ("own", None)
    assert score_run(flight, [])["crossed"] == ""


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
        ("--mode switch --unseen stop", "--unseen stop needs --mode memory, got switch"),
        ("--mode blind --unseen slow", "--unseen slow needs --mode memory, got blind"),
        ("--fault lightning@5", "lightning"),
        ("--fault glass@1s", "nothing that could be glass"),
        ("--fault blackout@1s --camera none", "needs a camera to spoil"),
        ("--camera replay", "needs --recording"),
        ("--camera replay --recording nowhere", "cannot read the recording nowhere"),
        ("--robot go1", "needs --teleop keyboard, joystick or ros2, or --dry-run"),
        ("--teleop wheel", "unknown teleop 'wheel': choose one of auto, keyboard, joystick, ros2"),
        pytest.param(
            "--teleop ros2 --topic 2go",
            "--topic must be a name such as cmd_vel, got '2go'",
            marks=NEEDS_DDS,
        ),
        pytest.param(
            "--teleop ros2 --ros-domain 233",
            "--ros-domain must be from 0 to 232, got 233",
            marks=NEEDS_DDS,
        ),
        pytest.param(
            "--teleop ros2 --ros-interface eth9",
            "no network interface 'eth9' here",
            marks=NEEDS_DDS,
        ),
        ("--teleop joystick", "-of-nobody: connect one"),
        ("--robot go1 --camera sim", "looks at a simulation"),
        ("--scene step.xml --terrain stairs", "leave --terrain away"),
        ("--scene nowhere.xml", "cannot read the scene nowhere.xml"),
        ("--terrain gap --level 11", "terrain level must be 1 to 10, got 11"),
        ("--viewer", "pip install mjviser"),
        ("--camera realsense", ".[realsense]', and the package libusb-1.0-0"),
    ],
)
def test_mistakes_are_told_before_anything_moves(tmp_path, capsys, monkeypatch, arguments, message):
    for package in ("mjviser", "pyrealsense2"):  # As if they were not installed.
        monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.setattr(gamepad, "DEVICES", "/dev/input/js*-of-nobody")
    monkeypatch.chdir(tmp_path)
    assert cli.main(["deploy", *arguments.split()]) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_bundle_without_memory_stops_nowhere_and_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(cfg, "remembers", lambda estimator: False)
    with pytest.raises(RenetError, match="--unseen stop: go1-parkour has no memory of the ground"):
        deploy(DeployCfg(unseen="stop", out=tmp_path / "out"))
    assert not list(tmp_path.iterdir())


@pytest.fixture
def spot(bundle_path, monkeypatch) -> Path:
    """A bundle for another robot, of which there is no description yet."""
    manifest = read_manifest(bundle_path)
    write_manifest(bundle_path, replace(manifest, robot=replace(manifest.robot, name="Spot")))
    monkeypatch.setattr(robot, "_ROBOTS", dict(robot._ROBOTS))
    return bundle_path


@pytest.mark.parametrize(
    ("robot", "message"),
    [("mujoco", "drives a Spot, which has no description"), ("go1", "Spot, --robot go1 is a Unit")],
)
def test_another_robots_bundle_is_refused(spot, robot, message, tmp_path):
    with pytest.raises(RenetError, match=message):
        deploy(DeployCfg(bundle=spot, robot=robot, out=tmp_path, dry_run=True))


def test_a_simulation_takes_model_height_and_limits_from_the_bundles_robot(spot, tmp_path):
    """A robot of other weight, height and motors, known by its description alone."""
    model = ET.parse(GO1.mjcf)
    for body in model.iter("body"):
        if body.get("name") == TRUNK:
            body.find("inertial").set("mass", "7.5")
    model.write(tmp_path / "spot.xml")
    motors = {**GO1.motors, "calf": Motor(torque=35.55, velocity=10.0)}
    spot_itself = replace(GO1, name="Spot", mjcf=tmp_path / "spot.xml", height=0.4, motors=motors)
    register_robot(spot_itself)
    bundle = Bundle.load(spot)
    robot = devices.make_robot(DeployCfg(), bundle)
    assert robot.model.body(TRUNK).mass == 7.5
    assert robot.base_position[2] == 0.4
    assert robot.description.velocity[2] == 10.0
    assert run(tmp_path / "out", bundle=spot, seconds=1.0).header["robot"] == "mujoco"


@pytest.mark.parametrize(
    "option", ["--terrain gap", "--viewer", "--host 10.0.0.1", "--serial 1", "--topic cmd_vel"]
)
def test_options_of_another_robot_or_camera_are_refused(option, capsys):
    with pytest.raises(SystemExit, match="2"):
        cli.main(["deploy", "--robot", "go1", "--camera", "none", "--dry-run", *option.split()])
    assert "Unrecognized options" in capsys.readouterr().err
