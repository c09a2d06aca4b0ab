"""Unitree Go1 through the vendor's low-level UDP interface (unitree_legged_sdk 3.8, BSD-3).

The robot answers every command with a reading, so a thread talks to it at 500 Hz and repeats the
newest command. If the control loop falls silent, that thread brakes the robot by itself. The
vendor's library checks length, head and CRC of what it receives and keeps the newest good packet.
"""

from __future__ import annotations

import importlib
import socket
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from renet.deploy.robots.base import JointCommand, RobotState
from renet.errors import RenetError
from renet.interface import JOINTS

ROBOT_HOST, ROBOT_PORT, LOCAL_PORT = "192.168.123.10", 8007, 8080
LOW_LEVEL = 0xFF
SERVO = 0x0A
"""Motor mode that obeys position, velocity, gains and torque."""
PERIOD = 0.002
"""Seconds between two exchanges; the vendor's rate."""
SILENCE = 0.1
"""Seconds without a new command after which the robot is braked."""
BRAKE = 3.0
"""Kd of that brake, N m s/rad."""
SINK = 1.0
"""Seconds of braking with which a connection ends; a standing Go1 sinks to the ground in them."""
MAX_STIFFNESS, MAX_DAMPING = 1023.0, 2047.0
"""N m/rad, N m s/rad. The library sends gains as 16-bit integers of 1/32 and 1/16: a larger one
would arrive as another number, 1100 as -948."""
POWER_LEVEL = 9
"""Of the vendor's own overload guard: 1 (10 % of the motors' power) to 10."""

MOTOR_LEGS = ("FR", "FL", "RR", "RL")
MOTORS = tuple(
    3 * MOTOR_LEGS.index(name.split("_")[0]) + ("hip", "thigh", "calf").index(name.split("_")[1])
    for name in JOINTS
)
"""The vendor's motor number of each joint; zero and sign of both are the vendor's model's."""


def unitree() -> Any:
    """The vendor's module, from its wheel or built by hand; raises RenetError if there is none."""
    problems = []
    for name in ("unitree_legged_sdk.robot_interface", "robot_interface"):
        try:
            return importlib.import_module(name)
        except ImportError as error:
            problems.append(str(error))
    raise RenetError(
        "the Go1 needs its vendor's driver: pip install 'renet[go1]' (Python 3.11 or 3.12), or "
        f"build unitree_legged_sdk 3.8 with PYTHON_BUILD ({problems[0]})"
    )


def _check(command: JointCommand) -> None:
    """Refuse what would reach the motors as something else."""
    for name, low, high in (
        ("position", -np.inf, np.inf),
        ("stiffness", 0.0, MAX_STIFFNESS),
        ("damping", 0.0, MAX_DAMPING),
    ):
        value = np.asarray(getattr(command, name), float)
        if value.shape != (len(JOINTS),) or not np.isfinite(value).all():
            raise RenetError(f"the command's {name} must be {len(JOINTS)} finite numbers")
        if not ((low <= value) & (value <= high)).all():
            raise RenetError(f"the command's {name} must be within {low:g} and {high:g}")


def _claim(port: int) -> None:
    """Raise RenetError if this computer already talks to a robot; the library would not mind."""
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("", port))
    except OSError as error:
        raise RenetError(
            f"UDP port {port} is taken: another program already talks to the Go1; end it first"
        ) from error


class Go1Link:
    """One exchange after the other with the robot; no thread, no clock of its own.

    `now` is the time of the exchange on whichever clock the caller keeps.
    """

    def __init__(self, host: str, port: int, local_port: int, power_level: int) -> None:
        """Open the socket; motors stay limp until the first command."""
        sdk = unitree()
        self._udp = sdk.UDP(LOW_LEVEL, local_port, host, port)
        self._safety = sdk.Safety(sdk.LeggedType.Go1)
        self._level = power_level
        self._out, self._in = sdk.LowCmd(), sdk.LowState()
        self._udp.InitCmdData(self._out)
        self._command: JointCommand | None = None
        self._commanded = 0.0
        self._tick: int | None = None
        self.state: RobotState | None = None
        """Newest reading; its time stands still when the robot falls silent."""
        self.problem = ""
        """Why the robot is braked for good; empty while it is not."""

    @property
    def moved(self) -> bool:
        """Whether the joints were ever commanded: until then they are limp."""
        return self._command is not None

    def command(self, command: JointCommand, now: float) -> None:
        """Send this from the next exchange on; raises RenetError if it cannot be sent."""
        _check(command)
        self._commanded, self._command = now, command

    def exchange(self, now: float) -> None:
        """Read what arrived, send the newest command."""
        self._udp.Recv()
        self._udp.GetRecv(self._in)
        # The library keeps the last packet for ever: the robot's own counter tells a new one.
        if self._in.tick not in (0, self._tick):
            self._tick, self.state = self._in.tick, self._reading(now)
        command, silent = self._command, now - self._commanded > SILENCE
        for joint, motor in enumerate(MOTORS):
            servo = self._out.motorCmd[motor]
            servo.mode = SERVO
            if command is None:
                continue
            servo.dq = servo.tau = 0.0
            if silent or self.problem:
                servo.Kp, servo.Kd = 0.0, BRAKE
            else:
                servo.q = command.position[joint]
                servo.Kp, servo.Kd = command.stiffness[joint], command.damping[joint]
        if self.state and self._safety.PowerProtect(self._out, self._in, self._level) < 0:
            self.problem = "the vendor's guard says that the motors draw too much power"
        self._udp.SetSend(self._out)
        self._udp.Send()

    def _reading(self, now: float) -> RobotState:
        motors = [self._in.motorState[motor] for motor in MOTORS]
        return RobotState(
            time=now,
            joint_position=np.array([motor.q for motor in motors]),
            joint_velocity=np.array([motor.dq for motor in motors]),
            joint_torque=np.array([motor.tauEst for motor in motors]),
            quaternion=np.array(self._in.imu.quaternion),
            angular_velocity=np.array(self._in.imu.gyroscope),
        )


class Go1Robot:
    """See `robots.base.Robot`; its clock is this computer's."""

    def __init__(
        self,
        host: str = ROBOT_HOST,
        port: int = ROBOT_PORT,
        local_port: int = LOCAL_PORT,
        power_level: int = POWER_LEVEL,
        clock: Callable[[], float] = time.monotonic,
        patience: float = 3.0,
    ) -> None:
        """Set up without talking to the robot.

        Args:
            host, port: of the robot's motor board. local_port: where it answers to.
            power_level: of the vendor's overload guard. clock: seconds, never decreasing.
            patience: seconds `connect` waits for the first answer.
        """
        if not 1 <= power_level <= 10:
            raise RenetError(f"the Go1's power level must be 1 to 10, got {power_level}")
        self._address = (host, port, local_port, power_level)
        self._clock, self._patience = clock, patience
        self._link: Go1Link | None = None
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def connect(self) -> None:
        """See Robot.connect."""
        host, port, local_port, _ = self._address
        _claim(local_port)
        self._link = Go1Link(*self._address)
        self._thread = threading.Thread(target=self._talk, args=(self._link,), daemon=True)
        self._thread.start()
        deadline = time.monotonic() + self._patience
        while self._link.state is None:
            if time.monotonic() > deadline:
                self.close()
                raise RenetError(
                    f"no answer from a Go1 at {host}:{port}: check the cable and this computer's "
                    "address (192.168.123.x), and that the robot is in low-level mode (L2+A, "
                    "L2+B, then L1+L2+START, hanging or lying)"
                )
            time.sleep(PERIOD)

    def read(self) -> RobotState | None:
        """See Robot.read."""
        return None if self._link is None else self._link.state

    def write(self, command: JointCommand) -> None:
        """See Robot.write; raises RenetError for what cannot be sent, or while braked for good."""
        if self._link is None:
            raise RenetError("the Go1 is not connected")
        if self._link.problem:
            raise RenetError(self._link.problem)
        with self._lock:
            self._link.command(command, self._clock())

    def now(self) -> float:
        """See Robot.now."""
        return self._clock()

    def wait(self, until: float) -> None:
        """See Robot.wait."""
        time.sleep(max(0.0, until - self._clock()))

    def close(self) -> None:
        """See Robot.close; a robot that was commanded is braked while it sinks, then left limp."""
        if self._link is None or self._thread is None or not self._thread.is_alive():
            return
        self._link.problem = self._link.problem or "the connection was closed"
        if self._link.moved:
            time.sleep(SINK)
        self._stop.set()
        self._thread.join(timeout=1.0)

    def _talk(self, link: Go1Link) -> None:
        due = time.monotonic()
        while not self._stop.is_set():
            try:
                with self._lock:
                    link.exchange(self._clock())
            except Exception as error:  # Talking on is all that can still brake the robot.
                link.problem = f"the vendor's driver failed: {type(error).__name__}: {error}"
            due = max(due + PERIOD, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))
