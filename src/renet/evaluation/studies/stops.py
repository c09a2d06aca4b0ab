"""The stops study: robots must stop before walls and ledges that they cannot cross.

A robot is commanded to walk at a wall, or over an edge, straight or at an angle, until the end. It
succeeds if it has not fallen by then.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from renet.errors import RenetError
from renet.evaluation import metrics
from renet.evaluation.results import as_text
from renet.evaluation.rollout import robot_numbers
from renet.evaluation.settings import StudyMode, check_names
from renet.evaluation.studies.grounds import one_tile_cfg, start_facing
from renet.evaluation.study import Part, Table, WalkingStudy
from renet.terrain.tiles import BARRIERS, barriers

if TYPE_CHECKING:
    from renet.evaluation.evaluator import Evaluator


@dataclass(frozen=True)
class StopsStudy(WalkingStudy):
    """Command robots to walk at walls and over ledges, and count those that stop."""

    out: Path = Path("results/stops")
    """Folder for summary.md, summary.json, summary.csv and parts/."""
    kinds: tuple[Literal["wall", "ledge"], ...] = ("wall", "ledge")
    """Kinds of barrier."""
    height: float = 1.0
    """Height of the wall, and depth of the drop, m."""
    angles: tuple[float, ...] = (0.0, 30.0)
    """Angles between the robots' way and straight at the barrier, degrees."""
    modes: tuple[StudyMode, ...] = ("camera",)
    robots: int = 50
    """Number of robots for each kind, angle and mode; with `quick` a few at most."""
    seconds: float = 10.0
    """Length of each run, s; the barrier is 1.6 m from the start."""

    name: ClassVar[str] = "stops"
    quick_robots: ClassVar[int] = 6

    def __post_init__(self) -> None:
        super().__post_init__()
        check_names("kinds", self.kinds, BARRIERS)
        if not self.height > 0.0:
            raise RenetError(f"height must be positive, got {self.height} m")

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """Return one batch for each kind and angle."""
        parts = {}
        for kind, angle in product(self.kinds, self.angles):
            parts[f"{kind}_{angle:g}"] = partial(self._approach, evaluator, kind, angle)
        return parts

    def _approach(self, evaluator: Evaluator, kind: str, angle: float) -> Part:
        """Walk all robots and modes at one kind of barrier, from one direction."""
        tile = replace(barriers()[kind], low=self.height, high=self.height)
        cfg = one_tile_cfg(evaluator, kind, tile)
        start_facing(cfg, math.radians(angle))
        trials = self.trials_on((kind,))
        env = evaluator.make_env(cfg, robot_numbers(trials), self.speed, self.seed)
        trace = self.walk(evaluator, env, trials, f"{kind}, {angle:g} degrees")
        runs = []
        for mode, group in zip(self.modes, trace.groups(self.robots_each), strict=True):
            # A robot that does not stop falls or leaves the tile, which ends its episode.
            stopped = ~np.any(group.ended, axis=0)
            walked = group.travelled[-1][stopped]
            run = {
                "kind": kind,
                "angle_deg": angle,
                "height_m": self.height,
                "mode": mode,
                "robots": len(stopped),
                "falls": int((~stopped).sum()),
                **metrics.share_columns("success", stopped),
                "walked_m": float(np.median(walked)) if walked.size else None,
                "seed": self.seed,
            }
            runs.append(run)
        return {"runs": runs}

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Tabulate the rows."""
        header = ("barrier", "angle (degrees)", "mode", "fell", "walked (m)")
        rows = []
        for run in summary["runs"]:
            walked = as_text(run["walked_m"], ".2f")
            falls = f"{run['falls']} of {run['robots']}"
            rows.append((run["kind"], f"{run['angle_deg']:g}", run["mode"], falls, walked))
        return [(f"Commanded to go on, {self.height:g} m high or deep", header, rows)]
