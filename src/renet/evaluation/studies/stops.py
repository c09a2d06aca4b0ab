"""The stops study: whether robots stop before walls and ledges that nobody can cross.

A robot is told to walk at a wall, or over an edge, straight or at an angle, until the end. It is
right if it has not fallen then.
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
from renet.evaluation.rollout import Mode, Trial
from renet.evaluation.studies.one_try import AIM
from renet.evaluation.study import Figures, Part, Table, WalkingStudy
from renet.interface import CONTROL_DT
from renet.terrain.tiles import BARRIERS, barriers

if TYPE_CHECKING:
    from renet.evaluation.evaluator import Evaluator


@dataclass(frozen=True)
class StopsStudy(WalkingStudy):
    """Whether robots that are told to go on stop before walls and ledges."""

    out: Path = Path("results/stops")
    """Folder for summary.md, summary.json, summary.csv and parts/."""
    kinds: tuple[Literal["wall", "ledge"], ...] = ("wall", "ledge")
    """What stands in the way."""
    height: float = 1.0
    """Of the wall, and depth of the drop, m."""
    angles: tuple[float, ...] = (0.0, 30.0)
    """Directions from which robots come, degrees off straight."""
    modes: tuple[Mode, ...] = ("camera",)
    robots: int = 50
    """Robots for each kind, angle and mode; with `quick` always fewer."""
    seconds: float = 10.0
    """Length of each run; the barrier is 1.6 m from the start."""

    name: ClassVar[str] = "stops"
    quick_robots: ClassVar[int] = 6

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.kinds or not {*self.kinds} <= {*BARRIERS}:
            raise RenetError(f"kinds {self.kinds}: choose among {', '.join(BARRIERS)}")
        if not self.height > 0.0:
            raise RenetError(f"height must be positive, got {self.height} m")

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """One batch for each kind and angle."""
        return {
            f"{kind}_{angle:g}": partial(self._approach, evaluator, kind, angle)
            for kind, angle in product(self.kinds, self.angles)
        }

    def _approach(self, evaluator: Evaluator, kind: str, angle: float) -> Part:
        """All robots and modes at one kind of barrier, from one direction."""
        from renet.tasks.parkour_env_cfg import tile_env_cfg
        from renet.tasks.terrains import EVALUATION_SEED, parkour_terrain

        tile = replace(barriers()[kind], low=self.height, high=self.height)
        terrain = parkour_terrain(EVALUATION_SEED, {kind: tile}, levels=1)
        cfg = tile_env_cfg(terrain, play=True, robot=evaluator.robot)
        turned = math.radians(angle)
        cfg.events["spawn"].params["pose_range"]["yaw"] = (turned - AIM, turned + AIM)
        each = self.robots_each
        trials = [Trial(mode, robot=robot) for mode in self.modes for robot in range(each)]
        env = evaluator.make_env(cfg, [trial.robot for trial in trials], self.speed, self.seed)
        steps = round(self.seconds / CONTROL_DT)
        rollout = evaluator.rollout(env, trials, self.seed)
        trace = rollout.run(steps, f"{kind}, {angle:g} degrees")
        runs = []
        for mode, group in zip(self.modes, trace.groups(each), strict=True):
            stopped = ~np.any(group.ended, axis=0)
            row = {"kind": kind, "angle_deg": angle, "height_m": self.height, "mode": mode}
            row |= {"robots": each, "falls": int((~stopped).sum())}
            row |= {"success_rate": float(stopped.mean())}
            row |= metrics.with_share_interval("success", stopped)
            walked = group.travelled[-1][stopped]
            row["walked_m"] = float(np.median(walked)) if walked.size else None
            runs.append(row | {"seed": self.seed})
        return {"runs": runs}

    def summarise(self, parts: Mapping[str, Part], evaluator: Evaluator) -> dict[str, Any]:
        """The rows."""
        return {"runs": [run for part in parts.values() for run in part["runs"]]}

    def draw(self, summary: dict[str, Any], parts: Mapping[str, Part]) -> Figures:
        """No figures: the table says it all."""
        return {}

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """The rows."""
        header = ("barrier", "angle (degrees)", "mode", "fell", "walked (m)")
        rows = []
        for run in summary["runs"]:
            walked = "-" if run["walked_m"] is None else f"{run['walked_m']:.2f}"
            falls = f"{run['falls']} of {run['robots']}"
            rows.append((run["kind"], f"{run['angle_deg']:g}", run["mode"], falls, walked))
        return [(f"Told to go on, {self.height:g} m high or deep", header, rows)]
