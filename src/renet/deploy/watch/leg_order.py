"""Whether legs are wired in the right order: each pushes in turn, and the base must lean away.

A leg whose motors answer to another leg's numbers, commands and readings alike, seems to obey. But
the ground lifts the corner at which it really is.
"""

import math

import numpy as np

from renet.bundle.manifest import RobotSpec
from renet.deploy.robots.base import RobotState, projected_gravity
from renet.interface import LEGS

CORNERS = {"FR": (1.0, -1.0), "FL": (1.0, 1.0), "RR": (-1.0, -1.0), "RL": (-1.0, 1.0)}
"""Where each leg is, seen from the middle of the base: x ahead, y left."""
REACH = 0.45
"""Share of the way to the default pose that a leg is stretched."""
OUT, JUDGED, BACK = 0.5, 0.7, 0.75
"""Shares of a leg's time at which it is stretched, is judged, and goes back."""
PUSHES = 4.0
"""N m in its calf from which a leg pushes against something."""
LEANS = 0.012
"""Sine of the angle by which the base must lean then."""
ASIDE = 0.5
"""Least cosine between the ways in which it leans and should lean."""
FOLLOWS = 0.5
"""Share of its stretch that a leg in the air must make."""


class LegTest:
    """Stretches one leg after the other from the pose in which a robot lies."""

    def __init__(self, robot: RobotSpec, seconds: float, state: RobotState) -> None:
        """Begin with a reading of the robot; the test takes some seconds, none if they are zero."""
        self._default = np.asarray(robot.default_position)
        self._each = seconds / len(LEGS)
        self._start = state.joint_position.copy()
        self._leg = -1
        self._judged = False
        self._lean = np.zeros(2)
        self.problem = ""
        """Why the robot must not stand up; empty while nothing is found."""

    def target(self, elapsed: float, state: RobotState) -> np.ndarray:
        """Joint targets [12] rad at a time since the test's start, s, and a reading of then."""
        leg, passed = divmod(elapsed / self._each, 1.0)
        if int(leg) != self._leg:
            self._leg, self._judged = int(leg), False
            self._lean = _leaning(state)
        rows = slice(3 * self._leg, 3 * self._leg + 3)
        if passed >= JUDGED and not self._judged:
            self._judged = True
            self.problem = self.problem or self._judge(state, rows)
        target = self._start.copy()
        stretch = REACH * (self._default[rows] - self._start[rows])
        target[rows] += _smooth(passed) * stretch
        return target

    def _judge(self, state: RobotState, rows: slice) -> str:
        """What a stretched leg shows to be wrong; empty if nothing."""
        name = LEGS[self._leg]
        lean = _leaning(state) - self._lean
        if abs(state.joint_torque[rows][2]) < PUSHES:  # It hangs in the air, or is limp.
            asked = REACH * (self._default[rows] - self._start[rows])
            moved = state.joint_position[rows] - self._start[rows]
            followed = float(moved @ asked) >= FOLLOWS * float(asked @ asked)
            return "" if followed else f"leg {name} does not follow: is it another one's number?"
        # Gravity moves towards the corners that sink.
        away = -np.array(CORNERS[name]) / math.sqrt(2.0)
        size = math.hypot(*lean.tolist())
        if size < LEANS:
            return f"leg {name} pushes, but the base does not lean: what holds it?"
        if float(lean @ away) < ASIDE * size:
            return f"leg {name} pushes, and another corner rises: are legs wired in another order?"
        return ""


def _leaning(state: RobotState) -> np.ndarray:
    """Gravity's part [2] in the plane of the base."""
    return np.array(projected_gravity(state.quaternion)[:2])


def _smooth(passed: float) -> float:
    """How far a leg is stretched at a share of its time, 0 to 1, without a jerk."""
    share = passed / OUT if passed < BACK else (1.0 - passed) / (1.0 - BACK)
    share = min(max(share, 0.0), 1.0)
    return share * share * (3.0 - 2.0 * share)
