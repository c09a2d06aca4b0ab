"""The loop with broken devices: it goes on, and ends in OP or in damping as documented."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from renet.bundle import Bundle
from renet.deploy.cameras.sim import SimCamera
from renet.deploy.controller import Controller
from renet.deploy.loop import BRAKING, run_control_loop
from renet.deploy.recording.reader import Recording, read_recording
from renet.deploy.recording.recorder import Recorder
from renet.deploy.recording.replay import replay_error
from renet.deploy.recording.tick import MODES
from renet.deploy.safety.machine import Mode
from renet.deploy.teleop.base import TeleopCommand
from renet.deploy.teleop.scripted import ScriptedTeleop
from renet.interface import CONTROL_DT

from .fakes import ARM, BRISK, QUICK, Standing, live, robot_on

pytestmark = pytest.mark.wall_clock


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    return Bundle.load()


class Rig:
    """A simulated robot on the plane, whose devices can be spoilt."""

    def __init__(self, bundle: Bundle) -> None:
        self.bundle, self.robot, self.teleop = bundle, robot_on(), ScriptedTeleop(0.6)
        self.camera = SimCamera(self.robot, bundle.manifest.camera, seed=1)

    def spoil(self, device: str, method: str, how: Callable) -> None:
        """Pass what a device's method gives, and the time, through a function."""
        real = getattr(getattr(self, device), method)
        given = lambda *arguments: how(real(*arguments), self.robot.now())  # noqa: E731
        setattr(getattr(self, device), method, given)

    def fly(self, seconds: float, folder: Path, camera: bool = True) -> Recording:
        """Run with a recording, which replays."""
        header = {"bundle_sha256": self.bundle.sha256, "safety": vars(BRISK)}
        log = Recorder(folder / "recording.mcap", header | {"mode": "memory", "unseen": "walk"})
        controller = Controller(self.bundle, BRISK, on_event=log.event)
        devices: tuple = (self.robot, self.camera if camera else None, self.teleop)
        self.camera.start()
        run_control_loop(*devices, controller, log, done=lambda: self.robot.now() >= seconds)
        log.close()
        flight = read_recording(log.path)
        assert replay_error(flight, self.bundle) == 0.0
        return flight


def boom(*arguments):
    raise OSError("unplugged")


def during(begin: float, end: float, what: Callable) -> Callable:
    return lambda value, now: what() if begin <= now < end else value


def test_a_camera_unplugged_and_replugged_50_times_in_one_run(bundle, tmp_path):
    """Silence, errors, a driver that repeats its last frame, and garbage, in turn."""
    rig, held, plugs, upright = Rig(bundle), [], [], []
    endings = [
        lambda frame: None,
        boom,
        lambda frame: held[-1],
        lambda frame: replace(frame, image=np.zeros((3, 4))),
        lambda frame: replace(frame, time=-1.0),
    ]

    def look(frame, now):
        upright.append(rig.robot.base_rotation[2, 2])
        cycle, phase = divmod(now - 1.0, 0.5)
        if now < 1.0 or phase < 0.2:
            held.append(frame)
            return frame
        plugs.append(int(cycle))
        return endings[int(cycle) % len(endings)](frame)

    rig.spoil("camera", "latest", look)
    flight = rig.fly(26.2, tmp_path)
    assert len(set(plugs)) >= 50
    assert flight.ticks["mode"][-BRAKING - 1] == MODES.index(Mode.WALKING)
    assert min(upright[:-BRAKING]) > 0.5
    assert np.hypot(*rig.robot.base_position[:2]) > 3.0
    assert sum(event.what == "blind" for event in flight.events) <= 26.2 / 5 + 1


def test_nobody_is_asked_for_a_command_once_the_run_ends(bundle, tmp_path):
    """A topic that falls silent then is no news."""
    rig = Rig(bundle)
    rig.teleop.problem = ""

    def listen(command, now):
        rig.teleop.problem = "no message" if now >= 0.5 else ""
        return command

    rig.spoil("teleop", "command", listen)
    flight = rig.fly(0.5, tmp_path, camera=False)
    assert [event.why for event in flight.events if event.what == "damping"] == ["the run ends"]
    assert not [event for event in flight.events if event.what == "teleop"]


@pytest.mark.parametrize(
    ("device", "method", "answer", "reason"),
    [
        ("robot", "read", boom, "the state is 60 ms old"),
        ("robot", "read", lambda: None, "the state is 60 ms old"),
        ("robot", "read", lambda: "fine", "joint_velocity"),
        ("teleop", "command", boom, "operator stop"),
        ("teleop", "command", lambda: None, "AttributeError"),
        ("teleop", "command", lambda: TeleopCommand(stop=True), "operator stop"),
        ("robot", "write", boom, "the robot takes no commands: unplugged"),
    ],
)
def test_what_ends_in_damping(bundle, tmp_path, device, method, answer, reason):
    rig = Rig(bundle)
    rig.spoil(device, method, during(1.49, 9, answer))
    flight = rig.fly(2.0, tmp_path)
    end = flight.events[-1]
    assert end.what == "damping"
    assert reason in end.why
    assert 1.49 < end.time < 1.57
    damped = flight.ticks["mode"] == MODES.index(Mode.DAMPING)
    assert not flight.ticks["stiffness"][damped].any()
    every_step = CONTROL_DT * np.arange(101 + BRAKING)
    np.testing.assert_allclose(flight.ticks["now"], every_step, atol=1e-6)


@pytest.mark.parametrize(
    ("reading", "warning", "end"),
    [
        ({"battery": 0.1}, "the battery has less than 20% left", None),
        ({"temperature": 70.0}, "a motor has more than 65 °C", None),
        ({"battery": 0.04}, "the battery has", "the robot lies down: the battery has less than 5%"),
        ({"temperature": 86.0}, "a motor", "the robot lies down: a motor has more than 85 °C"),
        ({"temperature": "hot", "battery": None}, None, None),
    ],
)
def test_battery_and_motors_are_watched_while_it_walks(bundle, tmp_path, reading, warning, end):
    rig = Rig(bundle)
    rig.spoil("robot", "read", lambda s, now: replace(s, **reading) if now > 1.2 else s)
    flight = rig.fly(1.6, tmp_path)
    told = [event.why for event in flight.events if event.what == "power"]
    assert [warning in why for why in told if warning] == ([True] if warning else [])
    mode = Mode.DAMPING if end else Mode.WALKING
    assert flight.ticks["mode"][-BRAKING - 1] == MODES.index(mode)
    if end:
        assert flight.events[-1].why.startswith(end)


def test_a_step_that_is_missed_is_left_out(bundle):
    """And a terminal that is gone ends nothing: what `on_step` raises is left out, too."""
    robot, begun = Standing(), []
    late, wait = {0.3: 0.015, 0.5: 0.025, 0.7: 0.05}, robot.wait
    robot.wait = lambda until: wait(until + late.pop(round(until, 6), 0.0))
    done = lambda: begun.append(robot.time) or robot.time > 1.0  # noqa: E731
    devices: tuple = (robot, None, ScriptedTeleop(0.5), Controller(bundle, BRISK))
    run_control_loop(*devices, done=done, on_step=boom)
    assert np.diff(begun).min() > 0.004, "no two at once"
    assert np.isclose(np.array(begun[-10:]) / CONTROL_DT % 1, [[0], [1]], atol=1e-6).any(0).all()


def test_without_a_camera_it_walks_on_op_and_replays(bundle, tmp_path):
    flight = Rig(bundle).fly(3.0, tmp_path, camera=False)
    # It has seen no ground at all.
    whats = ["standing_up", "blind", "walking", "unseen", "damping"]
    assert [event.what for event in flight.events] == whats
    assert not flight.ticks["vision"].any()


@pytest.mark.parametrize("dry_run", [True, False])
def test_sensors_of_a_limp_robot_may_stand_still_in_a_dry_run(bundle, dry_run):
    """Motors that hold a robot make all of them tremble; those of a dry run hold nothing."""
    robot, events = Standing(), []
    robot.read = lambda: replace(live(robot.time), joint_velocity=np.zeros(12))
    options = {"on_event": events.append, "dry_run": dry_run}
    controller = Controller(bundle, QUICK, **options)
    devices: tuple = (robot, None, ScriptedTeleop(0.5), controller)
    run_control_loop(*devices, done=lambda: robot.time > 1.0, dry_run=dry_run)
    braked = next(event.why for event in events if event.what == "damping")
    frozen = "frozen: 6 readings of the joints' speeds are the same"
    assert braked == ("the run ends" if dry_run else frozen)


def test_what_a_device_complains_of_is_told_once(bundle, tmp_path):
    rig = Rig(bundle)
    rig.spoil("robot", "read", during(0.2, 0.3, boom))
    rig.spoil("camera", "latest", during(0.3, 0.4, boom))
    rig.camera.problem = "connect it by USB 3"  # type: ignore[attr-defined]
    told = [(event.what, event.why) for event in rig.fly(0.5, tmp_path).events]
    assert told.count(("robot", "OSError: unplugged")) == 1
    assert told.count(("camera", "OSError: unplugged")) == 1
    assert told.count(("camera", "connect it by USB 3")) == 2, "before and after"


def test_a_braked_robot_that_takes_no_commands_is_told_once(bundle):
    """As a process that died while nobody wanted to stand up, which leaves the robot limp."""
    robot, events = Standing(), []
    obey = robot.write
    robot.write = lambda command: boom() if 0.2 < robot.time < 0.4 else obey(command)
    controller = Controller(bundle, BRISK, on_event=events.append)
    hand = SimpleNamespace(command=lambda now: TeleopCommand(arm=now > 0.6))
    run_control_loop(robot, None, hand, controller, done=lambda: robot.time > 0.8)
    reason = "the robot takes no commands: unplugged"
    assert [event.why for event in events if event.what == "robot"] == [reason]
    assert [event.what for event in events if event.time > 0.5] == ["standing_up", "damping"]


def test_a_walking_robot_that_takes_no_commands_is_told_once(bundle):
    robot, events = Standing(), []
    obey = robot.write
    robot.write = lambda command: boom() if robot.time > 1.0 else obey(command)
    controller = Controller(bundle, BRISK, on_event=events.append)
    run_control_loop(robot, None, ScriptedTeleop(0.5), controller, done=lambda: robot.time > 1.5)
    reason = "the robot takes no commands: unplugged"
    assert [event.what for event in events if event.why == reason] == ["damping"]


@pytest.mark.parametrize(
    ("reading", "teleop", "recording"),
    [
        ({"battery": 0.05}, ARM, ""),
        ({"battery": None}, ARM, ""),
        ({}, TeleopCommand(forward=0.9, arm=True), ""),
        ({}, ARM, "the recording ends early"),
    ],
)
def test_a_refused_robot_gets_no_stiffness_and_hears_why_once(bundle, reading, teleop, recording):
    robot, events = Standing(**reading), []
    controller = Controller(bundle, BRISK, on_event=events.append)
    hand = SimpleNamespace(command=lambda now: teleop)
    log = SimpleNamespace(append=lambda *arguments: None, problem=recording)
    run_control_loop(robot, None, hand, controller, log, done=lambda: robot.time > 0.8)
    refused = [event.why for event in events if event.what == "refused"]
    assert len(refused) == 1
    assert recording in refused[0]
    assert not any(command.stiffness.any() for command in robot.told)
    assert controller.machine.mode is Mode.DAMPING


def test_an_operator_who_holds_the_button_does_not_arm_when_the_check_passes(bundle):
    """A refused wish to stand up must be asked for anew."""
    robot, events = Standing(), []
    controller = Controller(bundle, BRISK, on_event=events.append)
    hand = SimpleNamespace(
        command=lambda now: TeleopCommand(0.3 * (now < 0.2), arm=now < 0.4 or now > 0.6)
    )
    run_control_loop(robot, None, hand, controller, done=lambda: robot.time > 0.8)
    armed = [event.time for event in events if event.what == "standing_up"]
    assert armed == [pytest.approx(0.6, abs=2 * CONTROL_DT)]


def test_a_step_that_returns_late_brakes(bundle):
    """Its reading is as old, and nobody looked at the robot meanwhile."""
    robot, controller, late = Standing(), Controller(bundle, BRISK), []
    act = controller.policy._act

    def slow(*arguments):
        if robot.time > 1.0 and not late:
            late.append(len(robot.told))
            robot.time += 0.3
        return act(*arguments)

    controller.policy._act = slow
    run_control_loop(robot, None, ScriptedTeleop(0.5), controller, done=lambda: robot.time > 2.0)
    assert robot.told[late[0] - 1].stiffness.any()
    assert not robot.told[late[0]].stiffness.any()
