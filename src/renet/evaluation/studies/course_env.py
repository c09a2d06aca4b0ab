"""A lap of the course as an environment of rollouts, and the cameras that fail along it."""

import math
from collections.abc import Sequence

import numpy as np
import torch

from renet.evaluation.env import SimEnv
from renet.evaluation.rollout import StepResult
from renet.evaluation.studies.course_terrain import AHEAD, FAULTS_HERE, along
from renet.faults import FAULTS, Frames, Injector, fault_class
from renet.interface import CONTROL_DT
from renet.tasks.mdp.commands import goal
from renet.terrain.tiles import TILE

LOOK_AHEAD = 3.0
"""The goal yaw points at the course's middle line this far ahead, m, as an operator would steer."""


class CourseEnv:
    """Steers robots along the middle line and sets those that fall or get stuck down after it.

    A robot that has fallen or is stuck goes on at the beginning of the next passage.
    """

    def __init__(self, env: SimEnv, lap: Sequence[str]) -> None:
        """Take over `env`, built from `course_env_cfg`."""
        self._inner, self._env = env, env.env
        self.num_robots = env.num_robots
        self.poses, self.perturb_cameras = env.poses, env.perturb_cameras
        self.lap = tuple(lap)
        self.passage = np.zeros(self.num_robots, int)
        """The passage each robot is on, [N]."""
        self.finished = np.zeros(self.num_robots, bool)
        """[N]: at the end of the course; what happens afterwards does not count."""
        self.log: dict[str, list[np.ndarray]] = {}

    def reset(self) -> StepResult:
        """Put every robot at the beginning of the course."""
        nowhere = np.zeros(self.num_robots, int)
        self._inner.place(nowhere, nowhere)
        self.passage[:], self.finished[:] = 0, False
        self.log = {name: [] for name in ("passage", "metres", "fell", "stuck", "finished")}
        result = self._inner.reset()
        self._steer()
        return result

    def step(self, action: np.ndarray) -> StepResult:
        """Act [N, 12] for one control step."""
        last = len(self.lap) - 1
        before, metres, over = self.passage.copy(), self._metres(), self.finished.copy()
        following = np.minimum(self.passage + 1, last)
        self._inner.place(np.zeros_like(following), following)
        result = self._inner.step(action)
        stuck = self._env.termination_manager.get_term("stuck").numpy() & ~result.fell
        failed = result.fell | stuck
        end = result.ended & ~failed
        self.finished |= end | (failed & (before == last))
        reached = np.floor(self._metres() / TILE).astype(int)
        walked = np.maximum(before, np.clip(reached, 0, last))
        self.passage = np.where(result.ended, following, walked)
        gone = np.where(result.ended, 0.0, self._metres() - metres)
        for name, value in (
            ("passage", before),
            ("metres", gone),
            ("fell", result.fell & ~over),
            ("stuck", stuck & ~over),
            ("finished", over),
        ):
            self.log[name].append(value)
        self._steer()
        return result

    def logged(self, name: str) -> np.ndarray:
        """[T, N]: passage, metres gone in the step, fell, stuck, or finished before the step."""
        return np.array(self.log[name])

    def _metres(self) -> np.ndarray:
        """Metres from the beginning of the course, [N]."""
        return along(self._env, course_length(self.lap)).numpy()

    def _steer(self) -> None:
        """Point every goal at the middle line."""
        aside = self._env.scene["robot"].data.root_link_pos_w[:, 0]
        goal(self._env).yaw[:] = AHEAD + torch.atan2(aside, torch.tensor(LOOK_AHEAD))


class PlaceInjector(Injector):
    """Camera faults that are at work where the robot is, not when."""

    def __init__(self, env: CourseEnv, streams: Sequence[int], severity: int, seed: int) -> None:
        """One stream of noise for each robot number; see `Injector`."""
        super().__init__([()] * len(streams), streams, seed)
        self._inner = env
        self._faults = {
            kind: FAULTS[name](
                fault_class(name).level_of(severity),
                [np.random.default_rng([seed, place, stream]) for stream in streams],
            )
            for place, (kind, name) in enumerate(FAULTS_HERE.items())
        }

    def at_work(self, step: int) -> np.ndarray:
        """[N] bool: the robots that are where the camera fails."""
        return self._here(tuple(self._faults))

    def apply(self, frames: Frames, step: int) -> Frames:
        """Spoil the frames of the robots where the camera fails."""
        for kind, fault in self._faults.items():
            elapsed = np.where(self._here((kind,)), step * CONTROL_DT, -1.0)
            frames = fault.corrupt(frames, elapsed)
        return frames

    def _here(self, kinds: Sequence[str]) -> np.ndarray:
        """[N] bool: on a passage of one of the kinds."""
        matches = np.array([kind in kinds for kind in self._inner.lap])
        return matches[self._inner.passage]


def course_length(lap: Sequence[str]) -> float:
    """Metres of a lap."""
    return len(lap) * TILE


def time_limit(lap: Sequence[str], stuck_after: float) -> int:
    """Control steps after which every robot has finished a lap, whatever happens to it."""
    return len(lap) * (math.ceil(stuck_after / CONTROL_DT) + 3)
