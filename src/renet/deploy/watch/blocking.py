"""Detection of blocked joints, which hardly move while their targets do.

A robot walks on with one blocked joint, and most robots fall when they are braked in mid-stride:
the operator is told, and decides.
"""

import numpy as np

from renet.deploy.robots.base import RobotState
from renet.interface import JOINTS, LEGS

WINDOW = 50
"""Number of readings, 1 s, over which paths are compared: a stair may hold a leg for less."""
MIN_TRAVEL = 1.0
"""Path of a joint's target, rad, from which the joint can be judged."""
_PLAY = 0.3
"""Part of that path, rad, that a joint need not follow: a stiff leg bears a load in its place."""
_LEAST_SHARE = np.tile([0.1, 0.18, 0.06], len(LEGS))
"""Least share of the rest that a hip, a thigh and a calf travel. Healthy ones travelled at least
0.14, 0.24 and 0.09 of it in 900 s of walks with pushes on all terrains: of a Go1, with ideal motors
and with a network of a real one's, and of a Go2. Blocked hips and thighs travelled 0.05 to 0.15."""


class Blocking:
    """Compares the path of each joint with the path of its target."""

    def __init__(self) -> None:
        self.start_over()

    def start_over(self) -> None:
        """Forget the past, in which the robot did something else."""
        self._travel = np.zeros((WINDOW, len(JOINTS)))
        """Paths of the joints between two readings, rad. The newest row of both is `_next - 1`."""
        self._wanted = np.zeros((WINDOW, len(JOINTS)))
        """Paths of their targets, rad."""
        self._next = 0
        self._position: np.ndarray | None = None
        self._target: np.ndarray | None = None

    def warning(self, state: RobotState, target: np.ndarray) -> str:
        """Name a joint that hardly moves; empty if all do.

        Args:
            state: Reading, newer than the one before.
            target: Joint targets since the reading before, [12] rad.
        """
        if self._position is not None and self._target is not None:
            place = self._next % WINDOW
            self._travel[place] = np.abs(state.joint_position - self._position)
            self._wanted[place] = np.abs(target - self._target)
            self._next += 1
        self._position = state.joint_position
        self._target = target
        if self._next < WINDOW:
            return ""
        travel = self._travel.sum(axis=0)
        wanted = self._wanted.sum(axis=0)
        blocked = (wanted > MIN_TRAVEL) & (travel < _LEAST_SHARE * (wanted - _PLAY))
        if not blocked.any():
            return ""
        joint = int(blocked.argmax())
        return (
            f"{JOINTS[joint]} is blocked: it moved by {travel[joint]:.2f} rad in a second, "
            f"and its target by {wanted[joint]:.2f}"
        )
