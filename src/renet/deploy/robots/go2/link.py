"""The Go2's low-level DDS interface (unitree_sdk2, BSD-3)."""

import math
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from cyclonedds.core import DDSException

from renet.deploy.dds.network import Network
from renet.deploy.robots.base import JointCommand, RobotState
from renet.deploy.robots.envelope import clamp
from renet.deploy.robots.go2.messages import Integrity, LowCmd, LowState, crc
from renet.deploy.robots.go2.switch import MotionSwitcher
from renet.deploy.robots.real.braking import BRAKE, Link
from renet.deploy.robots.real.identity import IN_A_ROW, RESTARTED, Speakers
from renet.deploy.robots.real.trouble import MotorTrouble
from renet.interface import ACTION_SIZE
from renet.robots import GO2

COMMAND_TOPIC = "rt/lowcmd"
"""Topic of commands."""
STATE_TOPIC = "rt/lowstate"
"""Topic of readings."""
LEG_MOTORS = slice(0, ACTION_SIZE)
"""The vendor numbers the legs' motors as `interface.JOINTS`; zeros and signs are its model's."""
_SERVO = 1
"""Motor mode that obeys position, velocity, gains and torque."""
NO_POSITION = 2.146e9
"""Target that means none; with zero gains a motor is limp."""
NO_SPEED = 16000.0
"""Likewise for the speed."""
REMOTE_BUTTONS = slice(2, 4)
"""Bytes of the remote's message with one bit for each button."""
QUIET_TIME = 0.2
"""Time without anybody else's command after which the motors are free, s."""
RELEASE = 10.0
"""Time within which the robot's own controllers must have ended, s."""
LISTEN = 1.0
"""Time of listening to who answers, before anything is asked to change, s."""
HOLD_STIFFNESS = 40.0
"""Kp of the hold in which the robot lies from the release to the controller's first command."""
MOST_BEYOND = 0.4
"""Largest distance of the hold's targets from the joints, rad, with which they bear their load."""
SETTLES = 0.05
"""Time after a release in which commands of the robot's own controllers may still arrive, s."""
NO_SWITCH = "the robot's motion switcher does not answer: is it a Go2 EDU?"
SEVERAL = "{} robots answer on this network: leave only the one that is to be driven"


class Go2Link(Link):
    """Exchange of commands and readings with a Go2.

    It commands only after one robot alone has answered, the robot's own controllers have ended, and
    nobody else commands the motors. From the release on, the robot is held as it lies, because its
    motors are limp without commands. If one of the robot's modes comes back, the link falls silent:
    two programs that write the same motors are worse than one. Another robot's answer, a restart,
    anybody else's command, or a button of the robot's remote brakes for good.
    """

    def __init__(self, interface: str, domain: int, watch: bool) -> None:
        """Join a DDS domain on a network card; motors are sent nothing before the release.

        With `watch` it only reads: it ends no mode, and never commands.
        """
        super().__init__(GO2)
        network = Network(interface, domain)
        self._commands = network.writer(COMMAND_TOPIC, LowCmd)
        self._others = network.reader(COMMAND_TOPIC, LowCmd)
        self._states = network.reader(STATE_TOPIC, LowState, depth=8)
        self._switch = MotionSwitcher(network)
        self._speakers = Speakers()
        self._integrity = Integrity()
        self._trouble = MotorTrouble()
        self._watch = watch
        self._known = self._free = False
        self._began = self._heard = self._released = math.nan
        self._angles = self._load = np.zeros(ACTION_SIZE)
        """Positions of the joints, rad, and torques, N m, with which the robot's own controllers
        held them there."""
        self._pressed = 0
        self._out = LowCmd()
        command = self._out.values
        command["head"] = (0xFE, 0xEF)
        command["level_flag"] = 0xFF
        command["motor_cmd"]["mode"] = _SERVO
        command["motor_cmd"]["q"] = NO_POSITION
        command["motor_cmd"]["dq"] = NO_SPEED

    def _receive(self, now: float) -> None:
        """Take over what arrived, find out who answers, and claim the motors."""
        newest = self._newest()
        if newest is not None:
            motors = newest["motor_state"][LEG_MOTORS]
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
        pressed = newest["wireless_remote"][REMOTE_BUTTONS].any() and self._command is not None
        self._pressed = self._pressed + 1 if pressed else 0
        if self._pressed >= IN_A_ROW:
            self.problem = self.problem or "a button of the robot's remote was pressed"
        if self._free:
            motors = newest["motor_state"][LEG_MOTORS]
            fault = self._trouble.look(motors["mode"], motors["lost"], self.commanded, now)
            self.state = replace(reading(newest, now), fault=fault)

    def _newest(self) -> Any:
        """Return this robot's newest message that arrived undamaged; None if none did."""
        newest = None
        for sample in self._states.take(8):
            # Absent when a writer has left.
            values = getattr(sample, "values", None)
            if values is None or not self._speakers.hear(sample.sample_info.publication_handle):
                continue
            if self._integrity.intact(sample) and self._news(int(values["tick"])):
                newest = values
        self.problem = self.problem or self._integrity.problem
        return newest

    def _identify(self, now: float) -> None:
        """After a time of listening, believe only the one robot that answered."""
        voices = (self._speakers, self._switch.speakers)
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
        """Set `_free` once nobody else moves the motors; a problem if somebody does again.

        Args:
            heard: Somebody else commanded the motors since the last exchange.
            now: Time, s.
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
        self._free = now - self._heard > QUIET_TIME
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
            aim = self._angles + np.clip(self._load / HOLD_STIFFNESS, -MOST_BEYOND, MOST_BEYOND)
            stiffness = np.full(ACTION_SIZE, HOLD_STIFFNESS)
            damping = np.full(ACTION_SIZE, BRAKE)
            self.holding = clamp(self._robot, JointCommand(aim, stiffness, damping))

    def _send(self, command: JointCommand | None) -> None:
        early = self._command is not None and not self._free
        if command is None or early or self._watch or self._switch.mode:
            return
        motors = self._out.values["motor_cmd"][LEG_MOTORS]
        motors["q"] = command.position
        motors["dq"] = 0.0
        motors["tau"] = 0.0
        motors["kp"] = command.stiffness
        motors["kd"] = command.damping
        self._out.values["crc"] = crc(self._out.raw)
        # A reader that does not acknowledge gets the next command, which is newer.
        with suppress(DDSException):
            self._commands.write(self._out)


def reading(values: Any, now: float) -> RobotState:
    """Return the reading in a LowState that came at `now`, s."""
    motors = values["motor_state"][LEG_MOTORS]
    imu = values["imu_state"]
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
