"""What the robots of the tests have in common: a real link on one side, MuJoCo on the other."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from pkgutil import resolve_name
from typing import Self

import mujoco
import numpy as np
import pytest

from renet.deploy.controller import Controller
from renet.deploy.robots.base import JointCommand
from renet.deploy.robots.real.braking import PERIOD, Link
from renet.deploy.robots.real.driver import RealRobot
from renet.deploy.teleop.base import TeleopCommand
from renet.interface import CONTROL_DT, JOINTS

from ..fakes import command, until

KINDS = {"go1": "unitree_legged_sdk.robot_interface", "go2": "cyclonedds"}
"""Module that each kind of robot needs."""
STEP = round(CONTROL_DT / PERIOD)
"""Exchanges in a control step."""
LEGS, PARTS = ("FR", "FL", "RR", "RL"), ("hip", "thigh", "calf")
VENDOR = [f"{leg}_{part}_joint" for leg in LEGS for part in PARTS]
"""Names of the vendor's motors 0 to 11 (FR_0, FR_1, ... RL_2 in its examples)."""


@contextmanager
def make_peer(kind: str) -> Iterator["Peer"]:
    """A robot of a kind; the test is skipped where that cannot be."""
    pytest.importorskip(KINDS[kind], reason=f"needs renet-locomotion[{kind}]")
    peer = import_module(f"tests.deploy.robots.{kind}_peer").Peer()
    yield peer
    peer.close()


class Peer:
    """A robot that remembers what it was told."""

    SERVO: int
    """Mode of a motor that obeys."""
    driver: tuple[str, tuple]
    """MODULE:FUNCTION that makes its driver, and the arguments that find it."""
    data: mujoco.MjData
    """What it really does."""
    step: Callable[[], None]
    """Lets it live for 2 ms."""

    def __init__(self) -> None:
        self.commands: list[np.ndarray] = []
        """[12, 6] mode, q, dq, tau, Kp, Kd of each command, by joint."""
        self.arrivals: list[int] = []
        """When each was sent or came, ns; however late this program reads it."""

    def live(self) -> None:
        """The same, at the pace of the wall clock."""
        self.step()

    def make_link(self, **options) -> Link:
        """The real link to it."""
        raise NotImplementedError

    def wire(self, **options) -> "Wire":
        return Wire(self, self.make_link(**options))

    def make_driver(self, **options) -> RealRobot:
        name, arguments = self.driver
        return resolve_name(name)(*arguments, **options)

    def released(self) -> bool:
        """Whether no sender process holds it any more."""
        first, second = self.driver[1][:2]
        return f" at {first}:{second}\n" not in Path("/proc/net/unix").read_text()

    @contextmanager
    def serving(self) -> Iterator[Self]:
        """Live on a thread of its own, in wall-clock time, until all senders have ended.

        Nothing outside its envelope may have reached it then.
        """
        done = threading.Event()

        def serve() -> None:
            while not done.is_set():
                self.live()

        server = threading.Thread(target=serve, daemon=True)
        server.start()
        yield self
        until(self.released)
        done.set()
        server.join(5)
        limits, sent = self.make_driver().description, np.array(self.commands).reshape(-1, 12, 6)
        _, position, _, torque, stiffness, damping = np.moveaxis(sent, -1, 0)
        inside = (position >= limits.lower - 1e-6) & (position <= limits.upper + 1e-6)
        assert (inside | ((stiffness == 0) & (damping == 0))).all(), "limp motors have no target"
        assert ((stiffness >= 0) & (stiffness <= 100) & (damping >= 0) & (damping <= 10)).all()
        assert not torque.any()

    @property
    def angles(self) -> np.ndarray:
        """[12] rad"""
        return np.array([self.data.joint(name).qpos[0] for name in JOINTS])

    @property
    def speeds(self) -> np.ndarray:
        """[12] rad/s"""
        return np.array([self.data.joint(name).qvel[0] for name in JOINTS])

    @property
    def torques(self) -> np.ndarray:
        """[12] N m"""
        return np.array([self.data.actuator(name).force[0] for name in JOINTS])

    @property
    def height(self) -> float:
        return self.data.body("trunk").xpos[2]

    @property
    def stiff(self) -> int:
        """How many commands so far asked for more than braking."""
        return sum(bool(sent[:, 4].any()) for sent in list(self.commands))

    @property
    def braked(self) -> bool:
        """Whether the newest command asks for nothing but braking."""
        *_, stiffness, damping = self.commands[-1].T
        return bool((stiffness == 0).all() and (damping == 3).all())

    @property
    def holds(self) -> bool:
        """Whether the newest command holds a pose with the bundle's gains, to the last bit."""
        *_, stiffness, damping = self.commands[-1].T
        return bool((stiffness == 40).all() and (damping == 1).all())


class Wire:
    """Link and robot in lockstep, on simulated time."""

    def __init__(self, peer: Peer, link: Link) -> None:
        self.link, self._peer = link, peer
        self.now, self.dead = 0.0, False

    def run(self, exchanges: int, alone: bool = False) -> None:
        """Exchange so many times, if alone without the robot."""
        for _ in range(exchanges):
            self.now += PERIOD
            if not self.dead:
                self.link.alive(self.now)
            self.link.exchange(self.now)
            if not alone:
                self._peer.step()

    def start(self) -> None:
        """Go on until the robot may be commanded."""
        for _ in range(3000):
            if self.link.state is not None:
                return
            self.run(1)
        raise AssertionError(f"no reading: {self.link.problem}")

    def send(self, command: JointCommand, exchanges: int) -> None:
        """Command something, then exchange so many times."""
        self.link.command(command, self.now)
        self.run(exchanges)

    def hold(self, exchanges: int) -> None:
        """Command the robot to stay where it is."""
        self.send(command(self.link.state.joint_position), exchanges)

    def control(self, controller: Controller, steps: int, **wishes) -> None:
        """Let a controller drive for some control steps."""
        for step in range(steps):
            teleop = TeleopCommand(**(wishes | {"arm": wishes.get("arm", False) and step == 0}))
            command = controller.tick(self.link.state, None, teleop, self.now)
            self.send(command, STEP)
