"""What happened in a closed-loop run, step by step."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from renet.interface import CONTROL_DT, PHYSICS_DT

UPDATES_PER_STEP = round(CONTROL_DT / PHYSICS_DT)
"""Selector updates in one control step."""


@dataclass
class Film:
    """What pictures of a few rows need."""

    poses: np.ndarray
    """[T, R, nq]"""
    images: np.ndarray
    """[ticks, R, 48, 64] uint8: the depth image each robot got at each tick."""
    maps: np.ndarray
    """[ticks, R, 132] m: VP's height map after each tick; empty for policies that have none."""


@dataclass(frozen=True)
class TrueState:
    """What only a simulator knows of its robots: [N] after a control step, [T, N] in a run."""

    forward_velocity: np.ndarray
    """Base velocity along the commanded yaw, m/s."""
    height: np.ndarray
    """Height of the base above the ground it started on, m."""
    travelled: np.ndarray
    """Horizontal distance from where the robot last started, m."""
    collisions: np.ndarray
    """Thighs, calves and trunks that touch something."""
    power: np.ndarray
    """W, sum of |torque * joint velocity|."""
    fell: np.ndarray
    """bool: the episode ended in this step by a fall, judged by the true pose."""
    ended: np.ndarray
    """bool: the episode ended in this step, by a fall, its time or its tile's edge. The robot is at
    its next start, whose velocity this step has."""


@dataclass(frozen=True)
class StepResult(TrueState):
    """What N robots sense and truly do after a control step."""

    proprioception: np.ndarray
    """[N, 45]"""
    depth: np.ndarray
    """[N, 48, 64] normalised, held between the camera's ticks."""
    angular_velocity: np.ndarray
    """[N, 3] true base rate, rad/s, base frame."""


@dataclass(frozen=True)
class Trace(TrueState):
    """What happened, for each control step and robot; [T, N] unless said otherwise.

    A robot that falls or leaves its tile starts anew and goes on; `over`, `fallen`, `speed` and
    `first_try` are for studies in which only the first try counts.
    """

    anomaly: np.ndarray
    """The policy's anomaly score."""
    probability: np.ndarray
    """Vision probability P_t at the end of the step."""
    vision: np.ndarray
    """bool: the VP estimator's latent drove this step."""
    has_image: np.ndarray
    """bool: VP's newest tick had an image; without, it goes on from memory."""
    map_error: np.ndarray
    """Error of its height map ahead that VP expects, m."""
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
        flags = ("fell", "ended", "vision", "has_image", "failing")
        names = {f.name for f in fields(cls)} - {"trusted", "film"}
        room: Any = {n: np.zeros((steps, count), bool if n in flags else float) for n in names}
        return cls(**room, trusted=np.ones((steps, UPDATES_PER_STEP, count), bool))

    def until(self, steps: int) -> Trace:
        """The first control steps only, without film."""
        return Trace(**{name: array[:steps] for name, array in self._arrays()})

    def robots(self, index: slice | np.ndarray) -> Trace:
        """Some robots only, by their places or a mask [N], without film."""
        return Trace(**{name: array[..., index] for name, array in self._arrays()})

    def _arrays(self) -> list[tuple[str, Any]]:
        return [(name, array) for name, array in vars(self).items() if name != "film"]

    def groups(self, each: int) -> list[Trace]:
        """The robots in their order, `each` in a group."""
        starts = range(0, self.fell.shape[1], each)
        return [self.robots(slice(start, start + each)) for start in starts]

    def first_try(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """How each robot's first try ended: [N] crossed, [N] fell (bool), [N] seconds it took.

        It crosses where the episode ends otherwise than by a fall; NaN seconds: it did not end.
        """
        first = self.ended.argmax(axis=0)
        robot = np.arange(self.ended.shape[1])
        ended, fell = self.ended[first, robot], self.fell[first, robot]
        return ended & ~fell, ended & fell, np.where(ended, (first + 1) * CONTROL_DT, np.nan)

    @property
    def over(self) -> np.ndarray:
        """[T, N] bool: the first try ended in this or an earlier step."""
        return np.logical_or.accumulate(self.ended, axis=0)

    @property
    def fallen(self) -> np.ndarray:
        """[T, N] bool: the first try is over, by a fall."""
        return self.over & self.first_try()[1]

    @property
    def speed(self) -> np.ndarray:
        """[T, N] m/s along the commanded yaw; zero from a robot's fall on."""
        return np.where(self.fallen, 0.0, self.forward_velocity)
