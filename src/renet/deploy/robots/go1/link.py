"""The vendor's low-level UDP interface of the Go1 (unitree_legged_sdk 3.8, BSD-3).

The robot answers every command with a reading. The vendor's library checks length, head and CRC of
what it receives and keeps the newest good packet.
"""

import importlib
import math
import socket
from typing import Any

import numpy as np

from renet.deploy.robots.base import JointCommand, RobotState
from renet.deploy.robots.real.braking import Link, braking
from renet.deploy.robots.real.identity import IN_A_ROW, RESTARTED
from renet.deploy.robots.real.trouble import MotorTrouble
from renet.errors import RenetError, install
from renet.interface import ACTION_SIZE
from renet.robots import GO1

LOW_LEVEL = 0xFF
"""The vendor's number of the interface to single motors."""
_SERVO = 0x0A
"""Motor mode that obeys position, velocity, gains and torque."""
MOTORS = range(ACTION_SIZE)
"""The vendor numbers the motors as `interface.JOINTS`; zeros and signs are its model's."""


def unitree() -> Any:
    """Import the vendor's module, of its wheel or built by hand; raises RenetError without one."""
    problems = []
    for name in ("unitree_legged_sdk.robot_interface", "robot_interface"):
        try:
            return importlib.import_module(name)
        except ImportError as error:
            problems.append(str(error))
    raise RenetError(
        f"the Go1 needs its vendor's driver: {install('go1')} (Python 3.11 or 3.12), or build "
        f"unitree_legged_sdk 3.8 with PYTHON_BUILD ({problems[0]})"
    )


def _require_free(port: int) -> None:
    """Raise RenetError if a program here already talks to a robot; the library would not notice."""
    try:
        # A port is free if it can be bound; the probe gives it back at once.
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("", port))
    except OSError as error:
        raise RenetError(
            f"UDP port {port} is taken: another program already talks to the Go1; end it first"
        ) from error


class Go1Link(Link):
    """Exchange of commands and readings with a Go1.

    It is braked for good by a failure of the vendor's driver, by its overload guard, and when
    another robot answers at the same address.
    """

    leap = 100_000
    """Largest leap of the robot's count: 0.1 s, if it counts microseconds as the vendor says."""

    def __init__(self, host: str, port: int, local_port: int, power_level: int) -> None:
        """Open the socket; motors stay limp until the first command.

        The robot's motor board at `host` and `port` answers to `local_port`; `power_level` is that
        of the vendor's overload guard.

        Raises:
            RenetError: The vendor's driver is missing, or another program uses the local port.
        """
        super().__init__(GO1)
        sdk = unitree()
        _require_free(local_port)
        self._udp = sdk.UDP(LOW_LEVEL, local_port, host, port)
        self._safety = sdk.Safety(sdk.LeggedType.Go1)
        self._level = power_level
        self._out = sdk.LowCmd()
        self._in = sdk.LowState()
        self._udp.InitCmdData(self._out)
        self._trouble = MotorTrouble()
        self._serial: tuple[int, ...] | None = None
        self._strangers = 0

    def _send(self, command: JointCommand | None) -> None:
        self._fill(command)
        # The guard judges by the newest reading, so it waits for the first.
        if self.state and self._safety.PowerProtect(self._out, self._in, self._level) < 0:
            self.problem = "the vendor's guard says that the motors draw too much power"
            # This very message must brake, not only the next one.
            self._fill(None if command is None else braking(command))
        self._udp.SetSend(self._out)
        self._udp.Send()

    def _fill(self, command: JointCommand | None) -> None:
        """Put a command into the message to the motors; None leaves the one before."""
        for joint, motor in enumerate(MOTORS):
            servo = self._out.motorCmd[motor]
            servo.mode = _SERVO
            if command is None:
                continue
            servo.q = command.position[joint]
            servo.dq = 0.0
            servo.tau = 0.0
            servo.Kp = command.stiffness[joint]
            servo.Kd = command.damping[joint]

    def _receive(self, now: float) -> None:
        self._udp.Recv()
        self._udp.GetRecv(self._in)
        # The library keeps the last packet for ever; its first, empty one has no tick.
        if self._in.tick and self._news(self._in.tick) and self._is_same_robot():
            self.state = self._reading(now)

    def _is_same_robot(self) -> bool:
        """Return True if the newest reading has the serial number of the first."""
        serial = tuple(self._in.SN)
        if self._serial is None:
            self._serial = serial
        self._strangers = 0 if serial == self._serial else self._strangers + 1
        if self._strangers >= IN_A_ROW:
            self.problem = self.problem or RESTARTED
        return self._strangers == 0

    def _reading(self, now: float) -> RobotState:
        """Return the newest packet as a reading that came at `now`, s."""
        motors = [self._in.motorState[motor] for motor in MOTORS]
        modes = np.array([motor.mode for motor in motors])
        return RobotState(
            time=now,
            joint_position=np.array([motor.q for motor in motors]),
            joint_velocity=np.array([motor.dq for motor in motors]),
            joint_torque=np.array([motor.tauEst for motor in motors]),
            quaternion=np.array(self._in.imu.quaternion),
            angular_velocity=np.array(self._in.imu.gyroscope),
            temperature=np.array([motor.temperature for motor in motors], float),
            battery=self._in.bms.SOC / 100.0,
            voltage=sum(self._in.bms.cell_vol) / 1000.0 or math.nan,
            fault=self._trouble.look(modes, np.zeros(ACTION_SIZE), self.commanded, now),
        )
