"""The Go2's low-level DDS interface (unitree_sdk2, BSD-3)."""

import math
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from cyclonedds.core import DDSException

from renet.deploy.robots.base import JointCommand, RobotState
from renet.deploy.robots.envelope import clamp
from renet.deploy.robots.go2.integrity import Integrity
from renet.deploy.robots.go2.messages import LowCmd, LowState, crc
from renet.deploy.robots.go2.network import Network
from renet.deploy.robots.go2.switch import MotionSwitcher
from renet.deploy.robots.real.braking import BRAKE, Link
from renet.deploy.robots.real.identity import IN_A_ROW, RESTARTED, Speakers
from renet.deploy.robots.real.trouble import MotorTrouble
from renet.interface import ACTION_SIZE
from renet.robots import GO2

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
LISTEN = 1.0
"""Seconds for which it is listened who answers, before anything is asked to change."""
HOLD = 40.0
"""Kp with which the robot is held as it lies from the release to the controller's first command."""
MOST_BEYOND = 0.4
"""rad by which the targets of that hold may be beyond the joints, so that they bear their load."""
SETTLES = 0.05
"""Seconds after a release for which commands of the robot's own controllers may still arrive."""
NO_SWITCH = "the robot's motion switcher does not answer: is it a Go2 EDU?"
SEVERAL = "{} robots answer on this network: leave only the one that is to be driven"


class Go2Link(Link):
    """The exchange with a Go2.

    It commands only once one robot alone has answered, its own controllers have ended, and nobody
    else commands the motors. From the release of its controllers on it is held as it lies, since
    its motors are limp without commands. Should one of the robot's modes come back, it falls
    silent, for two programs that write the same motors are worse than one; another robot's answer,
    a restart, anybody else's command, or a button of the robot's remote brakes for good.
    """

    def __init__(self, interface: str, domain: int, watch: bool) -> None:
        """Join a DDS domain on a network card; motors are sent nothing before the release.

        `watch` means only to look: to end no mode, and never to command.
        """
        super().__init__(GO2)
        network = Network(interface, domain)
        self._commands = network.writer(COMMANDS, LowCmd)
        self._others = network.reader(COMMANDS, LowCmd)
        self._states = network.reader(STATES, LowState, depth=8)
        self._switch = MotionSwitcher(network)
        self._speakers = Speakers()
        self._integrity = Integrity()
        self._trouble = MotorTrouble()
        self._watch = watch
        self._known = self._free = False
        self._began = self._heard = self._released = math.nan
        self._angles = self._load = np.zeros(ACTION_SIZE)
        """Where the joints are, rad, and the torque with which the robot's own controllers held
        them there, N m."""
        self._pressed = 0
        self._out = LowCmd()
        command = self._out.values
        command["head"], command["level_flag"] = (0xFE, 0xEF), 0xFF
        command["motor_cmd"]["mode"] = SERVO
        command["motor_cmd"]["q"], command["motor_cmd"]["dq"] = NO_POSITION, NO_SPEED

    def _receive(self, now: float) -> None:
        newest = self._newest()
        if newest is not None:
            motors = newest["motor_state"][MOTORS]
            self._angles = motors["q"].astype(float)
            if not self._switch.releasing:
                self._load = motors["tau_est"].astype(float)
        heard = any(getattr(s, "values", None) is not None for s in self._others.take(1))
        if newest is not None and math.isnan(self._began):
            self._began = self._heard = now
        if not self._watch:
            self._switch.step(now, self._known and not (self._free or self.problem))
        self._identify(now)
        if self._known and not self._watch:
            self._claim(heard, now)
        if newest is None:
            return
        pressed = newest["wireless_remote"][BUTTONS].any() and self._command is not None
        self._pressed = self._pressed + 1 if pressed else 0
        if self._pressed >= IN_A_ROW:
            self.problem = self.problem or "a button of the robot's remote was pressed"
        if self._free:
            motors = newest["motor_state"][MOTORS]
            fault = self._trouble.look(motors["mode"], motors["lost"], self.commanded, now)
            self.state = replace(reading(newest, now), fault=fault)

    def _newest(self) -> Any:
        """The newest message of this robot that arrived undamaged; None if none did."""
        newest = None
        for sample in self._states.take(8):
            values = getattr(sample, "values", None)  # Absent where a writer has left.
            if values is None or not self._speakers.hear(sample.sample_info.publication_handle):
                continue
            if self._integrity.intact(sample) and self._news(int(values["tick"])):
                newest = values
        self.problem = self.problem or self._integrity.problem
        return newest

    def _identify(self, now: float) -> None:
        """Pin who answers once it was listened for long enough, if that is one robot alone."""
        voices = self._speakers, self._switch.speakers
        if self._known:
            if any(speakers.intruded for speakers in voices):
                self.problem = self.problem or RESTARTED
            return
        count = max(map(len, voices))
        if count > 1:
            self.problem = self.problem or SEVERAL.format(count)
        if self.problem or not now - self._began > LISTEN:
            return
        if self._watch or len(self._switch.speakers):
            self._speakers.pin()
            if not self._watch:
                self._switch.speakers.pin()
            self._known = True
            self._free = self._watch
            self._integrity.settle()
        elif now - self._began > RELEASE:
            self.problem = NO_SWITCH

    def _claim(self, heard: bool, now: float) -> None:
        """Set `_free` once the motors are; afterwards a problem if they are somebody else's again.

        `heard`: somebody else commanded them; `now`: seconds.
        """
        mode = self._switch.mode
        if self._free:
            if mode:
                self.problem = self.problem or f"the robot's mode {mode!r} was started again"
            elif heard:
                self.problem = self.problem or "another program commands the robot's motors"
            return
        if self._switch.released:
            self._released = now
        if heard or mode != "":
            self._heard = now
        self._hold(heard, now)
        self._free = now - self._heard > QUIET
        if not self._free and now - self._began > RELEASE:
            self.problem = self.problem or {
                None: NO_SWITCH,
                "": "another program commands the robot's motors: end it first",
            }.get(mode, f"the robot's mode {mode!r} does not end: end it with the remote or app")

    def _hold(self, heard: bool, now: float) -> None:
        """Hold the legs where they are from the release on, unless somebody else moves them."""
        if heard and now - self._released > SETTLES:
            self.holding = None
        if now == self._released:
            # A servo gives no torque where it should be: it must aim beyond that.
            aim = self._angles + np.clip(self._load / HOLD, -MOST_BEYOND, MOST_BEYOND)
            gains = np.full(ACTION_SIZE, HOLD), np.full(ACTION_SIZE, BRAKE)
            self.holding = clamp(self._robot, JointCommand(aim, *gains))

    def _send(self, command: JointCommand | None) -> None:
        early = self._command is not None and not self._free
        if command is None or early or self._watch or self._switch.mode:
            return
        motors = self._out.values["motor_cmd"][MOTORS]
        motors["q"], motors["dq"], motors["tau"] = command.position, 0.0, 0.0
        motors["kp"], motors["kd"] = command.stiffness, command.damping
        self._out.values["crc"] = crc(self._out.raw)
        with suppress(DDSException):  # A reader that does not acknowledge: the next is newer.
            self._commands.write(self._out)


def reading(values: Any, now: float) -> RobotState:
    """State in a LowState that came at `now`, s."""
    motors, imu = values["motor_state"][MOTORS], values["imu_state"]
    charge = float(values["bms_state"]["soc"]) / 100.0
    return RobotState(
        time=now,
        joint_position=motors["q"].astype(float),
        joint_velocity=motors["dq"].astype(float),
        joint_torque=motors["tau_est"].astype(float),
        quaternion=imu["quaternion"].astype(float),
        angular_velocity=imu["gyroscope"].astype(float),
        temperature=motors["temperature"].astype(float),
        battery=charge if charge > 0.0 else math.nan,
        voltage=float(values["power_v"]) or math.nan,
    )
