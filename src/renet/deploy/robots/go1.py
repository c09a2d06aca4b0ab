"""Unitree Go1: the controller's side of the process that talks to the robot."""

import mmap
import os
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from typing import Any

import numpy as np

from renet.deploy.robots.base import JointCommand, RobotState
from renet.deploy.robots.envelope import go1_envelope
from renet.deploy.robots.go1_link import HEARTBEAT, PERIOD, unitree
from renet.deploy.robots.go1_sender import ALIVE, COMMAND, SINK, SIZE, VALUES, clock, mailboxes
from renet.errors import RenetError

ROBOT_HOST, ROBOT_PORT, LOCAL_PORT = "192.168.123.10", 8007, 8080
POWER_LEVEL = 9
"""Of the vendor's own overload guard: 1 (10 % of the motors' power) to 10."""


class Go1Robot:
    """A Go1 behind a sender process of its own; its clock is this computer's.

    The sender brakes the robot within 20 ms when this process dies, is stopped or gives no sign of
    life, and when no command comes for 0.1 s.
    """

    def __init__(
        self,
        host: str = ROBOT_HOST,
        port: int = ROBOT_PORT,
        local_port: int = LOCAL_PORT,
        power_level: int = POWER_LEVEL,
        timeout: float = 5.0,
        sink: float = SINK,
    ) -> None:
        """Set up without talking to the robot.

        Args:
            host, port: of the robot's motor board. local_port: where it answers to.
            power_level: of the vendor's overload guard.
            timeout: seconds `connect` waits for the first answer.
            sink: seconds of braking with which the connection ends.
        """
        if not 1 <= power_level <= 10:
            raise RenetError(f"the Go1's power level must be 1 to 10, got {power_level}")
        self.envelope = go1_envelope()
        self._address = (host, port, local_port, power_level)
        self._timeout, self._sink = timeout, sink
        self._sender: subprocess.Popen | None = None
        self._stop = threading.Event()

    def connect(self) -> None:
        """Start the sender and wait for the robot; raises RenetError with what to do."""
        host, port, local_port, _ = self._address
        unitree()
        _claim(local_port)
        shared = os.memfd_create("renet-go1")
        os.ftruncate(shared, SIZE)
        self._memory = mmap.mmap(shared, SIZE)
        self._alive, self._commands, self._readings = mailboxes(self._memory)
        pipe, self._pipe = os.pipe()
        command = [sys.executable, "-P", "-m", "renet.deploy.robots.go1_sender"]
        settings = (shared, pipe, *self._address, self._sink)
        self._sender = subprocess.Popen(
            [*command, *map(str, settings)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            pass_fds=(shared, pipe),
            start_new_session=True,
        )
        os.close(shared)
        os.close(pipe)
        threading.Thread(target=self._live, daemon=True).start()
        deadline = time.monotonic() + self._timeout
        while self.read() is None:
            if time.monotonic() > deadline or self._sender.poll() is not None:
                self.close()
                raise RenetError(
                    f"no answer from a Go1 at {host}:{port}: check the cable and this computer's "
                    "address (192.168.123.x), and that the robot is in low-level mode (L2+A, "
                    "L2+B, then L1+L2+START, hanging or lying)"
                )
            time.sleep(PERIOD)

    def read(self) -> RobotState | None:
        """Newest reading, without waiting; None before the first."""
        found = None if self._sender is None else self._readings.read()
        if found is None or not found["known"]:
            return None
        values: dict[str, Any] = {name: found[name] for name in VALUES}
        return RobotState(**values)

    def write(self, command: JointCommand) -> None:
        """Hand over a command.

        Raises:
            RenetError: not connected, braked for good, or a command that cannot be sent.
        """
        if self._sender is None:
            raise RenetError("the Go1 is not connected")
        if self._stop.is_set():
            raise RenetError("the connection was closed")
        if self._sender.poll() is not None:
            raise RenetError("the process that talks to the Go1 has died")
        found = self._readings.read()
        if found is not None and found["problem"]:
            raise RenetError(found["problem"].decode(errors="replace"))
        within = self.envelope.clamp(command)
        message = (clock(), within.position, within.stiffness, within.damping)
        self._commands.write(np.array(message, COMMAND))

    @property
    def refused(self) -> str:
        """What the system refused the sender, such as real-time priority; empty if nothing."""
        found = None if self._sender is None else self._readings.read()
        said = "" if found is None else found["refused"].decode(errors="replace")
        return said and f"{said} to the process that talks to the Go1"

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


def _claim(port: int) -> None:
    """Raise RenetError if this computer already talks to a robot; the library would not mind."""
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("", port))
    except OSError as error:
        raise RenetError(
            f"UDP port {port} is taken: another program already talks to the Go1; end it first"
        ) from error
