"""The memory study's preset `reach`: how far memory reaches, and what happens beyond.

The camera dies at some distance before a gap. Nearer ones are remembered; farther ones were never
seen, or are forgotten. A second scene has two gaps in a row, the second of which nobody has seen
when the camera dies. At the end of the ground that it has seen a robot walks on, slows down or
stops.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, cast

import matplotlib.pyplot as plt
import numpy as np

from renet.errors import RenetError, demand_name
from renet.evaluation import figures, metrics
from renet.evaluation.results import grouped
from renet.evaluation.rollout import Trial
from renet.evaluation.studies.memory import DEAD
from renet.evaluation.study import Figures, Part, Table, WalkingStudy
from renet.evaluation.trace import Trace
from renet.faults import Injection
from renet.interface import CONTROL_DT, Unseen
from renet.pilot.reach import UNSEEN
from renet.terrain.tiles import TILE, GapTile, Tile

if TYPE_CHECKING:
    from renet.evaluation.evaluator import Evaluator

COLOURS = {"healthy": "#1b9e77", "walk": "#d95f02", "slow": "#7570b3", "stop": "#1f78b4"}
"""Of a healthy camera, and of each conduct after its death."""
RUN_UP = 0.5
"""Walk with a healthy camera before it dies, m."""
PAIR_AT = 0.8
"""Distance before the first of two gaps at which the camera dies, m."""
LAST_GROUND = 0.3
"""Least width of the ground beyond the last gap, m."""


@dataclass(frozen=True)
class ReachStudy(WalkingStudy):
    """Which gaps robots cross whose cameras die at a distance, and where they stop."""

    out: Path = Path("results/reach")
    """Folder for summary.json, summary.csv, reach.png and parts/."""
    gap: float = 0.37
    """Width of the single gap, m."""
    metres: tuple[float, ...] = (0.4, 0.8, 1.1, 1.35, 1.6, 2.0)
    """Distances before the gap's edge at which the camera dies, m."""
    pair: float = 0.57
    """Width of each of two gaps in a row, m; the camera dies 0.8 m before the first."""
    between: float = 1.2
    """Ground between the two, m."""
    unseen: tuple[Unseen, ...] = UNSEEN
    """What robots do at the end of the ground that they have seen."""
    robots: int = 40
    """Robots in each setting; with `quick` always fewer."""
    seconds: float = 12.0
    """Time to leave the tile."""

    name: ClassVar[str] = "reach"
    quick_robots: ClassVar[int] = 6

    def __post_init__(self) -> None:
        super().__post_init__()
        for conduct in self.unseen:
            demand_name("unseen", conduct, UNSEEN)
        if not self.unseen or not self.metres:
            raise RenetError("give at least one distance in metres and one conduct in unseen")
        if not all(metres > 0.0 for metres in self.metres):
            raise RenetError(f"metres {self.metres}: give distances above 0 m")
        for gap in (single_gap(self.gap, max(self.metres)), self.two_gaps):
            outer = gap.island + gap.high
            if gap.ground is not None:
                outer += gap.ground + gap.high
            if gap.high <= 0.0 or outer + LAST_GROUND > TILE / 2:
                raise RenetError(
                    f"gaps of {gap.high:g} m and the way to them do not fit into {TILE / 2:g} m"
                )

    @property
    def two_gaps(self) -> GapTile:
        """The tile of two gaps in a row."""
        gap = single_gap(self.pair, PAIR_AT)
        return replace(gap, ground=self.between, landing=LAST_GROUND)

    @property
    def onset(self) -> int:
        """Control step at which the camera dies, if robots walk as fast as they are told."""
        return round(RUN_UP / self.speed / CONTROL_DT)

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """One batch for each distance, and one for the two gaps."""
        scenes = {
            f"gap_{metres:g}": (single_gap(self.gap, metres), metres) for metres in self.metres
        }
        scenes["two_gaps"] = (self.two_gaps, PAIR_AT)
        return {
            name: partial(self._walk, evaluator, name, gap, metres)
            for name, (gap, metres) in scenes.items()
        }

    def _walk(self, evaluator: Evaluator, name: str, gap: GapTile, metres: float) -> Part:
        """Walk with each conduct at one scene, and with a healthy camera."""
        from renet.tasks.parkour_env_cfg import tile_env_cfg
        from renet.tasks.terrains import EVALUATION_SEED, parkour_terrain

        kinds: dict[str, Tile] = {"gap": gap}
        terrain = parkour_terrain(EVALUATION_SEED, kinds, levels=1)
        cfg = tile_env_cfg(terrain, play=True, robot=evaluator.robot)
        evaluator.set_conditions(cfg)
        each = self.robots_each
        dead = (Injection.of(*DEAD, self.onset, self.seconds),)
        # One group with a healthy camera, which no conduct changes, and one for each conduct.
        labels = ["healthy", *self.unseen]
        trials = []
        conducts: list[Unseen] = []
        for label in labels:
            healthy = label == "healthy"
            for robot in range(each):
                trials.append(Trial("memory", () if healthy else dead, robot))
                conducts.append("walk" if healthy else cast(Unseen, label))
        env = evaluator.make_env(cfg, [trial.robot for trial in trials], self.speed, self.seed)
        rollout = evaluator.rollout(env, trials, self.seed, conducts)
        trace = rollout.run(round(self.seconds / CONTROL_DT), name, retire=True)
        scene = {
            "scene": "two gaps" if name == "two_gaps" else "gap",
            "gap_m": gap.high,
            "metres": metres,
        }
        groups = zip(labels, trace.groups(each), strict=True)
        runs = [scene | {"unseen": label} | self._row(group, gap) for label, group in groups]
        return {"runs": runs}

    def _row(self, trace: Trace, gap: GapTile) -> dict[str, Any]:
        """Ends of the first tries of one group of robots."""
        crossed, fell, _ = trace.first_try()
        from_edge = gap.island - trace.travelled[self.onset]
        return {
            "measured_m": float(from_edge.mean()),
            "robots": len(crossed),
            "crossed": int(crossed.sum()),
            "fell": int(fell.sum()),
            "stood": int((~crossed & ~fell).sum()),
            "crossed_rate": float(crossed.mean()),
            "fell_rate": float(fell.mean()),
            **metrics.with_share_interval("crossed", crossed),
            **metrics.with_share_interval("fell", fell),
            "seed": self.seed,
        }

    def summarise(self, parts: Mapping[str, Part], evaluator: Evaluator) -> dict[str, Any]:
        """The rows."""
        return {"runs": [run for part in parts.values() for run in part["runs"]]}

    def draw(self, summary: dict[str, Any], parts: Mapping[str, Part]) -> Figures:
        """reach.png: what crosses, and what falls, against the distance at which cameras die."""
        figure, axes = plt.subplots(1, 2, figsize=(7.6, 3.0), sharey=True, squeeze=False)
        single = [run for run in summary["runs"] if run["scene"] == "gap"]
        for axis, share in zip(axes[0], ("crossed", "fell"), strict=True):
            for number, ((conduct,), runs) in enumerate(grouped(single, "unseen").items()):
                # Side by side, or equal shares would hide each other.
                x = [run["measured_m"] + 0.012 * number for run in runs]
                rate = np.array([100 * run[f"{share}_rate"] for run in runs])
                low = np.array([100 * run[f"{share}_ci95_low"] for run in runs])
                high = np.array([100 * run[f"{share}_ci95_high"] for run in runs])
                interval = np.stack((rate - low, high - rate)).clip(min=0.0)
                axis.errorbar(
                    x, rate, interval, fmt="o-", color=COLOURS[conduct], label=conduct, markersize=4
                )
            axis.set_title(f"{share}, gap of {100 * self.gap:.0f} cm", fontsize=9)
            axis.set_xlabel("metres from the camera's death to the edge")
        axes[0][0].set_ylabel("robots (%)")
        axes[0][0].set_ylim(-4, 104)
        figures.legend(figure, axes[0][0])
        return {"reach.png": figure}

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Counts by scene, distance and conduct."""
        header = ("scene", "dead at (m)", "at the end", "crossed", "fell", "stood")
        rows = []
        for run in summary["runs"]:
            at = f"{run['measured_m']:.2f}"
            counts = (run["crossed"], run["fell"], run["stood"])
            rows.append((run["scene"], at, run["unseen"], *counts))
        return [(f"Cameras that die before a gap, {self.robots_each} robots each", header, rows)]


def single_gap(width: float, metres: float) -> GapTile:
    """A tile with one gap whose edge is `metres` beyond the run-up, m."""
    return GapTile(low=width, high=width, island=RUN_UP + metres)
