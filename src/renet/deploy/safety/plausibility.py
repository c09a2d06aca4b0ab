"""Consistency of a robot's readings: each is compared with the one before.

The checks find a joint whose angle does not follow its speed, and a gyroscope that contradicts the
attitude. They do not find an error that both share, or one that grows slowly.
"""

import math

import numpy as np

from renet.deploy.robots.base import RobotState
from renet.interface import CONTROL_DT, JOINTS

MAX_JUMP = 0.4
"""Largest turn of a joint in a control step beyond the one that its speeds before and after allow,
rad: at most 0.17 in 560 s of walks with pushes, and half of that in a test with falls."""
MAX_TWIST = 0.25
"""Largest disagreement of gyroscope and attitude over a control step, rad: 0.04 in those walks."""
MAX_DRIFT = 0.12
"""Largest disagreement of both over the last second, rad: 0.06 in those walks."""
MAX_SKIP = 0.5
"""Largest disagreement of a joint's angle and mean speed over a control step, rad: 0.17."""
MAX_SLIP = 0.6
"""Largest disagreement of both over the last second, rad: 0.27 in such walks and falls."""
_DECAY = 0.98
"""Share of a disagreement that still counts a control step later."""
MAX_INTERVAL = 0.05
"""Longest time between two readings that are compared, s."""


class Readings:
    """Adds up the disagreements of readings in a row."""

    def __init__(self) -> None:
        self._drift = [0.0, 0.0, 0.0]
        """Disagreement [3] rad of gyroscope and attitude, which decays."""
        self._slip = np.zeros(len(JOINTS))
        """Disagreement [12] rad of angles and speeds, which decays."""

    def start_over(self) -> None:
        """Forget the past: the next reading does not continue the last one."""
        self._drift = [0.0, 0.0, 0.0]
        self._slip[:] = 0.0

    def problem(self, last: RobotState, state: RobotState) -> str:
        """Reason why the readings up to `state`, which follows `last`, disagree; empty if none."""
        passed = state.time - last.time
        twist = _twist(last, state, passed)
        parts = zip(self._drift, twist, strict=True)
        self._drift = [_DECAY * drift + part for drift, part in parts]
        self._slip = _DECAY * self._slip + _slip(last, state, passed)
        drift = math.hypot(*self._drift)
        if drift > MAX_DRIFT:
            return f"gyroscope and attitude disagree by {drift:.2f} rad"
        slip = np.abs(self._slip)
        worst = int(slip.argmax())
        if slip[worst] > MAX_SLIP:
            return f"angle and speed of {JOINTS[worst]} disagree by {slip[worst]:.2f} rad"
        return ""


def comparable(last: RobotState | None, state: RobotState, longest: float = MAX_INTERVAL) -> bool:
    """True if two readings are near enough in time to be compared; `longest` is in seconds."""
    return last is not None and 0.0 < state.time - last.time <= longest


def break_problem(last: RobotState, state: RobotState) -> str:
    """Reason why one comparable reading cannot follow the other; empty if it can."""
    passed = state.time - last.time
    # The limits of one control step grow with the time that passed.
    twist = math.hypot(*_twist(last, state, passed))
    if twist > MAX_TWIST * max(passed / CONTROL_DT, 1.0):
        return f"gyroscope and attitude disagree by {twist:.2f} rad"
    if jump := jump_problem(last, state, passed):
        return jump
    slip = np.abs(_slip(last, state, passed))
    worst = int(slip.argmax())
    if slip[worst] > MAX_SKIP * max(passed / CONTROL_DT, 1.0):
        return f"angle and speed of {JOINTS[worst]} disagree by {slip[worst]:.2f} rad"
    return ""


def _slip(last: RobotState, state: RobotState, passed: float) -> np.ndarray:
    """Turns [12] rad of the joints in `passed` seconds beyond those of their mean speeds."""
    mean_speed = 0.5 * (last.joint_velocity + state.joint_velocity)
    return state.joint_position - last.joint_position - passed * mean_speed


def _twist(last: RobotState, state: RobotState, passed: float) -> list[float]:
    """Turn [3] rad of the attitude in `passed` seconds beyond that of the gyroscope."""
    # Plain numbers: for three of them NumPy takes ten times as long.
    before = last.angular_velocity.tolist()
    after = state.angular_velocity.tolist()
    turn = rotation_vector(last.quaternion, state.quaternion)
    return [turn[axis] - 0.5 * passed * (before[axis] + after[axis]) for axis in range(3)]


def jump_problem(last: RobotState, state: RobotState, passed: float) -> str:
    """Name a joint that turned farther in `passed` seconds than its speeds allow; empty if none.

    Between two readings a speed can leave the range of both by as much as the motor accelerates in
    that time: the tolerance of the turn grows with the time squared.
    """
    turn = state.joint_position - last.joint_position
    before = passed * last.joint_velocity
    after = passed * state.joint_velocity
    # Distance of the turn from the interval between both.
    beyond = np.maximum(np.minimum(before, after) - turn, turn - np.maximum(before, after))
    worst = int(beyond.argmax())
    if beyond[worst] <= MAX_JUMP * max(passed / CONTROL_DT, 1.0) ** 2:
        return ""
    return f"{JOINTS[worst]} jumped by {abs(turn[worst]):.2f} rad at another speed"


def rotation_vector(before: np.ndarray, after: np.ndarray) -> list[float]:
    """Rotation vector [3] rad, base frame, from one attitude (w, x, y, z) to another."""
    w, x, y, z = before.tolist()
    a, b, c, d = after.tolist()
    # Quaternion of the turn: the inverse of the first times the second.
    cosine = w * a + x * b + y * c + z * d
    axis = [
        w * b - x * a + z * c - y * d,
        w * c - y * a + x * d - z * b,
        w * d - z * a + y * b - x * c,
    ]
    sine = math.hypot(*axis)
    # Of both quaternions of a turn the one with the smaller angle; a turn of zero has no axis.
    share = math.copysign(2.0 * math.atan2(sine, abs(cosine)) / sine, cosine) if sine else 1.0
    return [share * part for part in axis]
