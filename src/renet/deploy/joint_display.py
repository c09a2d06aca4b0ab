"""Report of joints that are moved by hand, for the check of their order and signs."""

from collections.abc import Callable, Iterator

import numpy as np

from renet.deploy.robots.base import RobotState, projected_gravity
from renet.interface import JOINTS

TURN = 0.25
"""Smallest turn of a joint, rad, and smallest sine of the base's lean that are reported."""
HOLD = 0.2
"""Sine of the lean down to which an end that was reported counts as down: noise about `TURN` alone
would report it again and again."""
_ENDS = {"FR": "front right", "FL": "front left", "RR": "rear right", "RL": "rear left"}
WAYS = {
    "hip": ("foot moves to the robot's left", "foot moves to the robot's right"),
    "thigh": ("foot moves back", "foot moves forward"),
    "calf": ("knee straightens", "knee folds"),
}
"""Looks of a positive and of a negative turn of each kind of joint."""
_LEANS = ((0, "nose", "tail"), (1, "left side", "right side"))
"""Axis of the base, and its end that is down when gravity points along and against the axis."""


class JointDisplay:
    """Compares readings with those before; meant for a limp robot moved by hand."""

    def __init__(self, say: Callable[[str], None]) -> None:
        """Report lines by calling `say`."""
        self._say = say
        self._from: np.ndarray | None = None
        self._down: list[str] = []
        """Ends of the base that are down."""

    def step(self, state: RobotState | None) -> None:
        """Report the joints and the lean that changed since they were last reported."""
        if state is None:
            return
        for line in (*self._moved(state), *self._leant(state)):
            self._say(line)

    def _moved(self, state: RobotState) -> Iterator[str]:
        """Yield a line for each joint that has turned far enough."""
        now = state.joint_position
        if self._from is None:
            self._from = now.copy()
        # Against the last report, not the last reading, so that slow turns add up.
        turn = now - self._from
        for joint in np.flatnonzero(np.abs(turn) >= TURN):
            self._from[joint] = now[joint]
            leg, part, _ = JOINTS[joint].split("_")
            way = WAYS[part][int(turn[joint] < 0)]
            yield f"{leg}_{part} {turn[joint]:+.2f} to {now[joint]:+.2f} rad: {_ENDS[leg]}, {way}"

    def _leant(self, state: RobotState) -> Iterator[str]:
        """Yield a line if the base leans to another side than before."""
        gravity = projected_gravity(state.quaternion)
        down = []
        for axis, along, against in _LEANS:
            end = along if gravity[axis] > 0 else against
            least = HOLD if end in self._down else TURN
            if abs(gravity[axis]) >= least:
                down.append(end)
        if down and down != self._down:
            yield f"the base leans: {' and '.join(down)} down"
        self._down = down
