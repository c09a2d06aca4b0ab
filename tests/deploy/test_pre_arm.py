"""What keeps a robot lying, and what it says: the check before motors get any stiffness."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

from renet.deploy.bundle import Bundle
from renet.deploy.controller import Controller
from renet.deploy.loop import run_control_loop
from renet.deploy.robots.envelope import go1_envelope
from renet.deploy.safety import Mode, SafetyCfg, pre_arm_problem
from renet.deploy.teleop import TeleopCommand

from .fakes import frame, state

ARM = TeleopCommand(arm=True)


@pytest.mark.parametrize(
    ("change", "refusal"),
    [
        ({}, ""),
        ({"teleop": TeleopCommand(speed=1.0, arm=True)}, "already asks for 1.00 m/s"),
        ({"state": state(battery=0.19)}, "the battery has 19% left, less than 20%"),
        ({"state": state(battery=0.21)}, ""),
        ({"state": state(battery=math.nan, temperature=math.nan)}, ""),
        ({"state": state(temperature=66.0)}, "a motor has 66 °C, more than 65 °C"),
        ({"recorder": "the recording x ends early: no space"}, "the recording x ends early"),
        ({"frame": None}, "the camera has sent no image"),
        ({"frame": frame(1, 9.4)}, "newest image is older than 0.5 s"),
        ({"frame": frame(1, math.nan)}, "newest image is older than 0.5 s"),
        ({"frame": None, "camera": False}, ""),
    ],
)
def test_each_reason_is_named(change, refusal):
    given = {
        "state": state(10.0),
        "teleop": ARM,
        "frame": frame(1, 9.9),
        "camera": True,
        "recorder": "",
        "now": 10.0,
    }
    found = pre_arm_problem(**(given | change))
    assert refusal in found
    assert bool(found) == bool(refusal)


class Lying:
    """A robot that counts time and is told things."""

    def __init__(self, **reading) -> None:
        self.envelope, self.time, self.told, self.reading = go1_envelope(), 0.0, [], reading

    def now(self) -> float:
        return self.time

    def wait(self, until: float) -> None:
        self.time = until

    def read(self):
        return state(self.time, **self.reading)

    def write(self, command) -> None:
        self.told.append(command)


@pytest.mark.parametrize(
    ("reading", "teleop"),
    [
        ({"battery": 0.05}, ARM),
        ({}, TeleopCommand(speed=0.9, arm=True)),
        ({"temperature": 90.0}, ARM),
    ],
)
def test_a_refused_robot_gets_no_stiffness_and_hears_why_once(reading, teleop):
    robot, events = Lying(**reading), []
    cfg = SafetyCfg(stand_up_seconds=0.1)
    controller = Controller(Bundle.load(), cfg, on_event=events.append)
    hand = SimpleNamespace(command=lambda now: teleop)
    run_control_loop(robot, None, hand, controller, done=lambda: robot.time > 0.5)
    assert [event.what for event in events] == ["refused"]
    assert not any(command.stiffness.any() for command in robot.told)
    assert controller.machine.mode is Mode.DAMPING
