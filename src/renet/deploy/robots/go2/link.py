"""The Go2's low-level DDS interface (unitree_sdk2, BSD-3)."""

import math
from contextlib import suppress
from typing import Any

import numpy as np
from cyclonedds.core import DDSException

from renet.deploy.robots.base import JointCommand, RobotState
from renet.deploy.robots.envelope import read_envelope
from renet.deploy.robots.go2.messages import LowCmd, LowState, crc
from renet.deploy.robots.go2.network import Network
from renet.deploy.robots.go2.switch import MotionSwitcher
from renet.deploy.robots.real.braking import Link
from renet.descriptions import GO2
from renet.interface import ACTION_SIZE

COMMANDS, STATES = "rt/lowcmd", "rt/lowstate"
MOTORS = slice(0, ACTION_SIZE)
"""The vendor numbers the legs' motors as `interface.JOINTS`; zeros and signs are its model's."""
SERVO = 1
"""Motor mode that obeys position, velocity, gains and torque."""
NO_POSITION, NO_SPEED = 2.146e9, 16000.0
"""Targets that mean none; with zero gains a motor is limp."""
BUTTONS = slice(2, 4)
"""Bytes of the remote's message with one bit for each button."""
QUIET = 0.2
"""Seconds without anybody else's command after which the motors are free."""
RELEASE = 10.0
"""Seconds within which the robot's own controllers must have ended."""


class Go2Link(Link):
    """The exchange with a Go2.

    It commands only once the robot's own controllers have ended and nobody else commands the
    motors. Should one of the robot's modes come back, it falls silent, for two programs that write
    the same motors are worse than one; anybody else's command, or a button of the robot's remote,
    brakes for good.
    """

    def __init__(self, interface: str, domain: int, watch: bool) -> None:
        """Join a DDS domain on a network card; motors are sent nothing before the first command.

        `watch` means only to look: to end no mode, and never to command.
        """
        super().__init__(read_envelope(GO2))
        network = Network(interface, domain)
        self._commands = network.writer(COMMANDS, LowCmd)
        self._others = network.reader(COMMANDS, LowCmd)
        self._states = network.reader(STATES, LowState, depth=8)
        self._switch = MotionSwitcher(network)
        self._watch, self._free = watch, watch
        self._began = self._heard = math.nan
        self._out = LowCmd()
        command = self._out.values
        command["head"], command["level_flag"] = (0xFE, 0xEF), 0xFF
        command["motor_cmd"]["mode"] = SERVO
        command["motor_cmd"]["q"], command["motor_cmd"]["dq"] = NO_POSITION, NO_SPEED

    def _receive(self, now: float) -> None:
        newest = None
        for sample in self._states.take(8):
            values = getattr(sample, "values", None)  # Absent where a writer has left.
            if values is not None and self._news(int(values["tick"])):
                newest = values
        heard = any(getattr(s, "values", None) is not None for s in self._others.take(1))
        if not self._watch:
            self._switch.step(now, release=not self._free)
            self._claim(heard, newest is not None, now)
        if newest is None:
            return
        if newest["wireless_remote"][BUTTONS].any() and self._command is not None:
            self.problem = self.problem or "a button of the robot's remote was pressed"
        if self._free:
            self.state = reading(newest, now)

    def _claim(self, heard: bool, answers: bool, now: float) -> None:
        """Set `_free` once the motors are; afterwards a problem if they are somebody else's again.

        `heard`: somebody else commanded them; `answers`: the robot sent a reading; `now`: seconds.
        """
        mode = self._switch.mode
        if self._free:
            if mode:
                self.problem = self.problem or f"the robot's mode {mode!r} was started again"
            elif heard:
                self.problem = self.problem or "another program commands the robot's motors"
            return
        if math.isnan(self._began):
            if not answers:
                return
            self._began = self._heard = now
        if heard or mode != "":
            self._heard = now
        self._free = now - self._heard > QUIET
        if not self._free and now - self._began > RELEASE:
            self.problem = self.problem or {
                None: "the robot's motion switcher does not answer: is it a Go2 EDU?",
                "": "another program commands the robot's motors: end it first",
            }.get(mode, f"the robot's mode {mode!r} does not end: end it with the remote or app")

    def _send(self, command: JointCommand | None) -> None:
        if command is None or self._watch or not self._free or self._switch.mode:
            return
        motors = self._out.values["motor_cmd"][MOTORS]
        motors["q"], motors["dq"], motors["tau"] = command.position, 0.0, 0.0
        motors["kp"], motors["kd"] = command.stiffness, command.damping
        self._out.values["crc"] = crc(self._out.raw)
        with suppress(DDSException):  # A reader that does not acknowledge: the next is newer.
            self._commands.write(self._out)


def reading(values: Any, now: float) -> RobotState:
    """State in a LowState that came at `now`, s, whose CRC the vendor does not check either."""
    motors, imu = values["motor_state"][MOTORS], values["imu_state"]
    charge = float(values["bms_state"]["soc"]) / 100.0
    return RobotState(
        time=now,
        joint_position=motors["q"].astype(float),
        joint_velocity=motors["dq"].astype(float),
        joint_torque=motors["tau_est"].astype(float),
        quaternion=imu["quaternion"].astype(float),
        angular_velocity=imu["gyroscope"].astype(float),
        temperature=float(np.max(motors["temperature"])),
        battery=charge if charge > 0.0 else math.nan,
    )
