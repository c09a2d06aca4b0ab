"""Driver of a real robot: the controller's side of the process that talks to the robot."""

import json
import mmap
import os
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from renet.deploy.robots.base import JointCommand, RobotState
from renet.deploy.robots.envelope import clamp
from renet.deploy.robots.real.braking import HEARTBEAT, PERIOD
from renet.deploy.robots.real.lock import claim
from renet.deploy.robots.real.mailbox import (
    ALIVE_LAYOUT,
    COMMAND_LAYOUT,
    READING_LAYOUT,
    SIZE,
    VALUES,
    clock,
    mailboxes,
)
from renet.errors import RenetError
from renet.robots import Robot


@dataclass
class RealRobot:
    """Robot behind a sender process of its own; its clock is this computer's.

    The sender brakes the robot within 20 ms if this process dies, is stopped or gives no sign of
    life, and if no command comes for 0.1 s.
    """

    name: str
    description: Robot
    link: str
    """MODULE:CLASS of the robot's `braking.Link`."""
    settings: tuple[Any, ...]
    """Arguments of the link; the first two, such as address and port, tell robots apart."""
    no_answer: str
    """Message for the user if the robot does not answer."""
    timeout: float = 5.0
    """Time that `connect` waits for the first answer, s."""
    sink: float = 1.0
    """Time of braking at the end of a connection, s: a standing robot sinks to the ground."""

    def __post_init__(self) -> None:
        self._sender: subprocess.Popen | None = None
        self._stop = threading.Event()

    def connect(self) -> None:
        """Start the sender and wait for the robot; raises RenetError with what to do.

        The sender inherits the lock on the robot: nobody else commands it before the sender ends.
        """
        robot = f"{self.name} at {':'.join(map(str, self.settings[:2]))}"
        with claim(robot) as lock:
            self._start(lock.fileno())
        threading.Thread(target=self._live, daemon=True).start()
        deadline = time.monotonic() + self.timeout
        while self.read() is None:
            dead = self._sender.poll() is not None
            if dead or self._problem or time.monotonic() > deadline:
                # Read anew, for the sender's last word.
                problem = self._problem or self.no_answer
                self.close()
                raise RenetError(problem)
            time.sleep(PERIOD)

    def _start(self, lock: int) -> None:
        """Start the sender, which inherits the descriptor of the lock."""
        shared = os.memfd_create("renet-robot")
        os.ftruncate(shared, SIZE)
        self._memory = mmap.mmap(shared, SIZE)
        self._alive, self._commands, self._readings = mailboxes(self._memory)
        # The system closes this end of the pipe however this process dies.
        pipe, self._pipe = os.pipe()
        command = [sys.executable, "-P", "-m", "renet.deploy.robots.real.sender"]
        arguments = (shared, pipe, self.sink, self.link, json.dumps(self.settings))
        self._sender = subprocess.Popen(
            [*command, *map(str, arguments)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            pass_fds=(shared, pipe, lock),
            start_new_session=True,
        )
        os.close(shared)
        os.close(pipe)

    def read(self) -> RobotState | None:
        """Return the newest reading, without waiting; None before the first."""
        reading = self._reading()
        if not reading["valid"]:
            return None
        values: dict[str, Any] = {name: reading[name] for name in VALUES}
        return RobotState(**values, fault=reading["fault"].item().decode(errors="replace"))

    def write(self, command: JointCommand) -> None:
        """Hand a command over to the sender.

        Raises:
            RenetError: The robot is not connected or is braked for good, or the command is not one
                of finite numbers.
        """
        if self._sender is None:
            raise RenetError(f"the {self.name} is not connected")
        if self._stop.is_set():
            raise RenetError("the connection was closed")
        if self._sender.poll() is not None:
            raise RenetError(f"the process that talks to the {self.name} has died")
        if self._problem:
            raise RenetError(self._problem)
        within = clamp(self.description, command)
        message = (clock(), within.position, within.stiffness, within.damping)
        self._commands.write(np.array(message, COMMAND_LAYOUT))

    @property
    def refused(self) -> str:
        """Message of what the system refused the sender, such as priority; empty if nothing."""
        refused = self._reading()["refused"].item().decode(errors="replace")
        return refused and f"{refused} to the process that talks to the {self.name}"

    def now(self) -> float:
        """Return the time on this computer's clock, s, which goes on while it sleeps."""
        return clock()

    def wait(self, until: float) -> None:
        """Sleep until the clock reaches `until`."""
        time.sleep(max(0.0, until - clock()))

    def close(self) -> None:
        """Let go: a robot that was commanded is braked while it sinks, then left limp."""
        if self._sender is None or self._stop.is_set():
            return
        self._stop.set()
        os.close(self._pipe)
        with suppress(subprocess.TimeoutExpired):
            self._sender.wait(self.sink + 2.0)

    def _live(self) -> None:
        """Give signs of life until the end."""
        while not self._stop.wait(HEARTBEAT):
            self._alive.write(np.array((clock(),), ALIVE_LAYOUT))

    def _reading(self) -> np.ndarray:
        """Return the sender's newest message, of `READING_LAYOUT`; zeros before the first."""
        reading = None if self._sender is None else self._readings.read()
        return np.zeros((), READING_LAYOUT) if reading is None else reading

    @property
    def _problem(self) -> str:
        return self._reading()["problem"].item().decode(errors="replace")
