"""Record of a closed-loop run, step by step."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from renet.interface import CONTROL_DT, MAP_HEIGHT, PHYSICS_DT

UPDATES_PER_STEP = round(CONTROL_DT / PHYSICS_DT)
"""Selector updates in one control step."""


@dataclass
class Film:
    """Poses, images and maps of R robots, for films."""

    poses: np.ndarray
    """Generalised positions, [T, R, nq]."""
    images: np.ndarray
    """Depth image of each robot at each tick, [ticks, R, 48, 64] uint8."""
    maps: np.ndarray
    """VP's height map after each tick, [ticks, R, 132] m; empty for policies without one."""
    maps_seen: np.ndarray
    """True where that map shows ground that the robot has seen, [ticks, R, 132] bool."""
    map_height: float = MAP_HEIGHT
    """Height of the base above flat ground at which these maps are zero, m."""


@dataclass(frozen=True)
class TrueState:
    """True state of simulated robots: [N] after a control step, [T, N] in a run."""

    forward_velocity: np.ndarray
    """Base velocity along the commanded yaw, m/s."""
    travelled: np.ndarray
    """Horizontal distance from where the robot last started, m."""
    collisions: np.ndarray
    """Number of thighs, calves and trunks in contact."""
    power: np.ndarray
    """Sum of |torque * joint velocity|, W."""
    fell: np.ndarray
    """True where the episode ended in this step by a fall, judged by the true pose, bool."""
    ended: np.ndarray
    """True where the episode ended in this step, by a fall, its time limit or its tile's edge.
    The robot is at its next start already: the step's velocity, power and collisions are of the
    start. Means are taken over the steps before."""


@dataclass(frozen=True)
class StepResult(TrueState):
    """Observations and true state of N robots after a control step."""

    proprioception: np.ndarray
    """Scaled proprioception, [N, 45]."""
    depth: np.ndarray
    """Depth images in [0, 1], held between the camera's ticks, [N, 48, 64]."""
    angular_velocity: np.ndarray
    """True angular velocity of the base, base frame, [N, 3] rad/s."""


@dataclass(frozen=True)
class Trace(TrueState):
    """Record of a run, for each control step and robot; [T, N] unless a shape is given.

    A robot that falls or leaves its tile is put back at a start and goes on; `over`, `fallen`,
    `speed` and `first_try` are for studies in which only the first try counts.
    """

    anomaly: np.ndarray
    """The policy's anomaly score."""
    probability: np.ndarray
    """Vision probability P_t at the end of the step."""
    vision: np.ndarray
    """True where the VP estimator's latent drove this step, bool."""
    has_image: np.ndarray
    """True where VP's newest tick had an image, bool; without one, it goes on from memory."""
    map_error: np.ndarray
    """Error of VP's height map ahead that VP itself predicts, m."""
    unseen: np.ndarray
    """True where the command leads to ground that the robot has not seen, bool."""
    failing: np.ndarray
    """True where the camera is failing, bool."""
    trusted: np.ndarray
    """The selector's answer after each of its U updates of a step, [T, U, N] bool."""
    film: Film | None = field(default=None, repr=False)
    """Poses and images for films, if they were kept."""

    @property
    def sees(self) -> np.ndarray:
        """True where VP drove, and its newest tick had an image, [T, U, N] bool."""
        return self.trusted & self.has_image[:, None]

    @classmethod
    def empty(cls, steps: int, count: int) -> Trace:
        """Make room for `steps` control steps of `count` robots."""
        flags = ("fell", "ended", "vision", "has_image", "unseen", "failing")
        arrays: dict[str, Any] = {}
        for field_ in fields(cls):
            name = field_.name
            if name not in ("trusted", "film"):
                arrays[name] = np.zeros((steps, count), bool if name in flags else float)
        return cls(**arrays, trusted=np.ones((steps, UPDATES_PER_STEP, count), bool))

    def until(self, steps: int) -> Trace:
        """Return the first control steps, without film."""
        return self._part(np.s_[:steps])

    def robots(self, index: slice | np.ndarray) -> Trace:
        """Select some robots, by their places or a mask [N], without film."""
        return self._part(np.s_[..., index])

    def _part(self, index: Any) -> Trace:
        """Select a part of every array by its index, without film."""
        arrays = dict(vars(self))
        # A film has other robots and steps than the arrays.
        del arrays["film"]
        return Trace(**{name: array[index] for name, array in arrays.items()})

    def groups(self, each: int) -> list[Trace]:
        """Divide the robots, in their order, into groups of `each`; returns their traces."""
        # A last group may be smaller.
        starts = range(0, self.fell.shape[1], each)
        return [self.robots(slice(start, start + each)) for start in starts]

    def first_try(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """End of each robot's first try.

        Returns:
            Masks of the robots that crossed, whose episodes ended without a fall, and of those that
            fell, [N] bool each; and the time until the end, [N] s, NaN if there was none.
        """
        # The first step in which the episode ended; step 0 where it never did.
        first = self.ended.argmax(axis=0)
        robot = np.arange(self.ended.shape[1])
        ended = self.ended[first, robot]
        fell = self.fell[first, robot]
        return ended & ~fell, ended & fell, np.where(ended, (first + 1) * CONTROL_DT, np.nan)

    @property
    def over(self) -> np.ndarray:
        """True where the first try ended in this or an earlier step, [T, N] bool."""
        return np.logical_or.accumulate(self.ended, axis=0)

    @property
    def trying(self) -> np.ndarray:
        """True where the first try goes on in this step, or ends with it, [T, N] bool."""
        return ~np.vstack([np.zeros((1, self.ended.shape[1]), bool), self.over[:-1]])

    @property
    def fallen(self) -> np.ndarray:
        """True where the first try is over, by a fall, [T, N] bool."""
        return self.over & self.first_try()[1]

    @property
    def speed(self) -> np.ndarray:
        """Velocity along the commanded yaw, zero after a fall, [T, N] m/s."""
        return np.where(self.fallen, 0.0, self.forward_velocity)
