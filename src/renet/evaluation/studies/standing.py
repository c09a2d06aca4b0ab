"""The standing study: robots that are commanded to stop must stand still."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from renet.evaluation.settings import FLAT_GROUND, StudyMode
from renet.evaluation.studies.terrain import TerrainStudy
from renet.evaluation.study import Figures, Part, Table
from renet.interface import CONTROL_DT, Terrain, control_steps
from renet.terrain.tiles import tiles

if TYPE_CHECKING:
    from renet.evaluation.evaluator import Evaluator

_WALK_TIME = 3.0
"""Time before the command to stand, s."""
_STOP_TIME = 1.5
"""Time that a robot has to stop after the command, s."""
_LARGEST_DRIFT = 0.1
"""Distance below which a robot stands still, m."""
_LARGEST_JOINT_SPEED = 0.2
"""Mean joint speed below which a robot stands still, rad/s."""


@dataclass(frozen=True)
class StandingStudy(TerrainStudy):
    """Command robots to stand after 3 s, and count those that stand still.

    The paper's second level of commands (Method C) demands it on uneven ground, where goal-guided
    rewards alone leave a robot stepping on the spot.
    """

    out: Path = Path("results/standing")
    """Folder for summary.md, summary.json, summary.csv and parts/."""
    kinds: tuple[Terrain, ...] = (FLAT_GROUND, "rough", "obstacles", "stairs_up", "stairs_down")
    """Ground to stop on."""
    levels: tuple[int, ...] = (3,)
    """Levels of the ground, 1 to 10."""
    modes: tuple[StudyMode, ...] = ("camera", "blind")
    seconds: float = 6.0
    """Time that a robot must stand, s, counted from 1.5 s after the command."""

    name: ClassVar[str] = "standing"
    selectable: ClassVar[tuple[str, ...]] = ()
    grounds: ClassVar[tuple[str, ...]] = (FLAT_GROUND, *tiles())
    twins: ClassVar[bool] = True
    quick_levels: ClassVar[tuple[int, ...]] = (3,)
    quick_robots: ClassVar[int] = 5

    @property
    def groups(self) -> list[tuple[str, int, str]]:
        """Kind, level and mode of each group of robots; flat ground has one level."""
        groups = []
        for kind in self.kinds:
            for level, mode in self.settings:
                if kind != FLAT_GROUND:
                    groups.append((kind, level, mode))
                elif level == self.walked_levels[0]:
                    groups.append((kind, 1, mode))
        return groups

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """Return one part: all robots of every ground and mode, side by side."""
        return {"runs": partial(self._stand, evaluator)}

    def _stand(self, evaluator: Evaluator) -> Part:
        """Walk, command robots to stand, and measure how still they stand."""
        env, trials = self.robots_on(partial(self._make_env, evaluator), self.groups)
        # Control steps of the command and of the end of stopping.
        stop = control_steps(_WALK_TIME)
        settled = stop + control_steps(_STOP_TIME)

        def command_to_stand(step: int) -> None:
            if step + 1 == stop:
                env.command(0.0)

        rollout = evaluator.rollout(env, trials, self.seed)
        title = f"{len(trials)} robots stop"
        film = range(len(trials))
        trace = rollout.run(settled + self.steps, title, film=film, on_step=command_to_stand)
        assert trace.film is not None
        drift, joint_speed = stillness(trace.film.poses, settled)
        # A robot that fell or left its tile is put back at its start, which is not standing.
        fell = np.any(trace.fell[stop:], axis=0)
        gone = np.any(trace.ended[stop:], axis=0)
        slow = joint_speed.mean(axis=0) < _LARGEST_JOINT_SPEED
        still = ~gone & (drift < _LARGEST_DRIFT) & slow
        runs = []
        numbers = np.arange(len(trials)).reshape(len(self.groups), -1)
        for (kind, level, mode), robots in zip(self.groups, numbers, strict=True):
            stayed = robots[~gone[robots]]
            run = {
                "kind": kind,
                "level": level,
                "mode": mode,
                "robots": len(robots),
                "still": int(still[robots].sum()),
                "falls": int(fell[robots].sum()),
                "drift_m": np.median(drift[stayed]) if stayed.size else None,
                "joint_speed_rad_per_s": joint_speed[:, stayed].mean() if stayed.size else None,
                "seed": self.seed,
            }
            runs.append(run)
        return {"runs": runs}

    def summarise(self, parts: Mapping[str, Part], evaluator: Evaluator) -> dict[str, Any]:
        """Return the rows."""
        return {"runs": parts["runs"]["runs"]}

    def draw(self, summary: dict[str, Any], parts: Mapping[str, Part]) -> Figures:
        """Draw nothing."""
        return {}

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Tabulate the rows."""
        header = tuple(name for name in summary["runs"][0] if name != "seed")
        rows = []
        for run in summary["runs"]:
            row = []
            for name in header:
                value = run[name]
                row.append(f"{value:.3f}" if isinstance(value, float) else value)
            rows.append(tuple(row))
        return [("Commanded to stand", header, rows)]


def stillness(poses: np.ndarray, settled: int) -> tuple[np.ndarray, np.ndarray]:
    """Measure drift and joint speed of robots that should stand.

    Args:
        poses: Generalised positions at each control step, [T, N, 7 + joints].
        settled: Control step from which on they should stand, 1 or later.

    Returns:
        Horizontal distance from the position at `settled` to the last one, [N] m; mean speed of the
        joints from then on, [T - settled, N] rad/s.
    """
    # The first seven positions are the base's.
    drift = np.linalg.norm(poses[-1, :, :2] - poses[settled, :, :2], axis=-1)
    speed = np.abs(np.diff(poses[settled - 1 :, :, 7:], axis=0)).mean(axis=-1) / CONTROL_DT
    return drift, speed
