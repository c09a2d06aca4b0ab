"""The controller's side of the process that talks to a real robot."""

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
from renet.deploy.robots.real.mailbox import ALIVE, COMMAND, READING, SIZE, VALUES, clock, mailboxes
from renet.errors import RenetError
from renet.robots import Robot


@dataclass
class RealRobot:
    """A robot behind a sender process of its own; its clock is this computer's.

    The sender brakes the robot within 20 ms when this process dies, is stopped or gives no sign of
    life, and when no command comes for 0.1 s.
    """

    name: str
    description: Robot
    link: str
    """MODULE:CLASS of its `braking.Link`."""
    settings: tuple[Any, ...]
    """What the link is made with; the first two, such as address and port, tell robots apart."""
    no_answer: str
    """What to tell the user when the robot does not answer."""
    timeout: float = 5.0
    """Seconds `connect` waits for the first answer."""
    sink: float = 1.0
    """Seconds of braking with which a connection ends: a standing robot sinks to the ground."""

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
                problem = self._problem or self.no_answer  # Read anew: a sender's last word.
                self.close()
                raise RenetError(problem)
            time.sleep(PERIOD)

    def _start(self, lock: int) -> None:
        """Start the sender, which inherits the descriptor of the lock."""
        shared = os.memfd_create("renet-robot")
        os.ftruncate(shared, SIZE)
        self._memory = mmap.mmap(shared, SIZE)
        self._alive, self._commands, self._readings = mailboxes(self._memory)
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
        """Newest reading, without waiting; None before the first."""
        reading = self._reading()
        if not reading["valid"]:
            return None
        values: dict[str, Any] = {name: reading[name] for name in VALUES}
        return RobotState(**values, fault=reading["fault"].item().decode(errors="replace"))

    def write(self, command: JointCommand) -> None:
        """Hand over a command.

        Raises:
            RenetError: not connected, braked for good, or a command that cannot be sent.
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
        self._commands.write(np.array(message, COMMAND))

    @property
    def refused(self) -> str:
        """What the system refused the sender, such as real-time priority; empty if nothing."""
        refused = self._reading()["refused"].item().decode(errors="replace")
        return refused and f"{refused} to the process that talks to the {self.name}"

    def now(self) -> float:
        """Seconds on this computer's clock, which goes on while it sleeps."""
        return clock()

    def wait(self, until: float) -> None:
        """Sleep until the clock reaches `until`."""
        time.sleep(max(0.0, until - clock()))

    def close(self) -> None:
        """Let go; a robot that was commanded is braked while it sinks, then left limp."""
        if self._sender is None or self._stop.is_set():
            return
        self._stop.set()
        os.close(self._pipe)
        with suppress(subprocess.TimeoutExpired):
            self._sender.wait(self.sink + 2.0)

    def _live(self) -> None:
        """Give signs of life until the end."""
        while not self._stop.wait(HEARTBEAT):
            self._alive.write(np.array((clock(),), ALIVE))

    def _reading(self) -> np.ndarray:
        """What the sender last said, of layout `READING`; zeros before its first word."""
        reading = None if self._sender is None else self._readings.read()
        return np.zeros((), READING) if reading is None else reading

    @property
    def _problem(self) -> str:
        return self._reading()["problem"].item().decode(errors="replace")
