"""The vendor's low-level UDP interface of the Go1 (unitree_legged_sdk 3.8, BSD-3).

The robot answers every command with a reading. The vendor's library checks length, head and CRC of
what it receives and keeps the newest good packet.
"""

import importlib
import math
from typing import Any

import numpy as np

from renet.deploy.robots.base import JointCommand, RobotState
from renet.deploy.robots.envelope import go1_envelope
from renet.errors import RenetError
from renet.interface import JOINTS

LOW_LEVEL = 0xFF
SERVO = 0x0A
"""Motor mode that obeys position, velocity, gains and torque."""
PERIOD = 0.002
"""Seconds between two exchanges; the vendor's rate."""
HEARTBEAT = 0.004
"""Seconds between two signs of life of the controller's process."""
LIFELESS = 0.014
"""Seconds without one after which the robot is braked: on the wire within 20 ms."""
SILENCE = 0.1
"""Seconds without a new command after which the robot is braked."""
BRAKE = 3.0
"""Kd of that brake, N m s/rad."""

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
        "the Go1 needs its vendor's driver: pip install 'renet-locomotion[go1]' (Python 3.11 or "
        f"3.12), or build unitree_legged_sdk 3.8 with PYTHON_BUILD ({problems[0]})"
    )


class Go1Link:
    """One exchange after the other with the robot; no thread, no clock of its own.

    It brakes the robot by itself when the controller's process gives no sign of life, when no new
    command comes, and for good when the vendor's driver or its overload guard fails. `now` is the
    time on whichever clock the caller keeps.
    """

    def __init__(self, host: str, port: int, local_port: int, power_level: int) -> None:
        """Open the socket; motors stay limp until the first command."""
        sdk = unitree()
        self._udp = sdk.UDP(LOW_LEVEL, local_port, host, port)
        self._safety = sdk.Safety(sdk.LeggedType.Go1)
        self._level = power_level
        self._out, self._in = sdk.LowCmd(), sdk.LowState()
        self._udp.InitCmdData(self._out)
        self._envelope = go1_envelope()
        self._command: JointCommand | None = None
        self.commanded = -math.inf
        """When the newest command was given; -inf before the first: until then joints are limp."""
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
        try:
            self._receive(now)
        except Exception as error:  # Sending on is all that can still brake the robot.
            self.problem = f"the vendor's driver failed: {type(error).__name__}: {error}"
        if now - self._alive > LIFELESS:
            self._too_old = now  # A command from before the gap must not be obeyed after it.
        silent = now - self.commanded > SILENCE or self.commanded <= self._too_old
        for joint, motor in enumerate(MOTORS):
            servo = self._out.motorCmd[motor]
            servo.mode = SERVO
            if self._command is None:
                continue
            servo.dq = servo.tau = 0.0
            if silent or self.problem:
                servo.Kp, servo.Kd = 0.0, BRAKE
            else:
                servo.q = self._command.position[joint]
                servo.Kp, servo.Kd = self._command.stiffness[joint], self._command.damping[joint]
        if self.state and self._safety.PowerProtect(self._out, self._in, self._level) < 0:
            self.problem = "the vendor's guard says that the motors draw too much power"
        self._udp.SetSend(self._out)
        self._udp.Send()

    def _receive(self, now: float) -> None:
        self._udp.Recv()
        self._udp.GetRecv(self._in)
        # The library keeps the last packet for ever: the robot's own counter, of 32 bits, tells a
        # newer one from the same again and from an older one that came out of order.
        tick = self._in.tick
        if tick and (self._tick is None or 0 < (tick - self._tick) % 2**32 < 2**31):
            self._tick, self.state = tick, self._reading(now)

    def _reading(self, now: float) -> RobotState:
        motors = [self._in.motorState[motor] for motor in MOTORS]
        charge = self._in.bms.SOC / 100.0
        return RobotState(
            time=now,
            joint_position=np.array([motor.q for motor in motors]),
            joint_velocity=np.array([motor.dq for motor in motors]),
            joint_torque=np.array([motor.tauEst for motor in motors]),
            quaternion=np.array(self._in.imu.quaternion),
            angular_velocity=np.array(self._in.imu.gyroscope),
            temperature=float(max(motor.temperature for motor in motors)),
            battery=charge if charge > 0.0 else math.nan,
        )
