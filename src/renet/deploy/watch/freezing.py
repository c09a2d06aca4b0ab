"""Sensors that say the same again and again: each for itself, and each joint that is to move."""

from collections.abc import Mapping

import numpy as np

from renet.deploy.robots.base import VECTORS, RobotState
from renet.interface import JOINTS

MOST_ALIKE = 5
"""Readings in a row, 0.1 s, that may be the same to the last bit."""
TOLD_TO_MOVE = 0.05
"""rad by which a joint's target moves over as many readings if it is to move: a robot that stands
still may read the same angle twice, as encoders count steps."""
NAMES: Mapping[str, str] = {
    "joint_position": "the joints' angles",
    "joint_velocity": "the joints' speeds",
    "joint_torque": "the joints' torques",
    "quaternion": "the attitude",
    "angular_velocity": "the gyroscope",
}
"""What an operator calls the vectors of a reading."""


class Freezing:
    """Counts the readings in a row in which a sensor said the same, to the last bit."""

    def __init__(self) -> None:
        self._last: RobotState | None = None
        self._alike = dict.fromkeys(VECTORS, 1)
        self._joints: np.ndarray | None = None
        """Readings in a row in which each joint's angle was the same; None while none must move."""
        self._low = self._high = np.zeros(len(JOINTS))
        """Ends of what each joint's target was meanwhile, rad."""

    def problem(self, state: RobotState, powered: bool, target: np.ndarray | None) -> str:
        """Why a new reading cannot be true; empty if it can.

        Args:
            state: the reading, newer than the one before.
            powered: whether motors hold the robot, so that each of its sensors trembles. One that
                lies still may read the same for long, but not from all sensors.
            target: [12] rad, where its joints have been told to be; None where they were not.
        """
        last, self._last = self._last, state
        if last is None:
            return ""
        for name in VECTORS:
            same = bool((getattr(last, name) == getattr(state, name)).all())
            self._alike[name] = self._alike[name] + 1 if same else 1
        if (alike := min(self._alike.values())) > MOST_ALIKE:
            return f"the readings are frozen: {alike} are the same"
        frozen = [name for name in VECTORS if self._alike[name] > MOST_ALIKE]
        # Drivers of robots that measure no torque say zero.
        if "joint_torque" in frozen and not state.joint_torque.any():
            frozen.remove("joint_torque")
        if powered and frozen:
            name = frozen[0]
            return f"frozen: {self._alike[name]} readings of {NAMES[name]} are the same"
        return self._joint_problem(last, state, target)

    def _joint_problem(self, last: RobotState, state: RobotState, target: np.ndarray | None) -> str:
        """Name a joint whose angle stays the same while its target moves; empty if none."""
        if target is None:
            self._joints = None
            return ""
        if self._joints is None:
            self._joints = np.ones(len(JOINTS), int)
            self._low = self._high = target
        same = last.joint_position == state.joint_position
        self._joints = np.where(same, self._joints + 1, 1)
        self._low = np.where(same, np.minimum(self._low, target), target)
        self._high = np.where(same, np.maximum(self._high, target), target)
        told = self._high - self._low > TOLD_TO_MOVE
        stuck = np.flatnonzero((self._joints > MOST_ALIKE) & told)
        if not len(stuck):
            return ""
        joint = JOINTS[stuck[0]]
        return f"{joint} is frozen or blocked: {self._joints[stuck[0]]} readings are the same"
