"""Whether a robot is as fast as its policy believes."""

import math

import numpy as np

from renet.deploy.robots.base import RobotState, projected_gravity
from renet.deploy.watch.legs import Legs

FORGET = 0.98
"""Share of a speed that counts a control step later: a mean over a second."""
SETTLED = 75
"""Readings before the mean says anything."""
MOST_APART = 1.0
"""m/s by which the legs' speed and the estimated one may differ: 0.65 at most in 560 s of pushed
walks of a Go1 and a Go2, on stairs and stones, where the lowest foot does not always stand."""


class SpeedWatch:
    """Compares the estimated velocity with the one at which the lowest foot goes back."""

    def __init__(self, legs: Legs) -> None:
        self._legs = legs
        self.start_over()

    def start_over(self) -> None:
        """Forget the past: the robot did something else meanwhile."""
        self._apart = np.zeros(2)
        self._count = 0

    def problem(self, state: RobotState, estimate: np.ndarray) -> str:
        """Why an estimated velocity [3] m/s in the base's frame cannot be true; empty if it can."""
        feet, motion = self._legs.feet(state.joint_position, state.joint_velocity)
        depth = feet @ np.array(projected_gravity(state.quaternion))
        lowest = int(depth.argmax())
        # The foot stands: what it does in the base's frame is what the base does the other way.
        turning = np.cross(state.angular_velocity, feet[lowest])
        velocity = -(motion[lowest] + turning)
        self._apart = FORGET * self._apart + (1.0 - FORGET) * (velocity - estimate)[:2]
        self._count += 1
        apart = math.hypot(*self._apart.tolist())
        if self._count < SETTLED or apart <= MOST_APART:
            return ""
        return f"the legs move {apart:.1f} m/s faster or slower than the policy believes"
