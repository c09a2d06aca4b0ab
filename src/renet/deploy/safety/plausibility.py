"""Whether a robot's readings can be true of one body: each is compared with the one before.

A sensor that is frozen, a joint whose angle does not follow its speed, and a gyroscope that
contradicts the attitude are noticed. An error that both share, or that grows slowly, is not.
"""

import math

import numpy as np

from renet.deploy.robots.base import VECTORS, RobotState
from renet.interface import CONTROL_DT, JOINTS

MAX_JUMP = 0.4
"""rad by which a joint may turn in a control step beyond what its speeds before and after say: 0.11
at most in 28 simulated walks of 15 s with pushes, falls and camera faults. A test holds half."""
MAX_DRIFT = 0.3
"""rad by which gyroscope and attitude may disagree over the last steps: 0.08 in those walks."""
FORGET = 0.9
"""Share of a disagreement that counts a control step later."""
MOST_ALIKE = 5
"""Readings in a row, 0.1 s, that may be the same to the last bit; in those walks no two were."""
LONGEST = 0.05
"""Seconds between two readings over which they are compared."""


class Readings:
    """Compares each reading with the one before."""

    def __init__(self) -> None:
        self._last: RobotState | None = None
        self._drift = [0.0, 0.0, 0.0]
        self._alike = 1

    def problem(self, state: RobotState) -> str:
        """Why a new, clean reading cannot be true; empty if it can."""
        last, self._last = self._last, state
        passed = math.inf if last is None else state.time - last.time
        if last is None or not 0.0 < passed <= LONGEST:
            self._drift = [0.0, 0.0, 0.0]
            self._alike = 1
            return ""
        same = all(getattr(last, n).tobytes() == getattr(state, n).tobytes() for n in VECTORS)
        self._alike = self._alike + 1 if same else 1
        if self._alike > MOST_ALIKE:
            return f"the readings are frozen: {self._alike} are the same"
        # Plain numbers: for three of them NumPy takes ten times as long.
        before, after = last.angular_velocity.tolist(), state.angular_velocity.tolist()
        rates = [0.5 * passed * (a + b) for a, b in zip(before, after, strict=True)]
        turn = rotation_vector(last.quaternion, state.quaternion)
        parts = zip(self._drift, turn, rates, strict=True)
        self._drift = [FORGET * drift + turned - rate for drift, turned, rate in parts]
        drift = math.hypot(*self._drift)
        if drift > MAX_DRIFT:
            return f"gyroscope and attitude disagree by {drift:.2f} rad"
        return jump_problem(last, state, passed)


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
