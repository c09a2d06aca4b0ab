"""A Go1 made of MuJoCo behind a real socket: decodes the vendor's datagrams, steps, answers.

The layouts were found by sending one value at a time through the vendor's library.
"""

import socket
import struct
import zlib
from contextlib import suppress

import mujoco
import numpy as np

from renet.deploy.robots.base import JointCommand
from renet.deploy.robots.go1.driver import POWER_LEVEL
from renet.deploy.robots.go1.link import Go1Link
from renet.deploy.robots.real.braking import PERIOD
from renet.interface import JOINTS

from ..fakes import robot_on
from . import peer
from .peer import VENDOR

LOCAL, COMMAND_BYTES, STATE_BYTES = "127.0.0.1", 614, 792
TIMESTAMPS = 35
"""SO_TIMESTAMPNS of Linux."""
HEAD = b"\xfe\xef\xff"
MOTOR_COMMAND = struct.Struct("<Bffhhh12x")
"""mode, q, dq, tau * 256, Kp * 32, Kd * 16"""
MOTOR_STATE = struct.Struct("<Bffhhffhb")
"""mode, q, dq, ddq, tau * 256, raw q, raw dq, raw ddq, temperature"""
SERIAL_AT, MOTORS_AT, COMMAND_MOTORS_AT, STATE_STRIDE, TICK_AT = 4, 75, 22, 32, 755
JOINT_OF = np.array([JOINTS.index(name) for name in VENDOR])

MIRRORED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def checksum(data: bytes) -> bytes:
    """CRC-32 of whole little-endian words, most significant bit first, not inverted at the end.

    That is zlib's CRC-32 with the bits of every byte, and of the result, in the other order.
    """
    words = np.frombuffer(data[: len(data) // 4 * 4], "<u4").astype(">u4").tobytes()
    crc = zlib.crc32(words.translate(MIRRORED)) ^ 0xFFFFFFFF
    return struct.pack("<I", int(f"{crc:032b}"[::-1], 2))


def decode_command(datagram: bytes) -> np.ndarray:
    """[12, 6]: mode, q, dq, tau, Kp, Kd by joint; checks what a robot does."""
    assert len(datagram) == COMMAND_BYTES
    assert datagram[:3] == HEAD
    assert datagram[-4:] == checksum(datagram[:-4])
    motors = MOTOR_COMMAND.size * np.arange(12) + COMMAND_MOTORS_AT
    joints = np.empty((12, 6))
    joints[JOINT_OF] = [MOTOR_COMMAND.unpack_from(datagram, motor) for motor in motors]
    return joints / (1, 1, 1, 256, 32, 16)


class Peer(peer.Peer):
    """Serves one control computer, one datagram at a time; motors are numbered FR, FL, RR, RL."""

    SERVO = 10

    def __init__(self) -> None:
        super().__init__()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((LOCAL, 0))
        self._socket.settimeout(0.2)
        self._socket.setsockopt(socket.SOL_SOCKET, TIMESTAMPS, 1)
        self.port = self._socket.getsockname()[1]
        self.driver = "renet.deploy.robots.go1.driver:go1_robot", (LOCAL, self.port, free_port())
        self.robot = robot_on()
        self.robot.model.opt.timestep = PERIOD
        self.data = self.robot.data
        self.silent = self.overloaded = self.garbled = self.still = False
        self.ticks = 0
        self.serial, self.mode = (0, 0), 10
        """Its number, and the mode that its motors say they are in."""

    def make_link(self, power_level: int = POWER_LEVEL) -> Go1Link:
        return Go1Link(LOCAL, self.port, free_port(), power_level)

    def step(self) -> None:
        """Take one command, live for 2 ms, answer."""
        with suppress(TimeoutError):
            datagram, ancillary, _, sender = self._socket.recvmsg(4096, 64)
            seconds, nanoseconds = struct.unpack("qq", ancillary[0][2])
            self.arrivals.append(10**9 * seconds + nanoseconds)
            self.commands.append(decode_command(datagram))
            self.obey(self.commands[-1])
            self.ticks += 1
            if not self.silent:
                self._socket.sendto(self._state(), sender)

    def obey(self, joints: np.ndarray) -> None:
        _, position, speed, torque, stiffness, damping = joints.T
        assert (torque == 0).all()
        limp = np.abs(position) > 1e9
        assert (speed[~limp] == 0).all()
        hold = np.where(limp, 0.0, position)
        self.robot.write(JointCommand(hold, np.where(limp, 0.0, stiffness), damping))
        if not self.still:
            mujoco.mj_step(self.robot.model, self.data)
            mujoco.mj_forward(self.robot.model, self.data)

    def close(self) -> None:
        self._socket.close()

    def _state(self) -> bytes:
        state, packet = self.robot.read(), bytearray(STATE_BYTES)
        packet[:3] = HEAD
        struct.pack_into("<4f3f", packet, 22, *state.quaternion, *state.angular_velocity)
        for motor, joint in enumerate(JOINT_OF):
            q, dq = state.joint_position[joint], state.joint_velocity[joint]
            tau = round(256 * float(np.clip(state.joint_torque[joint], -127, 127)))
            if self.overloaded:
                dq, tau = 20.0, 256 * 30
            values = (self.mode, q, dq, 0, tau, q, dq, 0, 30)
            MOTOR_STATE.pack_into(packet, MOTORS_AT + STATE_STRIDE * motor, *values)
        struct.pack_into("<II", packet, SERIAL_AT, *self.serial)
        struct.pack_into("<I", packet, TICK_AT, self.ticks % 2**32)
        packet[-4:] = checksum(bytes(packet[:-4]))
        if self.garbled:
            packet[MOTORS_AT + 1] ^= 0x10
        return bytes(packet)


def free_port() -> int:
    """A UDP port nobody uses."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((LOCAL, 0))
        return probe.getsockname()[1]
