"""Studies of robots that have one try at leaving a tile, all settings of a ground side by side."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

from renet.errors import RenetError
from renet.evaluation.rollout import EvalEnv, Trial
from renet.evaluation.study import Part, WalkingStudy
from renet.evaluation.trace import Trace
from renet.interface import CONTROL_DT
from renet.terrain.tiles import LEVELS, tiles

if TYPE_CHECKING:
    from renet.evaluation.evaluator import Evaluator, Task

EDGES = {"gap": 1.2, "platform": 1.4, "stairs_up": 1.2, "stairs_down": 1.5}
"""m from the middle of a tile, where robots start, to the first edge."""
NEAREST = min(EDGES.values())
AIM = 0.1
"""Robots with one try start within this angle of straight at the obstacle, rad."""


@dataclass(frozen=True)
class OneTryStudy(WalkingStudy):
    """Robots that walk until they have left their tile or fallen."""

    seconds: float = 12.0
    """Time to leave the tile."""

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
            evaluator: of the policy. task: with the trials' grounds, see `Evaluator.make_env`.
            trials: one for each robot. title: of the progress bar.
            until_ended: control steps after which the run ends once all first tries are over.
            retire: whether robots are simulated no more from then on.
            view: wraps the environment, where robots are shown other images.
        """
        env = evaluator.make_env(task, [trial.robot for trial in trials], self.speed, self.seed)
        env.place_on([trial.ground for trial in trials])
        rollout = evaluator.rollout(view(env), trials, self.seed)
        steps = round(self.seconds / CONTROL_DT)
        return rollout.run(steps, title, until_ended=until_ended, retire=retire)


@dataclass(frozen=True)
class LevelStudy(OneTryStudy):
    """Grounds that are named with their level."""

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
        count = len(self.grounds)
        return {
            ground.replace(":", "_"): partial(
                self.walk_on, evaluator, kind, int(level), f"{number}/{count} {ground}"
            )
            for number, ground in enumerate(self.grounds, start=1)
            for kind, level in [ground.split(":")]
        }

    def walk_on(self, evaluator: Evaluator, kind: str, level: int, title: str) -> Part:
        """The part of one ground; the title is its progress bar's."""
        raise NotImplementedError

    def by_ground(self, parts: Mapping[str, Part]) -> dict[str, Part]:
        """Each ground's part."""
        return {ground: parts[ground.replace(":", "_")] for ground in self.grounds}
