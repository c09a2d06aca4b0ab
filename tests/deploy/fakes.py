"""Healthy readings and frames to spoil, a controller that is fed with them, and a wait."""

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from itertools import count

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from renet.bundle import Bundle
from renet.deploy.cameras.base import DepthFrame
from renet.deploy.controller import Controller, Event
from renet.deploy.robots.base import JointCommand, RobotState
from renet.deploy.robots.sim.mujoco import MujocoRobot
from renet.deploy.robots.sim.scene import build_scene
from renet.deploy.safety.limits import SafetyCfg
from renet.deploy.teleop.base import TeleopCommand
from renet.interface import CONTROL_DT
from renet.robots import GO1
from renet.training.export import robot_spec

READINGS = count()
STANDING = np.tile([0.1, 0.9, -1.8, -0.1, 0.9, -1.8], 2)


def state(time: float = 0.0, **changes) -> RobotState:
    """The reading of a robot that stands and measures no torque."""
    standing = RobotState(
        time=time,
        joint_position=STANDING.copy(),
        joint_velocity=np.zeros(12),
        joint_torque=np.zeros(12),
        quaternion=np.array([1.0, 0, 0, 0]),
        angular_velocity=np.zeros(3),
    )
    return replace(standing, **changes)


def live(time: float = 0.0, **changes) -> RobotState:
    """The same of sensors none of which says the same twice."""
    reading, noise = state(time, **changes), 1e-9 * (next(READINGS) % 1000)
    noisy = ("joint_position", "joint_velocity", "quaternion", "angular_velocity")
    with suppress(TypeError):  # What a test made of it is no array.
        return replace(reading, **{name: getattr(reading, name) + noise for name in noisy})
    return reading


def command(position=STANDING, stiffness=40.0, damping=1.0) -> JointCommand:
    """To hold a pose, with the same gains for every joint."""
    return JointCommand(np.array(position), np.full(12, stiffness), np.full(12, damping))


def turned(axis: str, degrees: float) -> np.ndarray:
    """The quaternion of a turn about x (to the right), y (nose down) or z (to the left)."""
    return Rotation.from_euler(axis, degrees, degrees=True).as_quat(scalar_first=True)


def frame(number: int, time: float, seed: int = 0) -> DepthFrame:
    random = np.random.default_rng([seed, number])
    slope = np.linspace(0.9, 0.15, 48)[:, None]
    image = np.clip(slope + 0.03 * random.normal(size=(48, 64)), 0.0, 1.0)
    return DepthFrame(image, number, time)


def until(condition: Callable[[], bool], act: Callable[[], None] = lambda: None) -> None:
    """Act until a condition of another thread holds; gives up after about ten seconds."""
    for _ in range(1000):
        if condition():
            return
        act()
        time.sleep(0.01)
    pytest.fail("it never happened")


def robot_on(terrain: str = "flat", level: int = 3) -> MujocoRobot:
    """A simulated Go1 on the plane or on a training tile."""
    model, ground = build_scene(terrain, level)
    return MujocoRobot(model, robot_spec(), ground)


class Broken:
    """A driver's object none of whose parts can be read."""

    @property
    def image(self):
        raise RuntimeError("the driver's object is gone")

    number = time = forward = image


def time_of(step: int) -> float:
    return round(step * CONTROL_DT, 6)


class Standing:
    """A robot that stands still on a clock of its own, and remembers what it was told."""

    def __init__(self, **reading) -> None:
        self.description, self.time, self.reading = GO1, 0.0, reading
        self.told: list[JointCommand] = []
        self.wait_fails: BaseException | None = None

    def now(self) -> float:
        return self.time

    def wait(self, until: float) -> None:
        if self.wait_fails is not None and self.time > 0.5:
            raise self.wait_fails
        self.time = until

    def read(self) -> RobotState:
        return live(self.time, **self.reading)

    def write(self, command: JointCommand) -> None:
        self.told.append(command)

    @property
    def braked(self) -> bool:
        return not self.told[-1].stiffness.any() and bool((self.told[-1].damping > 0).all())


ARM, GO = TeleopCommand(arm=True), TeleopCommand(forward=0.6)
QUICK = SafetyCfg(stand_up_seconds=0.1, least_torque=0.0)
BRISK = SafetyCfg(stand_up_seconds=0.5)
"""For robots without weight, whose joints stay where they are, and with."""
WALKS_AT = 7
"""Control step at which `Run` walks: armed at step 1, stood_up 0.1 s later."""


class Run:
    """A controller and what happened to it."""

    def __init__(self, bundle: Bundle, **options) -> None:
        self.events: list[Event] = []
        self.controller = Controller(bundle, QUICK, on_event=self.events.append, **options)
        self.step = 0

    def tick(self, frame=None, teleop=GO, **changes):
        now = time_of(self.step)
        changes = {"time": now} | changes
        teleop = ARM if self.step == 1 else teleop
        command = self.controller.tick(live(**changes), frame, teleop, now)
        self.step += 1
        return command

    def ticks(self, count: int, camera=lambda frame: frame, **changes) -> list[bool]:
        """Vision at each step; every fifth one has a new frame, which `camera` spoils."""
        seen = []
        for _ in range(count):
            last = self.step - self.step % 5
            self.tick(camera(frame(last, time_of(last))), **changes)
            seen.append(self.controller.decision.vision)
        return seen

    def whats(self) -> list[str]:
        return [event.what for event in self.events]
