"""When a robot is braked whatever its controller wants; shared by the links to all real robots."""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from renet.deploy.robots.base import JointCommand, RobotState
from renet.deploy.robots.envelope import clamp
from renet.deploy.robots.real.identity import Count
from renet.robots import Robot

PERIOD = 0.002
"""Seconds between two exchanges with a robot's motors."""
HEARTBEAT = 0.004
"""Seconds between two signs of life of the controller's process."""
LIFELESS = 0.014
"""Seconds without one after which the robot is braked: on the wire within 20 ms."""
SILENCE = 0.1
"""Seconds without a new command after which the robot is braked."""
BRAKE = 3.0
"""Kd of that brake, N m s/rad."""


class Link(ABC):
    """One exchange after the other with a robot; no thread, no clock of its own.

    It brakes the robot by itself when the controller's process gives no sign of life, when no new
    command comes, and for good when there is a problem. `now` is the time on whichever clock the
    caller keeps.
    """

    leap = 100
    """Most by which one reading's count may be ahead of the last one's."""

    def __init__(self, robot: Robot) -> None:
        """Begin without a command: joints are left alone until the first."""
        self._robot = robot
        self._command: JointCommand | None = None
        self.commanded = -math.inf
        """When the newest command was given; -inf before the first."""
        self.holding: JointCommand | None = None
        """What holds the robot before that; None where it may lie limp."""
        self._alive = self._too_old = -math.inf
        self._count = Count(self.leap)
        self.state: RobotState | None = None
        """Newest reading; its time stands still when the robot falls silent."""
        self.problem = ""
        """Why the robot is braked for good; empty while it is not."""

    def alive(self, since: float) -> None:
        """The controller's process lived at this time."""
        self._alive = max(self._alive, since)

    def command(self, command: JointCommand, now: float) -> None:
        """Send this, within the robot's limits, from the next exchange on.

        Raises:
            RenetError: it is not made of 12 finite numbers each; the one before stands.
        """
        self._command = clamp(self._robot, command, self.state)
        self.commanded = now

    def exchange(self, now: float) -> None:
        """Read what arrived, send the newest command; raises only what sending itself raises."""
        with self.braked_on_failure():
            self._receive(now)
        lifeless = now - self._alive > LIFELESS
        if lifeless:
            self._too_old = now  # A command from before the gap must not be obeyed after it.
        silent = now - self.commanded > SILENCE or self.commanded <= self._too_old
        command = self._command
        if command is None:  # Before the first command nobody can be late with one.
            command, silent = self.holding, lifeless
        if command is not None and (silent or self.problem):
            command = braking(command)
        self._send(command)

    @property
    def moved(self) -> bool:
        """Whether the motors were ever told anything."""
        return self.commanded > -math.inf or self.holding is not None

    @contextmanager
    def braked_on_failure(self) -> Iterator[None]:
        """Make a problem of what fails in a block: sending on is all that can still brake."""
        try:
            yield
        except Exception as error:
            self.problem = f"the robot's driver failed: {type(error).__name__}: {error}"

    def _news(self, count: int) -> bool:
        """Whether a reading is newer than the last by its 32-bit count; see `identity.Count`."""
        newer = self._count.news(count)
        self.problem = self.problem or self._count.problem
        return newer

    @abstractmethod
    def _receive(self, now: float) -> None:
        """Take over the newest reading as `state`, and set `problem` if the robot has one."""

    @abstractmethod
    def _send(self, command: JointCommand | None) -> None:
        """Send a command to the motors; None while they are to be left alone."""


def braking(command: JointCommand) -> JointCommand:
    """The brake for joints that were told something else."""
    zero = np.zeros_like(command.stiffness)
    return JointCommand(command.position, zero, zero + BRAKE)
