"""What the robots of the tests have in common: a real link on one side, MuJoCo on the other."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from pkgutil import resolve_name
from typing import Self

import numpy as np

from renet.deploy.controller import Controller
from renet.deploy.robots.base import JointCommand
from renet.deploy.robots.real.braking import PERIOD, Link
from renet.deploy.robots.real.driver import RealRobot
from renet.deploy.teleop import TeleopCommand
from renet.interface import CONTROL_DT

STEP = round(CONTROL_DT / PERIOD)
"""Exchanges in a control step."""


class Recording:
    """A robot that remembers what it was told."""

    def __init__(self) -> None:
        self.commands: list[np.ndarray] = []
        """[12, 6] mode, q, dq, tau, Kp, Kd of each command."""
        self.arrivals: list[int] = []
        """When each was sent or came, ns; however late this program reads it."""

    driver: tuple[str, tuple]
    """MODULE:CLASS of its driver, and the arguments that find it."""

    def live(self) -> None:
        """Let it live for 2 ms."""
        raise NotImplementedError

    def make_driver(self, **options) -> RealRobot:
        name, arguments = self.driver
        return resolve_name(name)(*arguments, **options)

    def released(self) -> bool:
        """Whether no sender process holds it any more."""
        first, second = self.driver[1][:2]
        return f" at {first}:{second}\n" not in Path("/proc/net/unix").read_text()

    @contextmanager
    def serving(self) -> Iterator[Self]:
        """Live on a thread of its own, in wall-clock time."""
        done = threading.Event()

        def serve() -> None:
            while not done.is_set():
                self.live()

        server = threading.Thread(target=serve, daemon=True)
        server.start()
        yield self
        done.set()
        server.join(5)

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

    def __init__(self, link: Link, live: Callable[[], None]) -> None:
        self.link, self._live = link, live
        self.now, self.dead = 0.0, False

    def run(self, exchanges: int) -> None:
        for _ in range(exchanges):
            self.now += PERIOD
            if not self.dead:
                self.link.alive(self.now)
            self.link.exchange(self.now)
            self._live()

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

    def control(self, controller: Controller, steps: int, **wishes) -> None:
        """Let a controller drive for some control steps."""
        for step in range(steps):
            teleop = TeleopCommand(**(wishes | {"arm": wishes.get("arm", False) and step == 0}))
            command = controller.tick(self.link.state, None, teleop, self.now)
            self.link.command(command, self.now)
            self.run(STEP)
