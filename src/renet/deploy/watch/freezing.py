"""Detection of frozen sensors: of whole readings, single sensors, and single joints."""

from collections.abc import Mapping

import numpy as np

from renet.deploy.robots.base import VECTORS, RobotState
from renet.interface import JOINTS

MAX_ALIKE = 5
"""Largest number of readings in a row, 0.1 s, that may be equal to the last bit."""
_MIN_TRAVEL = 0.05
"""Travel of a joint's target, rad, over as many readings from which the joint must move, too. A
robot that stands still may read the same angle twice, since encoders count steps."""
_SENSORS: Mapping[str, str] = {
    "joint_position": "the joints' angles",
    "joint_velocity": "the joints' speeds",
    "joint_torque": "the joints' torques",
    "quaternion": "the attitude",
    "angular_velocity": "the gyroscope",
}
"""Names of a reading's vectors in messages to the operator."""


class Freezing:
    """Counts the readings in a row that are equal to the last bit, for each sensor."""

    def __init__(self) -> None:
        self._last: RobotState | None = None
        self._alike = dict.fromkeys(VECTORS, 1)
        """Number of equal readings in a row of each sensor, including the newest."""
        self._joints: np.ndarray | None = None
        """Number of equal angles in a row of each joint, [12]; None while no joint must move."""
        self._low = np.zeros(len(JOINTS))
        """Lowest target of each joint over those readings, [12] rad."""
        self._high = np.zeros(len(JOINTS))
        """Highest target of each joint over those readings, [12] rad."""

    def problem(self, state: RobotState, powered: bool, target: np.ndarray | None) -> str:
        """Return why a new reading cannot be true; empty if it can.

        Args:
            state: The reading, newer than the one before.
            powered: True while motors hold the robot, so that every sensor shows noise. While a
                robot lies still, one sensor may stay the same for long, but not all of them.
            target: Joint targets, [12] rad; None where joints are not to move.
        """
        last = self._last
        self._last = state
        if last is None:
            return ""
        for name in VECTORS:
            same = bool((getattr(last, name) == getattr(state, name)).all())
            self._alike[name] = self._alike[name] + 1 if same else 1
        alike = min(self._alike.values())
        if alike > MAX_ALIKE:
            return f"the readings are frozen: {alike} are the same"
        frozen = [name for name in VECTORS if self._alike[name] > MAX_ALIKE]
        # Drivers of robots that measure no torque report zero.
        if "joint_torque" in frozen and not state.joint_torque.any():
            frozen.remove("joint_torque")
        if powered and frozen:
            name = frozen[0]
            return f"frozen: {self._alike[name]} readings of {_SENSORS[name]} are the same"
        return self._joint_problem(last, state, target)

    def _joint_problem(self, last: RobotState, state: RobotState, target: np.ndarray | None) -> str:
        """Name a joint whose angle stays the same while its target moves; empty if none."""
        if target is None:
            self._joints = None
            return ""
        if self._joints is None:
            self._joints = np.ones(len(JOINTS), int)
            self._low = target
            self._high = target
        same = last.joint_position == state.joint_position
        # Count on, and widen the targets' range, for as long as the angle stays the same.
        self._joints = np.where(same, self._joints + 1, 1)
        self._low = np.where(same, np.minimum(self._low, target), target)
        self._high = np.where(same, np.maximum(self._high, target), target)
        moved = self._high - self._low > _MIN_TRAVEL
        stuck = np.flatnonzero((self._joints > MAX_ALIKE) & moved)
        if not len(stuck):
            return ""
        joint = JOINTS[stuck[0]]
        return f"{joint} is frozen or blocked: {self._joints[stuck[0]]} readings are the same"
