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
    """[T, R, nq], generalised positions."""
    images: np.ndarray
    """[ticks, R, 48, 64] uint8, the depth image of each robot at each tick."""
    maps: np.ndarray
    """[ticks, R, 132] m, VP's height map after each tick; empty for policies without one."""
    maps_seen: np.ndarray
    """[ticks, R, 132] bool, True where that map shows ground that the robot has seen."""
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
    """bool: the episode ended in this step by a fall, judged by the true pose."""
    ended: np.ndarray
    """bool: the episode ended in this step, by a fall, its time limit or its tile's edge. The robot
    is at its next start already: the step's velocity, power and collisions are of the start. Means
    are taken over the steps before."""


@dataclass(frozen=True)
class StepResult(TrueState):
    """Observations and true state of N robots after a control step."""

    proprioception: np.ndarray
    """[N, 45], scaled."""
    depth: np.ndarray
    """[N, 48, 64] in [0, 1], held between the camera's ticks."""
    angular_velocity: np.ndarray
    """[N, 3] true angular velocity of the base, rad/s, base frame."""


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
    """bool: the VP estimator's latent drove this step."""
    has_image: np.ndarray
    """bool: VP's newest tick had an image; without one, it goes on from memory."""
    map_error: np.ndarray
    """Error of VP's height map ahead that VP itself predicts, m."""
    unseen: np.ndarray
    """bool: the command leads to ground that the robot has not seen."""
    failing: np.ndarray
    """bool: the camera is failing."""
    trusted: np.ndarray
    """[T, U, N] bool: the selector's answer after each of its U updates of a step."""
    film: Film | None = field(default=None, repr=False)

    @property
    def sees(self) -> np.ndarray:
        """[T, U, N] bool: VP drove, and its newest tick had an image."""
        return self.trusted & self.has_image[:, None]

    @classmethod
    def empty(cls, steps: int, count: int) -> Trace:
        """Room for `steps` control steps of `count` robots."""
        flags = ("fell", "ended", "vision", "has_image", "unseen", "failing")
        arrays: dict[str, Any] = {}
        for field_ in fields(cls):
            name = field_.name
            if name not in ("trusted", "film"):
                arrays[name] = np.zeros((steps, count), bool if name in flags else float)
        return cls(**arrays, trusted=np.ones((steps, UPDATES_PER_STEP, count), bool))

    def until(self, steps: int) -> Trace:
        """The first control steps, without film."""
        return self._part(np.s_[:steps])

    def robots(self, index: slice | np.ndarray) -> Trace:
        """Some robots, by their places or a mask [N], without film."""
        return self._part(np.s_[..., index])

    def _part(self, index: Any) -> Trace:
        """A part of every array by its index, without film."""
        arrays = dict(vars(self))
        # A film has other robots and steps than the arrays.
        del arrays["film"]
        return Trace(**{name: array[index] for name, array in arrays.items()})

    def groups(self, each: int) -> list[Trace]:
        """Traces of the robots in their order, `each` in a group."""
        # A last group may be smaller.
        starts = range(0, self.fell.shape[1], each)
        return [self.robots(slice(start, start + each)) for start in starts]

    def first_try(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """End of each robot's first try.

        Returns:
            [N] bool, the robot crossed: the episode ended, and not by a fall;
            [N] bool, it fell; [N] s, the time it took, NaN if the try did not end.
        """
        # The first step in which the episode ended; step 0 where it never did.
        first = self.ended.argmax(axis=0)
        robot = np.arange(self.ended.shape[1])
        ended = self.ended[first, robot]
        fell = self.fell[first, robot]
        return ended & ~fell, ended & fell, np.where(ended, (first + 1) * CONTROL_DT, np.nan)

    @property
    def over(self) -> np.ndarray:
        """[T, N] bool: the first try ended in this or an earlier step."""
        return np.logical_or.accumulate(self.ended, axis=0)

    @property
    def trying(self) -> np.ndarray:
        """[T, N] bool: the first try goes on in this step, or ends with it."""
        return ~np.vstack([np.zeros((1, self.ended.shape[1]), bool), self.over[:-1]])

    @property
    def fallen(self) -> np.ndarray:
        """[T, N] bool: the first try is over, by a fall."""
        return self.over & self.first_try()[1]

    @property
    def speed(self) -> np.ndarray:
        """[T, N] m/s along the commanded yaw; zero after a fall."""
        return np.where(self.fallen, 0.0, self.forward_velocity)
