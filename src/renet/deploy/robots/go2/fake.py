"""Simulated Go2 behind the vendor's DDS topics, on this computer alone.

A driver takes it for a robot: it publishes its state at 500 Hz, its own controller holds the motors
until MotionSwitcher releases them, and it obeys commands whose CRC is right, within its motors'
torque. It knows no foot forces. Its motors are limp from a release until the first command, and
again where none comes for its `patience`; how long a real robot's motors wait is not known.
"""

import json
import math
from contextlib import suppress
from typing import Any

import mujoco
import numpy as np
from cyclonedds.core import DDSException

from renet.deploy.dds.network import Network
from renet.deploy.robots.base import heading, projected_gravity
from renet.deploy.robots.go2.link import (
    COMMAND_TOPIC,
    LEG_MOTORS,
    NO_POSITION,
    NO_SPEED,
    REMOTE_BUTTONS,
    STATE_TOPIC,
)
from renet.deploy.robots.go2.messages import LowCmd, LowState, crc
from renet.deploy.robots.go2.switch import (
    CHECK_MODE,
    RELEASE_MODE,
    REQUESTS,
    RESPONSES,
    SELECT_MODE,
    Request,
    Response,
    ResponseHeader,
    Status,
)
from renet.deploy.robots.real.braking import PERIOD
from renet.deploy.robots.sim.mujoco import place
from renet.deploy.robots.sim.scene import build_scene
from renet.interface import JOINTS, TRUNK
from renet.robots import GO2
from renet.robots.model import joint_addresses, servo_ids, trunk_addresses

LOOPBACK_CARD = "lo"
"""Network interface of this computer alone."""
SPORT = "normal"
"""Name of the mode in which a Go2 starts."""
_LYING = np.tile((0.0, 1.36, -2.65), 4)
"""[12] joint positions from which the vendor's example of standing up begins, rad."""
_LYING_HEIGHT = 0.12
"""Height of the trunk above the ground at the start, m."""
_HOLD = (60.0, 5.0)
"""Kp and Kd of the robot's own controller, as in the vendor's example."""
_UNKNOWN_API = 3203
_GRAVITY = np.array((0.0, 0.0, 9.81))


class FakeGo2:
    """Robot that lies on the ground; its time passes only when `step` is called."""

    def __init__(self, domain: int = 0, terrain: str = "flat", level: int = 1) -> None:
        """Lay the robot on a terrain of a level, 1 to 10, and join a DDS domain.

        Raises:
            RenetError: The terrain is unknown, or DDS fails.
        """
        model, ground = build_scene(terrain, level, robot=GO2)
        model.opt.timestep = PERIOD
        self.model = model
        self.data = place(model, ground + _LYING_HEIGHT)
        self._servos = servo_ids(model)
        self._angles, self._speeds = joint_addresses(model)
        self._base, self._motion = trunk_addresses(model)
        self.data.qpos[self._angles] = _LYING
        # Actuators take torques; `_drive` adds the gains of a command.
        model.actuator_gainprm[self._servos, 0] = 1.0
        self.network = Network(LOOPBACK_CARD, domain)
        self._commands = self.network.reader(COMMAND_TOPIC, LowCmd, depth=8)
        self._states = self.network.writer(STATE_TOPIC, LowState)
        self._requests = self.network.reader(REQUESTS, Request, depth=8)
        self._responses = self.network.writer(RESPONSES, Response, depth=8)
        self._out = LowState()
        self._out.values["head"] = (0xFE, 0xEF)
        self._out.values["level_flag"] = 0xFF
        self.mode = SPORT
        """Name of its own controller that holds the motors; empty after a release."""
        self.buttons = 0
        """Bits of the remote's pressed buttons: A is 256, START is 4."""
        self.pose = _LYING
        """[12] joint positions that its own controller holds, rad."""
        self.patience = math.inf
        """Seconds without a command after which its motors are limp."""
        self.order = np.arange(len(JOINTS))
        """Joint of each of the vendor's motors; legs that are wired wrongly have others."""
        self.battery = 81
        """Charge in per cent."""
        self.accepted = 0
        """Number of commands that it obeyed."""
        self.wrong = 0
        """Number of commands with a wrong CRC or head."""
        self.refused = 0
        """Number of commands that came while one of its own modes was active."""
        self._obeyed = 0
        self.steps = 0
        """Number of steps, 2 ms each: its clock."""
        self._limp()

    def step(self) -> None:
        """Let 2 ms pass: answer, obey, move, and publish the state."""
        self.answer()
        for sample in self._commands.take(8):
            if getattr(sample, "values", None) is not None:
                self.receive(sample)
                self._obeyed = self.steps
        if self.mode:
            self._drive(1, self.pose, 0.0, 0.0, *_HOLD)
        elif PERIOD * (self.steps - self._obeyed) > self.patience:
            self._limp()
        mujoco.mj_step(self.model, self.data)
        self.steps += 1
        self.publish()

    def answer(self) -> None:
        """Answer the requests to MotionSwitcher."""
        for request in self._requests.take(8):
            # Absent when a writer has left.
            header = getattr(request, "header", None)
            if header is None:
                continue
            api = header.identity.api_id
            code = 0
            data = ""
            if api == CHECK_MODE:
                data = json.dumps({"form": "0", "name": self.mode})
            elif api == SELECT_MODE:
                self.mode = str(json.loads(request.parameter).get("name", SPORT))
            elif api == RELEASE_MODE:
                code = self.release()
            else:
                code = _UNKNOWN_API
            self._responses.write(Response(ResponseHeader(header.identity, Status(code)), data, []))

    def release(self) -> int:
        """End its mode, which leaves the motors limp; returns MotionSwitcher's code, 0: done."""
        if self.mode:
            self._limp()
        self.mode = ""
        return 0

    def receive(self, sample: Any) -> None:
        """Obey a command for the motors, unless it is wrong or one of its modes is active."""
        command = sample.values
        if int(command["crc"]) != crc(sample.raw) or tuple(command["head"]) != (0xFE, 0xEF):
            self.wrong += 1
        elif self.mode:
            self.refused += 1
        else:
            self.accepted += 1
            motors = command["motor_cmd"][LEG_MOTORS][np.argsort(self.order)]
            parts = ("mode", "q", "dq", "tau", "kp", "kd")
            self._drive(*(motors[part].astype(float) for part in parts))

    def publish(self) -> None:
        """Send the state of now."""
        data = self.data
        state = self._out.values
        motors = state["motor_state"][LEG_MOTORS]
        order = self.order
        motors["mode"] = 1
        motors["temperature"] = 30
        motors["q"] = data.qpos[self._angles[order]]
        motors["dq"] = data.qvel[self._speeds[order]]
        motors["tau_est"] = data.actuator_force[self._servos[order]]
        quaternion = data.qpos[self._base][3:]
        imu = state["imu_state"]
        imu["quaternion"] = quaternion
        imu["gyroscope"] = data.qvel[self._motion][3:]
        # An accelerometer at rest measures gravity upwards.
        acceleration = data.qacc[self._motion][:3] + _GRAVITY
        imu["accelerometer"] = data.body(TRUNK).xmat.reshape(3, 3).T @ acceleration
        down = projected_gravity(quaternion)
        roll = np.arctan2(-down[1], -down[2])
        pitch = np.arcsin(np.clip(down[0], -1, 1))
        imu["rpy"] = (roll, pitch, heading(quaternion))
        state["bms_state"]["soc"] = self.battery
        state["power_v"] = 28.8
        state["wireless_remote"][REMOTE_BUTTONS] = (self.buttons % 256, self.buttons // 256)
        state["tick"] = round(1000 * PERIOD) * self.steps
        state["crc"] = crc(self._out.raw)
        # A reader that does not acknowledge costs this message.
        with suppress(DDSException):
            self._states.write(self._out)

    def _drive(self, mode: Any, q: Any, dq: Any, tau: Any, kp: Any, kd: Any) -> None:
        """Let the motors follow targets, as the vendor's do; NO_POSITION and NO_SPEED are none."""
        servos = self._servos
        on = np.equal(mode, 1)
        kp = np.where(on & (np.abs(q) < NO_POSITION), kp, 0.0)
        kd = np.where(on & (np.abs(dq) < NO_SPEED), kd, 0.0)
        position = np.where(kp > 0, q, 0.0)
        velocity = np.where(kd > 0, dq, 0.0)
        self.data.ctrl[servos] = kp * position + kd * velocity + np.where(on, tau, 0.0)
        self.model.actuator_biasprm[servos, 1] = -kp
        self.model.actuator_biasprm[servos, 2] = -kd

    def _limp(self) -> None:
        self._drive(0, _LYING, 0.0, 0.0, 0.0, 0.0)
