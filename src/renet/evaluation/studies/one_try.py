"""Base of studies in which robots have one try at leaving a tile, all settings side by side."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

from renet.errors import RenetError
from renet.evaluation.rollout import EvalEnv, Trial, robot_numbers
from renet.evaluation.study import Part, WalkingStudy
from renet.evaluation.trace import Trace
from renet.interface import CONTROL_DT
from renet.terrain.tiles import LEVELS, Tile, tiles

if TYPE_CHECKING:
    from renet.evaluation.evaluator import Evaluator, Task
    from renet.tasks import RenetEnvCfg

EDGES = {"gap": 1.2, "platform": 1.4, "stairs_up": 1.2, "stairs_down": 1.5}
"""Distance from the middle of a tile, where robots start, to the first edge, m, by kind."""
NEAREST = min(EDGES.values())
"""Shortest of these distances, m."""
_START_YAW = 0.1
"""Largest angle between a robot's start and the yaw that it is to have, rad."""


def start_facing(cfg: RenetEnvCfg, yaw: float = 0.0) -> None:
    """Let robots start at a yaw, give or take 0.1 rad, in place.

    Args:
        cfg: task whose obstacle is straight ahead, along +x.
        yaw: yaw of the start, rad; 0: robots walk straight at the obstacle.
    """
    yaws = (yaw - _START_YAW, yaw + _START_YAW)
    cfg.events["spawn"].params["pose_range"]["yaw"] = yaws


def one_tile_cfg(evaluator: Evaluator, kind: str, tile: Tile) -> RenetEnvCfg:
    """Task on a single tile of a kind, in the evaluator's conditions."""
    # It loads PyTorch and mjlab, which take seconds.
    from renet.tasks.terrains import EVALUATION_SEED, parkour_terrain

    return evaluator.terrain_env_cfg(parkour_terrain(EVALUATION_SEED, {kind: tile}, levels=1))


@dataclass(frozen=True)
class OneTryStudy(WalkingStudy):
    """Base of studies whose robots walk until they have left their tile or fallen."""

    seconds: float = 12.0
    """Time to leave the tile, s."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.seconds < 1:
            raise RenetError(f"seconds must be at least 1, got {self.seconds}")

    def walk(
        self,
        evaluator: Evaluator,
        task: Task,
        trials: Sequence[Trial],
        title: str,
        until_ended: int = 1,
        retire: bool = True,
        view: Callable[[EvalEnv], Any] = lambda env: env,
    ) -> Trace:
        """Run trials, each on its ground.

        Args:
            evaluator: evaluator of the policy.
            task: task with the trials' grounds, see `Evaluator.make_env`.
            trials: one for each robot.
            title: title of the progress.
            until_ended: number of control steps after which the run ends as soon as all first tries
                are over.
            retire: True to stop simulating robots whose first try is over.
            view: wraps the environment, to show robots other images.
        """
        # Robots with the same number are twins.
        env = evaluator.make_env(task, robot_numbers(trials), self.speed, self.seed)
        env.place_on([trial.ground for trial in trials])
        rollout = evaluator.rollout(view(env), trials, self.seed)
        steps = round(self.seconds / CONTROL_DT)
        return rollout.run(steps, title, until_ended=until_ended, retire=retire)


@dataclass(frozen=True)
class LevelStudy(OneTryStudy):
    """Base of studies of grounds that are named with their level."""

    grounds: tuple[str, ...] = ()
    """Ground and level, KIND:LEVEL, such as gap:3; levels are 1 to 10."""

    selectable: ClassVar[tuple[str, ...]] = ("grounds",)
    kinds: ClassVar[tuple[str, ...]] = tuple(tiles())

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.grounds:
            raise RenetError("give a ground")
        for ground in self.grounds:
            kind, _, level = ground.partition(":")
            if kind not in self.kinds or not level.isdecimal() or not 1 <= int(level) <= LEVELS:
                raise RenetError(
                    f"ground {ground!r}: write KIND:LEVEL, of {', '.join(self.kinds)} and 1 to"
                    f" {LEVELS}, such as gap:3"
                )

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """One part for each ground."""
        parts = {}
        for number, ground in enumerate(self.grounds, start=1):
            kind, level = ground.split(":")
            title = f"{number}/{len(self.grounds)} {ground}"
            walk = partial(self.walk_on, evaluator, kind, int(level), title)
            # The name is part of a file name, which has no colon on some systems.
            parts[ground.replace(":", "_")] = walk
        return parts

    def walk_on(self, evaluator: Evaluator, kind: str, level: int, title: str) -> Part:
        """Walk on one ground and return its part, with a title for the progress."""
        raise NotImplementedError

    def by_ground(self, parts: Mapping[str, Part]) -> dict[str, Part]:
        """Part of each ground, by the ground as it is written in the settings."""
        return {ground: parts[ground.replace(":", "_")] for ground in self.grounds}
