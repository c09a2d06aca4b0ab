"""Test of the legs' wiring: each leg pushes in turn, and the base must lean away from it.

A leg whose motors have another leg's numbers, in commands and readings alike, seems to obey. But
the ground lifts the corner of the base at which that leg really is.
"""

import math

import numpy as np

from renet.bundle.manifest import RobotSpec
from renet.deploy.robots.base import RobotState, projected_gravity
from renet.deploy.safety.machine import smooth_step
from renet.interface import LEGS

_CORNERS = {"FR": (1.0, -1.0), "FL": (1.0, 1.0), "RR": (-1.0, -1.0), "RL": (-1.0, 1.0)}
"""Direction of each leg from the middle of the base: x forward, y left."""
_STRETCH = 0.45
"""Share of the way to the default pose by which a leg is stretched."""
_STRETCHED = 0.5
"""Share of a leg's time after which it is fully stretched."""
_JUDGEMENT = 0.7
"""Share of a leg's time after which it is judged."""
_RETURN = 0.75
"""Share of a leg's time after which it begins to go back."""
_MIN_TORQUE = 4.0
"""Torque of the calf, N m, from which a leg pushes against something."""
_MIN_LEAN = 0.012
"""Smallest sine of the angle by which the base must lean when a leg pushes."""
_MIN_COSINE = 0.5
"""Smallest cosine of the angle between the direction of the lean and the expected one."""
_MIN_MOTION = 0.5
"""Smallest share of its stretch by which a leg in the air must move."""


class LegTest:
    """Stretches one leg after the other from the pose in which a robot lies, and judges each."""

    def __init__(self, robot: RobotSpec, seconds: float, state: RobotState) -> None:
        """Begin with a reading of the robot in its lying pose; all legs together take `seconds`."""
        self._default = np.asarray(robot.default_position)
        self._each = seconds / len(LEGS)
        """Time of each leg, s."""
        self._start = state.joint_position.copy()
        self._leg = -1
        self._judged = False
        self._lean = np.zeros(2)
        """Unit gravity vector in the plane of the base before the leg moved, [2]."""
        self.problem = ""
        """Reason why the robot must not stand up; empty while nothing is found."""

    def target(self, elapsed: float, state: RobotState) -> np.ndarray:
        """Return joint targets, [12] rad, `elapsed` seconds into the test; may judge a leg."""
        leg, passed = divmod(elapsed / self._each, 1.0)
        if int(leg) != self._leg:
            self._leg = int(leg)
            self._judged = False
            self._lean = _leaning(state)
        rows = slice(3 * self._leg, 3 * self._leg + 3)
        if passed >= _JUDGEMENT and not self._judged:
            self._judged = True
            self.problem = self.problem or self._judge(state, rows)
        target = self._start.copy()
        stretch = _STRETCH * (self._default[rows] - self._start[rows])
        target[rows] += _stretched(passed) * stretch
        return target

    def _judge(self, state: RobotState, rows: slice) -> str:
        """Return why a stretched leg contradicts the wiring; empty if it does not."""
        name = LEGS[self._leg]
        lean = _leaning(state) - self._lean
        # The leg hangs in the air, or is limp: it must at least follow its command.
        if abs(state.joint_torque[rows][2]) < _MIN_TORQUE:
            asked = _STRETCH * (self._default[rows] - self._start[rows])
            moved = state.joint_position[rows] - self._start[rows]
            followed = float(moved @ asked) >= _MIN_MOTION * float(asked @ asked)
            return "" if followed else f"leg {name} does not follow: is it another one's number?"
        # In the base frame gravity moves towards the corners that sink.
        away = -np.array(_CORNERS[name]) / math.sqrt(2.0)
        size = math.hypot(*lean.tolist())
        if size < _MIN_LEAN:
            return f"leg {name} pushes, but the base does not lean: what holds it?"
        if float(lean @ away) < _MIN_COSINE * size:
            return f"leg {name} pushes, and another corner rises: are legs wired in another order?"
        return ""


def _leaning(state: RobotState) -> np.ndarray:
    """Return the x and y components of the unit gravity vector in the base frame, [2]."""
    return np.array(projected_gravity(state.quaternion)[:2])


def _stretched(passed: float) -> float:
    """Return how far a leg is stretched, 0 to 1, at a share of its time, 0 to 1."""
    share = passed / _STRETCHED if passed < _RETURN else (1.0 - passed) / (1.0 - _RETURN)
    return smooth_step(share)
