"""Says which joint was moved and which way it must have gone, for the joint-order check."""

from collections.abc import Callable, Iterator

import numpy as np

from renet.deploy.robots.base import RobotState, projected_gravity
from renet.interface import JOINTS

TURN = 0.25
"""rad a joint must turn, and sine of the angle the base must lean, to be worth a line."""
ENDS = {"FR": "front right", "FL": "front left", "RR": "rear right", "RL": "rear left"}
WAYS = {
    "hip": ("foot moves to the robot's left", "foot moves to the robot's right"),
    "thigh": ("foot moves back", "foot moves forward"),
    "calf": ("knee straightens", "knee folds"),
}
"""What a positive and a negative turn of each joint look like."""
LEANS = ((0, "nose", "tail"), (1, "left side", "right side"))
"""Axis of the base, and which end is down when gravity points along and against it."""


class JointWatch:
    """Compares readings with those before; meant for a limp robot moved by hand."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._from: np.ndarray | None = None
        self._leaning = ""

    def look(self, state: RobotState | None) -> None:
        """Say what has moved since the last reading, if there is a new one."""
        if state is None:
            return
        for line in (*self._moved(state), *self._leant(state)):
            self._say(line)

    def _moved(self, state: RobotState) -> Iterator[str]:
        now = state.joint_position
        if self._from is None:
            self._from = now.copy()
        turn = now - self._from
        for joint in np.flatnonzero(np.abs(turn) >= TURN):
            self._from[joint] = now[joint]
            leg, part, _ = JOINTS[joint].split("_")
            way = WAYS[part][int(turn[joint] < 0)]
            yield f"{leg}_{part} {turn[joint]:+.2f} to {now[joint]:+.2f} rad: {ENDS[leg]}, {way}"

    def _leant(self, state: RobotState) -> Iterator[str]:
        gravity = projected_gravity(state.quaternion)
        down = [
            along if gravity[axis] > 0 else against
            for axis, along, against in LEANS
            if abs(gravity[axis]) >= TURN
        ]
        leaning = " and ".join(down)
        if leaning and leaning != self._leaning:
            yield f"the base leans: {leaning} down"
        self._leaning = leaning
