"""Comparison of a robot's speed with the speed that its policy estimates."""

import math

import numpy as np

from renet.deploy.robots.base import RobotState, projected_gravity
from renet.deploy.watch.legs import Legs

_DECAY = 0.98
"""Weight of the past at a control step: the running mean is over about a second."""
MIN_READINGS = 75
"""Number of readings from which the mean can be judged."""
MAX_DIFFERENCE = 1.0
"""Largest difference, m/s, between the legs' speed and the estimated one: at most 0.65 in 560 s of
walks with pushes of a Go1 and a Go2, on stairs and stones, where the lowest foot does not always
stand."""


class SpeedWatch:
    """Compares the estimated velocity with the velocity of the base over its lowest foot."""

    def __init__(self, legs: Legs) -> None:
        self._legs = legs
        self.start_over()

    def start_over(self) -> None:
        """Forget the past, in which the robot did something else."""
        self._apart = np.zeros(2)
        """Running mean [2] m/s of the difference, x and y in the base frame."""
        self._count = 0

    def problem(self, state: RobotState, estimate: np.ndarray) -> str:
        """Return why an estimated velocity, [3] m/s, base frame, is wrong; empty if it is not."""
        feet, motion = self._legs.feet(state.joint_position, state.joint_velocity)
        depth = feet @ np.array(projected_gravity(state.quaternion))
        lowest = int(depth.argmax())
        # The lowest foot stands on the ground: in the base frame it moves against the base.
        turning = np.cross(state.angular_velocity, feet[lowest])
        velocity = -(motion[lowest] + turning)
        self._apart = _DECAY * self._apart + (1.0 - _DECAY) * (velocity - estimate)[:2]
        self._count += 1
        apart = math.hypot(*self._apart.tolist())
        if self._count < MIN_READINGS or apart <= MAX_DIFFERENCE:
            return ""
        return (
            f"the legs move {apart:.1f} m/s faster or slower than the policy believes, as of a "
            "robot that has fallen or is stuck"
        )
