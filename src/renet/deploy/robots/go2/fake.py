"""A Go2 of MuJoCo behind the vendor's DDS topics, on this computer alone.

To a driver it is a robot: it publishes its state at 500 Hz, its own controller holds the motors
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

from renet.deploy.robots.base import projected_gravity
from renet.deploy.robots.go2.link import BUTTONS, COMMANDS, MOTORS, NO_POSITION, NO_SPEED, STATES
from renet.deploy.robots.go2.messages import LowCmd, LowState, crc
from renet.deploy.robots.go2.network import Network
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
from renet.deploy.robots.sim.scene import build_scene
from renet.interface import JOINTS, TRUNK
from renet.robots import GO2

LOOPBACK = "lo"
SPORT = "normal"
"""Name of the mode in which a Go2 starts."""
LYING = np.tile((0.0, 1.36, -2.65), 4)
"""rad; where the vendor's example of standing up begins."""
LYING_HEIGHT = 0.12
"""Height of the trunk above the ground at the start, m."""
HOLD = (60.0, 5.0)
"""Kp and Kd of the robot's own controller, as in the vendor's example."""
UNKNOWN_API = 3203
GRAVITY = np.array((0.0, 0.0, 9.81))


class FakeGo2:
    """A robot that lies on the ground; it lives only while `step` is called."""

    def __init__(self, domain: int = 0, terrain: str = "flat", level: int = 1) -> None:
        """Lay the robot on a terrain of a level, 1 to 10, and join a DDS domain.

        Raises:
            RenetError: an unknown terrain, or DDS that fails.
        """
        model, ground = build_scene(terrain, level, robot=GO2)
        model.opt.timestep = PERIOD
        self.model, self.data = model, mujoco.MjData(model)
        joints = [model.joint(name) for name in JOINTS]
        self._servos = np.array([model.actuator(name).id for name in JOINTS])
        self._angles = np.array([joint.qposadr[0] for joint in joints])
        self._speeds = np.array([joint.dofadr[0] for joint in joints])
        model.actuator_gainprm[self._servos, 0] = 1.0
        base = model.jnt_qposadr[model.body(TRUNK).jntadr[0]]
        self.data.qpos[base : base + 7] = (0.0, 0.0, ground + LYING_HEIGHT, 1.0, 0.0, 0.0, 0.0)
        self.data.qpos[self._angles] = LYING
        self._base = slice(base, base + 7)
        spin = model.jnt_dofadr[model.body(TRUNK).jntadr[0]]
        self._motion = slice(spin, spin + 6)
        self.network = Network(LOOPBACK, domain)
        self._commands = self.network.reader(COMMANDS, LowCmd, depth=8)
        self._states = self.network.writer(STATES, LowState)
        self._requests = self.network.reader(REQUESTS, Request, depth=8)
        self._responses = self.network.writer(RESPONSES, Response, depth=8)
        self._out = LowState()
        self._out.values["head"], self._out.values["level_flag"] = (0xFE, 0xEF), 0xFF
        self.mode = SPORT
        """Name of its own controller that holds the motors; empty after a release."""
        self.buttons = 0
        """Bits of the remote's pressed buttons: A is 256, START is 4."""
        self.pose = LYING
        """Where its own controller holds the joints, [12] rad."""
        self.patience = math.inf
        """Seconds without a command after which its motors are limp."""
        self.order = np.arange(len(JOINTS))
        """Joint of each of the vendor's motors; legs that are wired wrongly have others."""
        self.battery = 81
        """Charge in per cent."""
        self.accepted = self.wrong = self.refused = 0
        """Commands that it obeyed; that had a wrong CRC or head; that came in one of its modes."""
        self._obeyed = 0
        self.steps = 0
        """How often it has stepped: its clock, 2 ms each."""
        self._limp()

    def step(self) -> None:
        """Live for 2 ms: answer, obey, move, and publish the state."""
        self.answer()
        for sample in self._commands.take(8):
            if getattr(sample, "values", None) is not None:
                self.receive(sample)
                self._obeyed = self.steps
        if self.mode:
            self._drive(1, self.pose, 0.0, 0.0, *HOLD)
        elif PERIOD * (self.steps - self._obeyed) > self.patience:
            self._limp()
        mujoco.mj_step(self.model, self.data)
        self.steps += 1
        self.publish()

    def answer(self) -> None:
        """Answer what MotionSwitcher was asked."""
        for request in self._requests.take(8):
            header = getattr(request, "header", None)  # Absent where a writer has left.
            if header is None:
                continue
            api, code, data = header.identity.api_id, 0, ""
            if api == CHECK_MODE:
                data = json.dumps({"form": "0", "name": self.mode})
            elif api == SELECT_MODE:
                self.mode = str(json.loads(request.parameter).get("name", SPORT))
            elif api == RELEASE_MODE:
                code = self.release()
            else:
                code = UNKNOWN_API
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
            motors = command["motor_cmd"][MOTORS][np.argsort(self.order)]
            parts = ("mode", "q", "dq", "tau", "kp", "kd")
            self._drive(*(motors[part].astype(float) for part in parts))

    def publish(self) -> None:
        """Send the state of now."""
        state, motors = self._out.values, self._out.values["motor_state"][MOTORS]
        data, (w, x, y, z) = self.data, self.data.qpos[self._base][3:]
        motors["mode"], motors["temperature"] = 1, 30
        order = self.order
        motors["q"] = data.qpos[self._angles[order]]
        motors["dq"] = data.qvel[self._speeds[order]]
        motors["tau_est"] = data.actuator_force[self._servos[order]]
        imu, motion = state["imu_state"], data.qacc[self._motion][:3] + GRAVITY
        imu["quaternion"] = (w, x, y, z)
        imu["gyroscope"] = data.qvel[self._motion][3:]
        imu["accelerometer"] = data.body(TRUNK).xmat.reshape(3, 3).T @ motion
        down = projected_gravity(data.qpos[self._base][3:])
        yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        imu["rpy"] = np.arctan2(-down[1], -down[2]), np.arcsin(np.clip(down[0], -1, 1)), yaw
        state["bms_state"]["soc"], state["power_v"] = self.battery, 28.8
        state["wireless_remote"][BUTTONS] = self.buttons % 256, self.buttons // 256
        state["tick"] = round(1000 * PERIOD) * self.steps
        state["crc"] = crc(self._out.raw)
        with suppress(DDSException):  # A reader that does not acknowledge.
            self._states.write(self._out)

    def _drive(self, mode: Any, q: Any, dq: Any, tau: Any, kp: Any, kd: Any) -> None:
        """Let the motors follow targets, as the vendor's do; with NO_POSITION or NO_SPEED none."""
        model, servos, on = self.model, self._servos, np.equal(mode, 1)
        kp = np.where(on & (np.abs(q) < NO_POSITION), kp, 0.0)
        kd = np.where(on & (np.abs(dq) < NO_SPEED), kd, 0.0)
        targets = np.where(kp > 0, q, 0.0), np.where(kd > 0, dq, 0.0)
        self.data.ctrl[servos] = kp * targets[0] + kd * targets[1] + np.where(on, tau, 0.0)
        model.actuator_biasprm[servos, 1], model.actuator_biasprm[servos, 2] = -kp, -kd

    def _limp(self) -> None:
        self._drive(0, LYING, 0.0, 0.0, 0.0, 0.0)
