"""The standing study: whether robots that are told to stop do, and stand still."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from renet.evaluation.rollout import FLAT, Mode
from renet.evaluation.studies.terrain import TerrainStudy
from renet.evaluation.study import Figures, Part, Table
from renet.interface import CONTROL_DT, Terrain
from renet.terrain.tiles import tiles

if TYPE_CHECKING:
    from renet.evaluation.evaluator import Evaluator

WALK, SETTLE = 3.0, 1.5
"""Seconds before the command to stand, and seconds that a robot then has for stopping."""
DRIFT, MOVING = 0.1, 0.2
"""A robot stands still if it drifts less than this, m, with joints slower than this on average,
rad/s, once it has had time to stop."""


@dataclass(frozen=True)
class StandingStudy(TerrainStudy):
    """Whether a robot that is commanded to stand after 3 s does, and stands still.

    The paper's second level of commands (Method C) asks for it on uneven ground, where goal-guided
    rewards otherwise leave a robot stepping on the spot.
    """

    out: Path = Path("results/standing")
    """Folder for summary.md, summary.json, summary.csv and parts/."""
    kinds: tuple[Terrain, ...] = (FLAT, "rough", "obstacles", "stairs_up", "stairs_down")
    """Ground to stop on."""
    levels: tuple[int, ...] = (3,)
    """Levels of the ground, 1 to 10."""
    modes: tuple[Mode, ...] = ("camera", "blind")
    seconds: float = 6.0
    """Time that a robot must stand, from 1.5 s after the command on."""

    name: ClassVar[str] = "standing"
    selectable: ClassVar[tuple[str, ...]] = ()
    grounds: ClassVar[tuple[str, ...]] = (FLAT, *tiles())
    twins: ClassVar[bool] = True
    quick_levels: ClassVar[tuple[int, ...]] = (3,)
    quick_robots: ClassVar[int] = 5

    @property
    def groups(self) -> list[tuple[str, int, str]]:
        """Kind, level and mode of each group of robots; flat ground has one level."""
        return [
            (kind, 1 if kind == FLAT else level, mode)
            for kind in self.kinds
            for level, mode in self.settings
            if kind != FLAT or level == self.levels[0]
        ]

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """All robots of every ground and mode, side by side."""
        return {"runs": partial(self._stand, evaluator)}

    def _stand(self, evaluator: Evaluator) -> Part:
        env, trials = self.robots_on(partial(self._make_env, evaluator), self.groups)
        seconds = np.cumsum((WALK, SETTLE, self.seconds))
        stop, settled, steps = np.round(seconds / CONTROL_DT).astype(int)

        def command_to_stand(step: int) -> None:
            if step + 1 == stop:
                env.command(0.0)

        rollout, title = evaluator.rollout(env, trials, self.seed), f"{len(trials)} robots stop"
        trace = rollout.run(steps, title, film=range(len(trials)), on_step=command_to_stand)
        assert trace.film is not None
        drift, joint_speed = stillness(trace.film.poses, settled)
        # One that fell or left its tile starts anew elsewhere, which is not standing.
        fell, gone = (np.any(flags[stop:], axis=0) for flags in (trace.fell, trace.ended))
        still = ~gone & (drift < DRIFT) & (joint_speed.mean(axis=0) < MOVING)
        runs = []
        numbers = np.arange(len(trials)).reshape(len(self.groups), -1)
        for group, robots in zip(self.groups, numbers, strict=True):
            stayed = robots[~gone[robots]]
            runs.append(
                dict(zip(("kind", "level", "mode"), group, strict=True))
                | {
                    "robots": len(robots),
                    "still": int(still[robots].sum()),
                    "falls": int(fell[robots].sum()),
                    "drift_m": np.median(drift[stayed]) if stayed.size else None,
                    "joint_speed_rad_per_s": joint_speed[:, stayed].mean() if stayed.size else None,
                    "seed": self.seed,
                }
            )
        return {"runs": runs}

    def summarise(self, parts: Mapping[str, Part], evaluator: Evaluator) -> dict[str, Any]:
        """The rows, and the criteria of standing still."""
        return {"runs": parts["runs"]["runs"], "drift_m": DRIFT, "moving_rad_per_s": MOVING}

    def draw(self, summary: dict[str, Any], parts: Mapping[str, Part]) -> Figures:
        """No figures: the table says it all."""
        return {}

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """The rows."""
        header = tuple(name for name in summary["runs"][0] if name != "seed")
        rows = [
            tuple(f"{run[n]:.3f}" if isinstance(run[n], float) else run[n] for n in header)
            for run in summary["runs"]
        ]
        return [("Commanded to stand", header, rows)]


def stillness(poses: np.ndarray, settled: int) -> tuple[np.ndarray, np.ndarray]:
    """How far and how fast robots that should stand move.

    Args:
        poses: [T, N, 7 + joints] generalised positions at each control step.
        settled: the control step from which on they should stand, 1 or later.

    Returns:
        Horizontal distance from where each was at `settled` to its last place, [N] m; mean speed of
        its joints from then on, [T - settled, N] rad/s.
    """
    drift = np.linalg.norm(poses[-1, :, :2] - poses[settled, :, :2], axis=-1)
    speed = np.abs(np.diff(poses[settled - 1 :, :, 7:], axis=0)).mean(axis=-1) / CONTROL_DT
    return drift, speed
