"""Messages of the Go2: their fields, their checksum, and whether it can be believed.

Fields, their order and the CRC are those of unitree_sdk2 (BSD-3).
"""

import zlib
from typing import Any

import numpy as np

from renet.deploy.dds.messages import message_type, parse_fields

MODULE = "unitree_go.msg.dds_"
HEAD = "u1 head[2], u1 level_flag, u1 frame_reserve, u4 sn[2], u4 version[2], u2 bandwidth, "
LOW_CMD = parse_fields(
    HEAD + "MotorCmd_ motor_cmd[20], BmsCmd_ bms_cmd, u1 wireless_remote[40], u1 led[12],"
    "u1 fan[2], u1 gpio, u4 reserve, u4 crc",
    MotorCmd_=parse_fields("u1 mode, f4 q, f4 dq, f4 tau, f4 kp, f4 kd, u4 reserve[3]"),
    BmsCmd_=parse_fields("u1 off, u1 reserve[3]"),
)
LOW_STATE = parse_fields(
    HEAD + "IMUState_ imu_state, MotorState_ motor_state[20], BmsState_ bms_state,"
    "i2 foot_force[4], i2 foot_force_est[4], u4 tick, u1 wireless_remote[40], u1 bit_flag,"
    "f4 adc_reel, u1 temperature_ntc1, u1 temperature_ntc2, f4 power_v, f4 power_a,"
    "u2 fan_frequency[4], u4 reserve, u4 crc",
    IMUState_=parse_fields(
        "f4 quaternion[4], f4 gyroscope[3], f4 accelerometer[3], f4 rpy[3], u1 temperature"
    ),
    MotorState_=parse_fields(
        "u1 mode, f4 q, f4 dq, f4 ddq, f4 tau_est, f4 q_raw, f4 dq_raw, f4 ddq_raw,"
        "u1 temperature, u4 lost, u4 reserve[2]"
    ),
    BmsState_=parse_fields(
        "u1 version_high, u1 version_low, u1 status, u1 soc, i4 current, u2 cycle, u1 bq_ntc[2],"
        "u1 mcu_ntc[2], u2 cell_vol[15]"
    ),
)
MIRRORED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
_ENOUGH = 10
"""Number of messages that decide if a robot's checksums are right at all."""
MOST_DAMAGED = 50
"""Number of damaged messages in a row, 0.1 s, after which a robot is given up."""


def crc(raw: np.ndarray) -> int:
    """Return the vendor's checksum of a C struct, which goes into its last four bytes.

    CRC-32 of the little-endian words before them, most significant bit first, not inverted at the
    end: zlib's with the bits of every byte, and of the result, in the other order.
    """
    words = raw.view("<u4")[:-1].astype(">u4").tobytes()
    value = zlib.crc32(words.translate(MIRRORED)) ^ 0xFFFFFFFF
    return int(f"{value:032b}"[::-1], 2)


LowCmd = message_type("LowCmd_", LOW_CMD, MODULE)
"""Message to the robot: a target for each of 20 motors, of which 0 to 11 are the legs'."""
LowState = message_type("LowState_", LOW_STATE, MODULE)
"""Message from the robot, at 500 Hz."""


class Integrity:
    """Checks the CRC of messages, if the robot's are right at all.

    The vendor's own programs do not look at it, and it is not known if every firmware writes it
    right. So the first messages, which move no motor, decide.
    """

    def __init__(self) -> None:
        self._right = self._seen = self._damaged = 0
        self._checks: bool | None = None
        self.problem = ""
        """Reason for which the robot cannot be understood; empty while it can."""

    def intact(self, sample: Any) -> bool:
        """Return True if a message may be believed."""
        if self._checks is False:
            return True
        right = int(sample.values["crc"]) == crc(sample.raw)
        if self._checks is None:
            self._seen += 1
            self._right += right
            return True
        self._damaged = 0 if right else self._damaged + 1
        if self._damaged > MOST_DAMAGED:
            self.problem = "the robot's messages arrive damaged: check cable and network card"
        return right

    def settle(self) -> None:
        """Decide by the messages so far if the next ones are checked."""
        self._checks = self._seen >= _ENOUGH and self._right >= 0.9 * self._seen
