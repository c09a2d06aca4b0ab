"""Braking of a robot whatever its controller wants; the base class of links to real robots."""

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
"""Time from one exchange with a robot's motors to the next, s."""
HEARTBEAT = 0.004
"""Time from one sign of life of the controller's process to the next, s."""
LIFELESS = 0.014
"""Time without a sign of life after which the robot is braked, s: on the wire within 20 ms."""
SILENCE = 0.1
"""Time without a new command after which the robot is braked, s."""
BRAKE = 3.0
"""Kd of the brake, N m s/rad."""


class Link(ABC):
    """Exchange of commands and readings with a robot, without a thread or clock of its own.

    It brakes the robot when the controller's process gives no sign of life or no new command comes,
    and for good when there is a problem. `now` is the time on the caller's clock, s.
    """

    leap = 100
    """Largest leap of the count from one reading to the next."""

    def __init__(self, robot: Robot) -> None:
        """Begin without a command: joints are left alone until the first."""
        self._robot = robot
        self._command: JointCommand | None = None
        self.commanded = -math.inf
        """Time of the newest command; -inf before the first."""
        self.holding: JointCommand | None = None
        """Command that holds the robot before the first; None if it may lie limp."""
        self._alive = -math.inf
        self._too_old = -math.inf
        self._count = Count(self.leap)
        self.state: RobotState | None = None
        """Newest reading; its time stands still when the robot falls silent."""
        self.problem = ""
        """Reason for which the robot is braked for good; empty while it is not."""

    def alive(self, since: float) -> None:
        """Note that the controller's process lived at the time `since`."""
        self._alive = max(self._alive, since)

    def command(self, command: JointCommand, now: float) -> None:
        """Send a command, within the robot's limits, from the next exchange on.

        Raises:
            RenetError: It is not made of 12 finite numbers each; the one before stands.
        """
        self._command = clamp(self._robot, command, self.state)
        self.commanded = now

    def exchange(self, now: float) -> None:
        """Read what arrived, and send the newest command; raises only what sending raises."""
        with self.braked_on_failure():
            self._receive(now)
        lifeless = now - self._alive > LIFELESS
        if lifeless:
            # A command from before the gap must not be obeyed after it.
            self._too_old = now
        silent = now - self.commanded > SILENCE or self.commanded <= self._too_old
        command = self._command
        # Before the first command nobody can be late with one.
        if command is None:
            command = self.holding
            silent = lifeless
        if command is not None and (silent or self.problem):
            command = braking(command)
        self._send(command)

    @property
    def moved(self) -> bool:
        """True if the motors were ever commanded."""
        return self.commanded > -math.inf or self.holding is not None

    @contextmanager
    def braked_on_failure(self) -> Iterator[None]:
        """Turn an exception in a block into a problem: only a link that goes on can brake."""
        try:
            yield
        except Exception as error:
            self.problem = f"the robot's driver failed: {type(error).__name__}: {error}"

    def _news(self, count: int) -> bool:
        """Return True if a reading is newer than the last by its count; see `identity.Count`."""
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
    """Return the command that brakes the joints of another command."""
    zero = np.zeros_like(command.stiffness)
    return JointCommand(command.position, zero, zero + BRAKE)
