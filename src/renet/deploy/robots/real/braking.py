"""When a robot is braked whatever its controller wants; shared by the links to all real robots."""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from renet.deploy.robots.base import JointCommand, RobotState
from renet.deploy.robots.envelope import Envelope

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

    def __init__(self, envelope: Envelope) -> None:
        """Begin without a command: joints are left alone until the first."""
        self._envelope = envelope
        self._command: JointCommand | None = None
        self.commanded = -math.inf
        """When the newest command was given; -inf before the first."""
        self._alive = self._too_old = -math.inf
        self._tick: int | None = None
        self.state: RobotState | None = None
        """Newest reading; its time stands still when the robot falls silent."""
        self.problem = ""
        """Why the robot is braked for good; empty while it is not."""

    def alive(self, since: float) -> None:
        """The controller's process lived at this time."""
        self._alive = max(self._alive, since)

    def command(self, command: JointCommand, now: float) -> None:
        """Send this, within the robot's envelope, from the next exchange on.

        Raises:
            RenetError: it is not made of 12 finite numbers each; the one before stands.
        """
        self._command = self._envelope.clamp(command, self.state)
        self.commanded = now

    def exchange(self, now: float) -> None:
        """Read what arrived, send the newest command; raises only what sending itself raises."""
        with self.braked_on_failure():
            self._receive(now)
        if now - self._alive > LIFELESS:
            self._too_old = now  # A command from before the gap must not be obeyed after it.
        silent = now - self.commanded > SILENCE or self.commanded <= self._too_old
        command = self._command
        if command is not None and (silent or self.problem):
            zero = np.zeros_like(command.stiffness)
            command = JointCommand(command.position, zero, zero + BRAKE)
        self._send(command)

    @contextmanager
    def braked_on_failure(self) -> Iterator[None]:
        """Make a problem of what fails in a block: sending on is all that can still brake."""
        try:
            yield
        except Exception as error:
            self.problem = f"the robot's driver failed: {type(error).__name__}: {error}"

    def _news(self, tick: int) -> bool:
        """Whether a reading's 32-bit count is newer than the last, not repeated or out of order."""
        newer = self._tick is None or 0 < (tick - self._tick) % 2**32 < 2**31
        if newer:
            self._tick = tick
        return newer

    @abstractmethod
    def _receive(self, now: float) -> None:
        """Take over the newest reading as `state`, and set `problem` if the robot has one."""

    @abstractmethod
    def _send(self, command: JointCommand | None) -> None:
        """Send a command to the motors; None before the controller's first."""
