"""The memory study's preset `reach`: distance that memory reaches, and behaviour beyond it.

The camera dies at some distance before a gap. A near gap is remembered; a far one was never seen,
or is forgotten. A second scene has two gaps in a row, the second of which is out of sight when the
camera dies. At the end of the ground that it has seen, a robot walks on, slows down or stops.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import matplotlib.pyplot as plt
import numpy as np
import tyro

from renet.errors import RenetError, demand_name
from renet.evaluation import figures, metrics
from renet.evaluation.results import column, group_by, select
from renet.evaluation.rollout import robot_numbers
from renet.evaluation.settings import StudyMode
from renet.evaluation.studies.grounds import one_tile_cfg, start_facing
from renet.evaluation.studies.memory import DEAD_CAMERA
from renet.evaluation.study import Figures, Part, Table, WalkingStudy
from renet.evaluation.trace import Trace
from renet.faults import Injection
from renet.interface import Unseen, control_steps
from renet.pilot.reach import UNSEEN
from renet.terrain.tiles import TILE, GapTile

if TYPE_CHECKING:
    from renet.evaluation.evaluator import Evaluator

_COLOURS = {"healthy": "#1b9e77", "walk": "#d95f02", "slow": "#7570b3", "stop": "#1f78b4"}
"""Colour of a healthy camera, and of each conduct after the camera's death."""
_RUN_UP = 0.5
"""Distance walked with a healthy camera before it dies, m."""
_PAIR_DISTANCE = 0.8
"""Distance before the first of two gaps at which the camera dies, m."""
_LANDING = 0.3
"""Smallest width of the ground beyond the last gap, m."""


@dataclass(frozen=True)
class ReachStudy(WalkingStudy):
    """Let cameras die at a distance before gaps, and count robots that cross, fall and stop."""

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
    """Conducts at the end of the ground that a robot has seen."""
    # Hidden, because the other modes have no memory to reach anywhere: see `unused`.
    modes: tyro.conf.Suppress[tuple[StudyMode, ...]] = ("memory",)
    robots: int = 40
    """Number of robots in each setting; with `quick` a few at most."""
    seconds: float = 12.0
    """Time to leave the tile, s."""

    name: ClassVar[str] = "reach"
    unused: ClassVar[tuple[str, ...]] = ("modes",)
    quick_robots: ClassVar[int] = 6

    def __post_init__(self) -> None:
        super().__post_init__()
        for conduct in self.unseen:
            demand_name("unseen", conduct, UNSEEN)
        if not self.unseen or not self.metres:
            raise RenetError("give at least one distance in metres and one conduct in unseen")
        if not all(metres > 0.0 for metres in self.metres):
            raise RenetError(f"metres {self.metres}: give distances above 0 m")
        # The widest tiles must fit.
        for gap in (single_gap(self.gap, max(self.metres)), self.two_gaps):
            outer = gap.island + gap.high
            if gap.ground is not None:
                outer += gap.ground + gap.high
            if gap.high <= 0.0 or outer + _LANDING > TILE / 2:
                raise RenetError(
                    f"gaps of {gap.high:g} m and the way to them do not fit into {TILE / 2:g} m"
                )

    @property
    def two_gaps(self) -> GapTile:
        """Tile of two gaps in a row."""
        gap = single_gap(self.pair, _PAIR_DISTANCE)
        return replace(gap, ground=self.between, landing=_LANDING)

    @property
    def onset(self) -> int:
        """Control step at which the camera dies, for robots that walk at the commanded speed."""
        return control_steps(_RUN_UP / self.speed)

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """Return one batch for each distance, and one for the two gaps."""
        parts = {}
        for metres in self.metres:
            name = f"gap_{metres:g}"
            gap = single_gap(self.gap, metres)
            parts[name] = partial(self._walk_tile, evaluator, name, gap, metres)
        pair = partial(self._walk_tile, evaluator, "two_gaps", self.two_gaps, _PAIR_DISTANCE)
        return parts | {"two_gaps": pair}

    def _walk_tile(self, evaluator: Evaluator, name: str, gap: GapTile, metres: float) -> Part:
        """Walk on one tile with each conduct, and with a healthy camera."""
        cfg = one_tile_cfg(evaluator, "gap", gap)
        # From the middle of the tile, so that the distance walked tells where a robot is.
        start_facing(cfg)
        cfg.events["spawn"].params["pose_range"]["x"] = (0.0, 0.0)
        dead = (Injection.of(*DEAD_CAMERA, self.onset, self.seconds),)
        # One group with a healthy camera, whose conduct changes nothing, and one for each conduct.
        trials = self.trial_group("memory")
        for _ in self.unseen:
            trials += self.trial_group("memory", dead)
        groups: tuple[Unseen, ...] = ("walk", *self.unseen)
        conducts: list[Unseen] = [conduct for conduct in groups for _ in range(self.robots_each)]
        env = evaluator.make_env(cfg, robot_numbers(trials), self.speed, self.seed)
        rollout = evaluator.rollout(env, trials, self.seed, conducts)
        trace = rollout.run(self.steps, name, retire=True)
        scene = {
            "scene": "two gaps" if name == "two_gaps" else "gap",
            "gap_m": gap.high,
            "metres": metres,
        }
        runs = []
        labels = ("healthy", *self.unseen)
        for label, group in zip(labels, trace.groups(self.robots_each), strict=True):
            runs.append(scene | {"unseen": label} | self._row(group, gap))
        return {"runs": runs}

    def _row(self, trace: Trace, gap: GapTile) -> dict[str, Any]:
        """Make the row of one group of robots, with the ends of their first tries."""
        crossed, fell, _ = trace.first_try()
        # The camera dies at a time, so robots are not exactly where the settings say.
        from_edge = gap.island - trace.travelled[self.onset]
        last = _last_distance(trace)
        at_second = fell & (last > _second_gap(gap))
        stood = ~crossed & ~fell
        # A robot may leap over the gap that it remembers, and stop at unseen ground behind it.
        behind = ~fell & (last > gap.island + gap.high)
        return {
            "measured_m": float(from_edge.mean()),
            "robots": len(crossed),
            "crossed": int(crossed.sum()),
            "fell": int(fell.sum()),
            "fell_at_second": int(at_second.sum()),
            "stood_before": int((stood & ~behind).sum()),
            "stood_behind": int((stood & behind).sum()),
            **metrics.share_columns("over", crossed | behind),
            **metrics.share_columns("fell", fell),
            "seed": self.seed,
        }

    def draw(self, summary: dict[str, Any], parts: Mapping[str, Part]) -> Figures:
        """Draw reach.png: shares of robots over the gap, and of falls, against the distance."""
        figure, axes = plt.subplots(
            2, 1, figsize=(figures.FIGURE_WIDTH, 5.0), sharex=True, sharey=True
        )
        single = select(summary["runs"], scene="gap")
        for axis, share in zip(axes, ("over", "fell"), strict=True):
            for number, ((conduct,), runs) in enumerate(group_by(single, "unseen").items()):
                # Conducts are side by side, or equal shares would hide each other.
                x = np.array(column(runs, "measured_m")) + 0.012 * number
                look = {"color": _COLOURS[conduct], "label": conduct}
                figures.draw_shares(axis, x, runs, share, **look)
            axis.set_ylabel("robots (%)")
        width = f"{100 * self.gap:.0f} cm"
        axes[0].set_title(f"crossed the gap of {width}, or stopped behind it", fontsize=9)
        axes[1].set_title("fell", fontsize=9)
        axes[0].set_ylim(-4, 104)
        axes[1].set_xlabel("metres from the camera's death to the edge")
        figures.legend(figure, axes[0])
        return {"reach.png": figure}

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Tabulate counts by scene, distance and conduct."""
        header = (
            "scene",
            "dead at (m)",
            "at the end",
            "crossed",
            "fell",
            "at the second",
            "stood before",
            "stood behind",
        )
        rows = []
        for run in summary["runs"]:
            at = f"{run['measured_m']:.2f}"
            counts = ("crossed", "fell", "fell_at_second", "stood_before", "stood_behind")
            rows.append((run["scene"], at, run["unseen"], *(run[name] for name in counts)))
        return [(f"Cameras that die before a gap, {self.robots_each} robots each", header, rows)]


def single_gap(width: float, metres: float) -> GapTile:
    """Make a tile with one gap whose edge is `metres` beyond the run-up, m."""
    return GapTile(low=width, high=width, island=_RUN_UP + metres)


def _second_gap(gap: GapTile) -> float:
    """Return the distance from the start beyond which a robot heads into the second gap, m.

    It is the middle of the ground between the gaps, and infinite if there is a single one.
    """
    if gap.ground is None:
        return np.inf
    return gap.island + gap.high + gap.ground / 2.0


def _last_distance(trace: Trace) -> np.ndarray:
    """Return the distance from the start at which first tries, or else the run, ended, [N] m."""
    over = trace.over
    # In the step in which a try ends the robot is at its next start already.
    ends = np.maximum(over.argmax(axis=0) - 1, 0)
    ends[~over[-1]] = -1
    return trace.travelled[ends, np.arange(len(ends))]
