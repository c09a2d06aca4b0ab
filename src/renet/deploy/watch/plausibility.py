"""Consistency of a robot's readings, each of which is compared with the one before.

The checks find a joint whose angle does not follow its speed, and a gyroscope that contradicts the
attitude. They do not find an error that both have in common, or one that grows slowly.
"""

import math

import numpy as np

from renet.deploy.robots.base import RobotState
from renet.interface import CONTROL_DT, JOINTS

MAX_JUMP = 0.4
"""Largest turn of a joint in a control step beyond what its speeds before and after allow, rad: at
most 0.17 in 560 s of walks with pushes, and half as much in a test with falls."""
MAX_TWIST = 0.25
"""Largest disagreement of gyroscope and attitude over a control step, rad: 0.04 in those walks."""
MAX_DRIFT = 0.12
"""Largest disagreement of gyroscope and attitude over the last second, rad: 0.06 in those walks."""
MAX_SKIP = 0.5
"""Largest disagreement of a joint's angle and mean speed over a control step, rad: 0.17 there."""
MAX_SLIP = 0.6
"""Largest disagreement of a joint's angle and mean speed over the last second, rad: 0.27 in those
walks and in falls."""
_DECAY = 0.98
"""Share of a disagreement that still counts a control step later."""
MAX_INTERVAL = 0.05
"""Longest time between two readings that are compared, s."""


class Disagreement:
    """Sum of the disagreements of readings in a row, in which older ones count less and less."""

    def __init__(self) -> None:
        self._drift = [0.0, 0.0, 0.0]
        """Disagreement of gyroscope and attitude, [3] rad, base frame."""
        self._slip = np.zeros(len(JOINTS))
        """Disagreement of joint angles and speeds, [12] rad."""

    def start_over(self) -> None:
        """Reset the sum, because the next reading does not continue the last one."""
        self._drift = [0.0, 0.0, 0.0]
        self._slip[:] = 0.0

    def problem(self, last: RobotState, state: RobotState) -> str:
        """Add reading `state`, which follows `last`; returns what disagrees, empty if nothing."""
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
    """Return True if a reading follows another within `longest`, s, and can be compared with it."""
    return last is not None and 0.0 < state.time - last.time <= longest


def break_problem(last: RobotState, state: RobotState) -> str:
    """Return why reading `state` cannot follow `last`, comparable with it; empty if it can."""
    passed = state.time - last.time
    # The limits are those of one control step; they grow with the time that passed.
    steps = max(passed / CONTROL_DT, 1.0)
    twist = math.hypot(*_twist(last, state, passed))
    if twist > MAX_TWIST * steps:
        return f"gyroscope and attitude disagree by {twist:.2f} rad"
    if jump := jump_problem(last, state, passed):
        return jump
    slip = np.abs(_slip(last, state, passed))
    worst = int(slip.argmax())
    if slip[worst] > MAX_SKIP * steps:
        return f"angle and speed of {JOINTS[worst]} disagree by {slip[worst]:.2f} rad"
    return ""


def _slip(last: RobotState, state: RobotState, passed: float) -> np.ndarray:
    """Return how far joints turned in `passed` seconds beyond their mean speeds, [12] rad."""
    mean_speed = 0.5 * (last.joint_velocity + state.joint_velocity)
    return state.joint_position - last.joint_position - passed * mean_speed


def _twist(last: RobotState, state: RobotState, passed: float) -> list[float]:
    """Return how far the attitude turned in `passed` seconds beyond the gyroscope, [3] rad."""
    # Plain numbers: for three of them NumPy takes ten times as long.
    before = last.angular_velocity.tolist()
    after = state.angular_velocity.tolist()
    turn = rotation_vector(last.quaternion, state.quaternion)
    return [turn[axis] - 0.5 * passed * (before[axis] + after[axis]) for axis in range(3)]


def jump_problem(last: RobotState, state: RobotState, passed: float) -> str:
    """Name a joint that turned farther in `passed` seconds than its speeds allow; empty if none.

    Between two readings, a motor may accelerate beyond both speeds and brake again, so that the
    tolerance of the turn grows with the square of the time.
    """
    turn = state.joint_position - last.joint_position
    before = passed * last.joint_velocity
    after = passed * state.joint_velocity
    # Distance of the turn from the interval between `before` and `after`.
    beyond = np.maximum(np.minimum(before, after) - turn, turn - np.maximum(before, after))
    worst = int(beyond.argmax())
    if beyond[worst] <= MAX_JUMP * max(passed / CONTROL_DT, 1.0) ** 2:
        return ""
    return f"{JOINTS[worst]} jumped by {abs(turn[worst]):.2f} rad at another speed"


def rotation_vector(before: np.ndarray, after: np.ndarray) -> list[float]:
    """Return the rotation from one attitude (w, x, y, z) to another, [3] rad, base frame."""
    w, x, y, z = before.tolist()
    a, b, c, d = after.tolist()
    # Quaternion of the turn: the inverse of `before` times `after`.
    cosine = w * a + x * b + y * c + z * d
    axis = [
        w * b - x * a + z * c - y * d,
        w * c - y * a + x * d - z * b,
        w * d - z * a + y * b - x * c,
    ]
    sine = math.hypot(*axis)
    # A turn has two quaternions: take the one of the smaller angle. A turn of zero has no axis.
    share = math.copysign(2.0 * math.atan2(sine, abs(cosine)) / sine, cosine) if sine else 1.0
    return [share * part for part in axis]
