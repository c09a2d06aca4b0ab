"""A simulated Go1 behind the vendor's module, so that renet's own link to a Go1 talks to it.

The wire between them may garble, lose or mix up packets, and a robot may report what real ones do:
heat, an empty battery, a motor that leaves its mode, another robot's serial number.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np

from hardware_faults import FailingRobot
from renet.deploy.robots.base import VECTORS, JointCommand, RobotState
from renet.deploy.robots.go1 import link as go1
from renet.deploy.robots.go1.driver import POWER_LEVEL
from renet.interface import ACTION_SIZE

SERVO = 10
"""Mode of a motor that obeys."""
COLD = 35.0
"""°C of a motor that has rested."""
CELLS = 6
"""Cells of the battery, of 3.7 V each."""
_COUNTS = 2**32
_NO_POSITION = 1e9
"""Targets beyond it, rad, mean none to the vendor's motors."""
_OWN = (1, 2)
_STRANGER = (7, 8)
"""Serial numbers of the robot, and of another one."""
_MOTORS = 20
"""Motors in the vendor's messages, of which a Go1 has 12."""


class Wire:
    """Packets from a robot and commands to it; its attributes say what goes wrong."""

    def __init__(
        self,
        robot: FailingRobot,
        random: np.random.Generator,
        on_command: Callable[[JointCommand], None] = lambda command: None,
    ) -> None:
        """Join a robot; `on_command` hears of every command before its motors do."""
        self._robot = robot
        self._random = random
        self._on_command = on_command
        self._first = int(random.integers(_COUNTS))
        """Count of the robot's readings, µs, at time zero; it may wrap around at any time."""
        self._turn = 0
        self.heal()

    def heal(self) -> None:
        """Put everything right."""
        self.damaged = False
        """Nine of ten packets have a wrong CRC, and the vendor's library drops them."""
        self.miscounts = False
        """Half of the packets have a wrong count."""
        self.absurd = 0
        """Packets to come of which a sensor's number is absurd, although their CRC is right."""
        self.stranger = False
        """Every other packet is another robot's."""
        self.broken = False
        """The vendor's library raises an exception."""
        self.overloaded = False
        """The vendor's guard finds that the motors draw too much power."""
        self.lifeless = False
        """The controller's process gives no sign of life."""
        self.modes = np.full(ACTION_SIZE, SERVO)
        self.temperature = np.full(ACTION_SIZE, COLD)
        """[12] °C"""
        self.charge = 1.0
        """Of the battery, 0 to 1."""

    def restart(self) -> None:
        """Let the robot count anew, as one does that is switched off and on."""
        self._first = -round(1e6 * self._robot.now())

    def link(self) -> go1.Go1Link:
        """Make renet's own link to this robot."""
        with patch.object(go1, "unitree", self._module):
            return go1.Go1Link("127.0.0.1", 0, 0, POWER_LEVEL)

    def packet(self) -> SimpleNamespace | None:
        """Return what came from the robot; None if the vendor's library dropped it."""
        if self.broken:
            raise OSError("the socket is gone")
        self._turn += 1
        random = self._random
        if self.damaged and random.random() < 0.9:
            return None
        # A robot that just started counts from one: the library's own empty packet has a zero.
        tick = (self._first + round(1e6 * self._robot.now()) + 1) % _COUNTS
        serial = _OWN
        if self.stranger and self._turn % 2:
            serial = _STRANGER
            tick = (tick + _COUNTS // 3) % _COUNTS
        if self.miscounts and random.random() < 0.5:
            tick = int(random.integers(_COUNTS))
        state = self._robot.read()
        if self.absurd > 0:
            self.absurd -= 1
            state = spoilt(state, random)
        return self._packed(tick, serial, state)

    def _packed(self, tick: int, serial: tuple[int, int], state: RobotState) -> SimpleNamespace:
        """Return the vendor's message of a reading."""
        motors = []
        for joint in range(ACTION_SIZE):
            motor = SimpleNamespace(
                mode=int(self.modes[joint]),
                q=float(state.joint_position[joint]),
                dq=float(state.joint_velocity[joint]),
                tauEst=float(state.joint_torque[joint]),
                temperature=int(self.temperature[joint]),
            )
            motors.append(motor)
        imu = SimpleNamespace(quaternion=state.quaternion, gyroscope=state.angular_velocity)
        bms = SimpleNamespace(SOC=int(100.0 * self.charge), cell_vol=[3700] * CELLS)
        return SimpleNamespace(tick=tick, SN=serial, motorState=motors, imu=imu, bms=bms)

    def obey(self, sent: SimpleNamespace) -> None:
        """Hand the vendor's command over to the motors."""
        motors = sent.motorCmd[:ACTION_SIZE]
        values = np.array([(motor.q, motor.Kp, motor.Kd) for motor in motors], float)
        none = np.abs(values[:, 0]) > _NO_POSITION
        values[none, :2] = 0.0
        command = JointCommand(*values.T)
        if not none.all():
            self._on_command(command)
        self._robot.write(command)

    def _module(self) -> Any:
        """Return what renet uses of the vendor's module."""
        return SimpleNamespace(
            LowCmd=_low_cmd,
            LowState=lambda: SimpleNamespace(tick=0, SN=_OWN),
            UDP=lambda *address: Udp(self),
            Safety=lambda robot: SimpleNamespace(PowerProtect=self._protect),
            LeggedType=SimpleNamespace(Go1="Go1"),
        )

    def _protect(self, sent: SimpleNamespace, received: SimpleNamespace, level: int) -> int:
        return -1 if self.overloaded else 0


class Udp:
    """The vendor's socket, with the names of its methods."""

    def __init__(self, wire: Wire) -> None:
        self._wire = wire
        self._newest: SimpleNamespace | None = None
        self._sent: SimpleNamespace | None = None

    def InitCmdData(self, command: SimpleNamespace) -> None:
        """Do nothing: commands begin without a target."""

    def Recv(self) -> None:
        """Take what came, and keep the newest good packet."""
        self._newest = self._wire.packet() or self._newest

    def GetRecv(self, state: SimpleNamespace) -> None:
        """Copy the newest good packet."""
        if self._newest is not None:
            vars(state).update(vars(self._newest))

    def SetSend(self, command: SimpleNamespace) -> None:
        """Keep a command to be sent."""
        self._sent = command

    def Send(self) -> None:
        """Send it."""
        assert self._sent is not None
        self._wire.obey(self._sent)


def _low_cmd() -> SimpleNamespace:
    """Return a command without a target."""
    motors = []
    for _ in range(_MOTORS):
        motors.append(SimpleNamespace(mode=0, q=2 * _NO_POSITION, dq=0.0, tau=0.0, Kp=0.0, Kd=0.0))
    return SimpleNamespace(motorCmd=motors)


def spoilt(state: RobotState, random: np.random.Generator) -> RobotState:
    """Return a reading of which one number is absurd: not finite, or of any size."""
    name = str(random.choice(list(VECTORS)))
    vector = getattr(state, name).copy()
    size = 10.0 ** random.uniform(-2.0, 12.0)
    absurd = (math.nan, math.inf, size, -size)
    vector[random.integers(len(vector))] = absurd[random.integers(len(absurd))]
    return replace(state, **{name: vector})
