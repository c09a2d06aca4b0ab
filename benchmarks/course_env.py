"""A lap of the course as an environment of rollouts, and the cameras that fail along it.

Grass and an occlusion are faults of the camera for as long as the robot is on that passage.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
from mjlab.envs.mdp.terminations import root_height_below_minimum
from mjlab.managers.termination_manager import TerminationTermCfg
from torch import Tensor

from course_terrain import passage
from renet.evaluation.env import SimEnv
from renet.evaluation.trace import StepResult
from renet.faults import FAULTS, Frames, Injector
from renet.interface import CONTROL_DT
from renet.tasks import RenetEnvCfg, RobotCfg
from renet.tasks.mdp.commands import goal
from renet.tasks.mdp.terminations import PIT_DEPTH
from renet.tasks.parkour_env_cfg import tile_env_cfg
from renet.tasks.terrains import parkour_terrain
from renet.terrain.tiles import TILE

if TYPE_CHECKING:
    from mjlab.envs import ManagerBasedRlEnv

AHEAD = math.pi / 2
"""World yaw of the course, rad."""
LOOK_AHEAD = 3.0
"""The goal yaw points at the course's middle line this far ahead, m, as an operator would steer."""
FAILING = ("grass", "occlusion")
"""Passages on which the camera fails, by the fault of the same name."""


def course_env_cfg(
    lap: Sequence[str], level: int, stuck_after: float, seed: int, robot: RobotCfg
) -> RenetEnvCfg:
    """A lap as an environment.

    Args:
        lap: kinds of passage, in order. level: of all passages, 1 to 10.
        stuck_after: seconds on one passage after which a robot counts as stuck.
        seed: of relief and blocks. robot: to walk it.

    Raises:
        RenetError: unknown kind or level.
    """
    passages = {f"{i}_{kind}": passage(kind, level) for i, kind in enumerate(lap)}
    length = course_length(lap)
    cfg = tile_env_cfg(parkour_terrain(seed, passages, levels=1), play=True, robot=robot)
    cfg.terminations["in_gap"] = TerminationTermCfg(
        func=root_height_below_minimum, params={"minimum_height": -PIT_DEPTH}
    )
    cfg.terminations["left_tile"] = TerminationTermCfg(
        func=arrived, params={"length": length}, time_out=True
    )
    cfg.terminations["stuck"] = TerminationTermCfg(
        func=Stuck, params={"seconds": stuck_after, "length": length}, time_out=True
    )
    around = cfg.events["spawn"].params["pose_range"]
    around["x"], around["y"], around["yaw"] = (-0.3, 0.3), (-0.2, 0.2), (AHEAD - 0.1, AHEAD + 0.1)
    return cfg


def along(env: ManagerBasedRlEnv, length: float) -> Tensor:
    """Metres from the beginning of a course of `length`, [N]; the course is centred."""
    return env.scene["robot"].data.root_link_pos_w[:, 1] + length / 2


def arrived(env: ManagerBasedRlEnv, length: float) -> Tensor:
    """At the end of the course."""
    return along(env, length) > length


class Stuck:
    """Too long on one passage."""

    def __init__(self, cfg: TerminationTermCfg, env: ManagerBasedRlEnv) -> None:
        self._farthest = torch.full((env.num_envs,), -1, device=env.device)
        self._seconds = torch.zeros(env.num_envs, device=env.device)

    def __call__(self, env: ManagerBasedRlEnv, seconds: float, length: float) -> Tensor:
        """[N] bool; call once per control step."""
        now = (along(env, length) / TILE).floor().long()
        self._seconds += env.step_dt
        self._seconds[now > self._farthest] = 0.0
        self._farthest = torch.maximum(self._farthest, now)
        return self._seconds > seconds

    def reset(self, env_ids: Tensor | slice | None = None) -> None:
        """A robot that is set down has all its time."""
        self._farthest[slice(None) if env_ids is None else env_ids] = -1


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
        self.log: list[dict[str, np.ndarray]] = []

    def reset(self) -> StepResult:
        """Put every robot at the beginning of the course."""
        nowhere = np.zeros(self.num_robots, int)
        self._inner.place(nowhere, nowhere)
        self.passage[:], self.finished[:] = 0, False
        self.log = []
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
        self.finished |= result.ended & (~failed | (before == last))
        reached = np.floor(self._metres() / TILE).astype(int)
        walked = np.maximum(before, np.clip(reached, 0, last))
        self.passage = np.where(result.ended, following, walked)
        self.log.append(
            {
                "passage": before,
                "metres": np.where(result.ended, 0.0, self._metres() - metres),
                "fell": result.fell & ~over,
                "stuck": stuck & ~over,
                "finished": over,
            }
        )
        self._steer()
        return result

    def logged(self) -> dict[str, np.ndarray]:
        """[T, N] each: passage, metres gone in the step, fell, stuck, finished before the step."""
        return {name: np.array([row[name] for row in self.log]) for name in self.log[0]}

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
            kind: FAULTS[kind](
                FAULTS[kind].level_of(severity),
                [np.random.default_rng([seed, place, stream]) for stream in streams],
            )
            for place, kind in enumerate(FAILING)
        }

    def at_work(self, step: int) -> np.ndarray:
        """[N] bool: the robots that are where the camera fails."""
        return self._here(FAILING)

    def apply(self, frames: Frames, step: int, spared: np.ndarray | None = None) -> Frames:
        """Spoil the frames of the robots where the camera fails; none retires and is `spared`."""
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
