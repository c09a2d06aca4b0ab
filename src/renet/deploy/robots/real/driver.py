"""The controller's side of the process that talks to a real robot."""

import json
import mmap
import os
import subprocess
import sys
import threading
import time
from contextlib import suppress
from typing import Any

import numpy as np

from renet.deploy.robots.base import JointCommand, RobotState
from renet.deploy.robots.envelope import Envelope
from renet.deploy.robots.real.braking import HEARTBEAT, PERIOD
from renet.deploy.robots.real.lock import claim
from renet.deploy.robots.real.mailbox import ALIVE, COMMAND, SIZE, VALUES, clock, mailboxes
from renet.errors import RenetError

SINK = 1.0
"""Seconds of braking with which a connection ends; a standing robot sinks to the ground in them."""


class RealRobot:
    """A robot behind a sender process of its own; its clock is this computer's.

    The sender brakes the robot within 20 ms when this process dies, is stopped or gives no sign of
    life, and when no command comes for 0.1 s.
    """

    def __init__(
        self,
        name: str,
        envelope: Envelope,
        link: str,
        settings: tuple[Any, ...],
        no_answer: str,
        timeout: float,
        sink: float = SINK,
    ) -> None:
        """Set up without talking to the robot.

        Args:
            name: of the robot, for messages. envelope: its limits.
            link: MODULE:CLASS of its `braking.Link`. settings: what that is made with, first
            the two that tell this robot from others, such as its address and port.
            no_answer: what to tell the user when the robot does not answer.
            timeout: seconds `connect` waits for the first answer.
            sink: seconds of braking with which the connection ends.
        """
        self.envelope = envelope
        self._name, self._no_answer = name, no_answer
        self._link, self._settings = link, settings
        self._timeout, self._sink = timeout, sink
        self._sender: subprocess.Popen | None = None
        self._stop = threading.Event()

    def connect(self) -> None:
        """Start the sender and wait for the robot; raises RenetError with what to do.

        The sender inherits the lock on the robot: nobody else commands it before the sender ends.
        """
        robot = f"{self._name} at {':'.join(map(str, self._settings[:2]))}"
        with claim(robot) as lock:
            self._start(lock.fileno())
        threading.Thread(target=self._live, daemon=True).start()
        deadline = time.monotonic() + self._timeout
        while self.read() is None:
            problem, dead = self._text("problem"), self._sender.poll() is not None
            if problem or dead or time.monotonic() > deadline:
                problem = problem or self._text("problem")  # A sender's last word.
                self.close()
                raise RenetError(problem or self._no_answer)
            time.sleep(PERIOD)

    def _start(self, lock: int) -> None:
        """Start the sender, which inherits the descriptor of the lock."""
        shared = os.memfd_create("renet-robot")
        os.ftruncate(shared, SIZE)
        self._memory = mmap.mmap(shared, SIZE)
        self._alive, self._commands, self._readings = mailboxes(self._memory)
        pipe, self._pipe = os.pipe()
        command = [sys.executable, "-P", "-m", "renet.deploy.robots.real.sender"]
        arguments = (shared, pipe, self._sink, self._link, json.dumps(self._settings))
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
        reading = None if self._sender is None else self._readings.read()
        if reading is None or not reading["known"]:
            return None
        values: dict[str, Any] = {name: reading[name] for name in VALUES}
        return RobotState(**values)

    def write(self, command: JointCommand) -> None:
        """Hand over a command.

        Raises:
            RenetError: not connected, braked for good, or a command that cannot be sent.
        """
        if self._sender is None:
            raise RenetError(f"the {self._name} is not connected")
        if self._stop.is_set():
            raise RenetError("the connection was closed")
        if self._sender.poll() is not None:
            raise RenetError(f"the process that talks to the {self._name} has died")
        if problem := self._text("problem"):
            raise RenetError(problem)
        within = self.envelope.clamp(command)
        message = (clock(), within.position, within.stiffness, within.damping)
        self._commands.write(np.array(message, COMMAND))

    @property
    def refused(self) -> str:
        """What the system refused the sender, such as real-time priority; empty if nothing."""
        refused = self._text("refused")
        return refused and f"{refused} to the process that talks to the {self._name}"

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
            self._sender.wait(self._sink + 2.0)

    def _live(self) -> None:
        """Give signs of life until the end."""
        while not self._stop.wait(HEARTBEAT):
            self._alive.write(np.array((clock(),), ALIVE))

    def _text(self, name: str) -> str:
        """One of the sender's texts; empty before its first reading."""
        reading = None if self._sender is None else self._readings.read()
        return "" if reading is None else reading[name].decode(errors="replace")
