"""Whether a robot's readings can be true of one body: each is compared with the one before.

A joint whose angle does not follow its speed, and a gyroscope that contradicts the attitude are
noticed. An error that both share, or that grows slowly, is not.
"""

import math

import numpy as np

from renet.deploy.robots.base import RobotState
from renet.interface import CONTROL_DT, JOINTS

MAX_JUMP = 0.4
"""rad by which a joint may turn in a control step beyond what its speeds before and after say: 0.17
at most in 560 s of walks with pushes, and half of it in a test with falls."""
MAX_TWIST = 0.25
"""rad by which gyroscope and attitude may disagree over one control step: 0.04 in those walks."""
MAX_DRIFT = 0.2
"""rad by which they may disagree over the last second: 0.05 in those walks."""
MAX_SKIP = 0.5
"""rad by which a joint's angle and its mean speed may disagree over one control step: 0.17."""
MAX_SLIP = 0.9
"""rad by which they may disagree over the last half second: 0.27."""
FORGET = 0.98
FORGET_JOINTS = 0.95
"""Share of each disagreement that counts a control step later."""
LONGEST = 0.05
"""Seconds between two readings over which they are compared."""


class Readings:
    """Adds up how far a reading is from what the one before foretold."""

    def __init__(self) -> None:
        self._drift = [0.0, 0.0, 0.0]
        self._slip = np.zeros(len(JOINTS))

    def start_over(self) -> None:
        """Forget the past: the next reading does not follow on the last one."""
        self._drift = [0.0, 0.0, 0.0]
        self._slip[:] = 0.0

    def problem(self, last: RobotState, state: RobotState) -> str:
        """Why a reading that follows on another cannot be true for long; empty if it can."""
        passed = state.time - last.time
        twist = _twist(last, state, passed)
        parts = zip(self._drift, twist, strict=True)
        self._drift = [FORGET * drift + part for drift, part in parts]
        self._slip = FORGET_JOINTS * self._slip + _slip(last, state, passed)
        drift = math.hypot(*self._drift)
        if drift > MAX_DRIFT:
            return f"gyroscope and attitude disagree by {drift:.2f} rad"
        slip = np.abs(self._slip)
        worst = int(slip.argmax())
        if slip[worst] > MAX_SLIP:
            return f"angle and speed of {JOINTS[worst]} disagree by {slip[worst]:.2f} rad"
        return ""


def comparable(last: RobotState | None, state: RobotState, longest: float = LONGEST) -> bool:
    """Whether two readings are near enough in time to be compared."""
    return last is not None and 0.0 < state.time - last.time <= longest


def break_problem(last: RobotState, state: RobotState) -> str:
    """Why two comparable readings cannot be of one body, nor one follow the other; else empty."""
    passed = state.time - last.time
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
    """How far [12] rad joints turned in `passed` seconds beyond what their mean speeds say."""
    mean_speed = 0.5 * (last.joint_velocity + state.joint_velocity)
    return state.joint_position - last.joint_position - passed * mean_speed


def _twist(last: RobotState, state: RobotState, passed: float) -> list[float]:
    """How far [3] rad the attitude turned in `passed` seconds beyond what the gyroscope says."""
    # Plain numbers: for three of them NumPy takes ten times as long.
    before, after = last.angular_velocity.tolist(), state.angular_velocity.tolist()
    turn = rotation_vector(last.quaternion, state.quaternion)
    parts = zip(turn, before, after, strict=True)
    return [angle - 0.5 * passed * (first + second) for angle, first, second in parts]


def jump_problem(last: RobotState, state: RobotState, passed: float) -> str:
    """Name a joint that turned farther in `passed` seconds than its speeds say; empty if none.

    Between two readings a speed can leave the range of both by what the motor's acceleration makes
    of the time, so that the turn is free within a distance that grows with the time squared.
    """
    turn = state.joint_position - last.joint_position
    before, after = passed * last.joint_velocity, passed * state.joint_velocity
    beyond = np.maximum(np.minimum(before, after) - turn, turn - np.maximum(before, after))
    worst = int(beyond.argmax())
    if beyond[worst] <= MAX_JUMP * max(passed / CONTROL_DT, 1.0) ** 2:
        return ""
    return f"{JOINTS[worst]} jumped by {abs(turn[worst]):.2f} rad at another speed"


def rotation_vector(before: np.ndarray, after: np.ndarray) -> list[float]:
    """The turn [3] rad from one attitude (w, x, y, z) to another, in the base frame."""
    (w, x, y, z), (a, b, c, d) = before.tolist(), after.tolist()
    cosine = w * a + x * b + y * c + z * d  # The inverse of the one times the other.
    axis = [
        w * b - x * a + z * c - y * d,
        w * c - y * a + x * d - z * b,
        w * d - z * a + y * b - x * c,
    ]
    sine = math.hypot(*axis)
    share = math.copysign(2.0 * math.atan2(sine, abs(cosine)) / sine, cosine) if sine else 1.0
    return [share * part for part in axis]
