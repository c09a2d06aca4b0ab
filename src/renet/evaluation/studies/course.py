"""The course: about a kilometre unattended, in laps, with the paper's timeline of the selector.

Each lap is one batch of robots on a strip of passages (see `course_terrain`). A robot that falls or
gets stuck is counted and set down at the beginning of the next passage.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from renet.errors import RenetError
from renet.evaluation import figures, metrics
from renet.evaluation.evaluator import Evaluator
from renet.evaluation.rollout import Trial
from renet.evaluation.studies.course_env import CourseEnv, PlaceInjector, course_length, time_limit
from renet.evaluation.studies.course_terrain import LAP, SHORT_LAP, course_env_cfg, passage
from renet.evaluation.study import Figures, Part, Table, WalkingStudy
from renet.evaluation.trace import Trace
from renet.faults import SEVERITIES
from renet.interface import CONTROL_DT, STEPS_PER_TICK

ENDS = {"crossed": "#7fb98d", "stuck": "#e9c46a", "fell": "#d1584b"}
"""How a passage ends, and its colour."""


@dataclass(frozen=True)
class CourseStudy(WalkingStudy):
    """A kilometre unattended: grass, stairs, slopes, platforms, gaps, an occlusion."""

    out: Path = Path("results/course")
    """Folder for summary.json, summary.csv, course.png, passages.png and parts/."""
    lap: tuple[str, ...] = LAP
    """Passages of 8 m: flat, grass, rough, stairs, slope, occlusion, platform, gap, obstacles."""
    laps: int = 10
    """Times each robot walks the lap, every time with other stones: 10 of 104 m by default."""
    level: int = 1
    """Size of all obstacles, as a level of the training curriculum, 1 to 10."""
    robots: int = 4
    """Robots in each mode; each walks all laps."""
    severity: int = 4
    """Of the grass (4: three quarters of the way to dense) and the occlusion (4: 75 %), 1 to 5."""
    stuck_after: float = 25.0
    """Seconds on one passage after which a robot counts as stuck; 8 m take 13 s."""

    name: ClassVar[str] = "course"
    selectable: ClassVar[tuple[str, ...]] = ("laps",)

    def __post_init__(self) -> None:
        if not self.lap:
            raise RenetError("the lap has no passages")
        for kind in self.lap:
            passage(kind, self.level)
        super().__post_init__()
        if self.severity not in SEVERITIES:
            raise RenetError(f"severity {self.severity}: choose 1 to 5")
        if self.laps < 1 or self.stuck_after <= 0:
            raise RenetError("laps must be at least 1, stuck after positive")

    def effective(self) -> tuple[tuple[str, ...], int, int]:
        """Lap, number of laps and robots after `quick`."""
        return (SHORT_LAP, 1, 2) if self.quick else (self.lap, self.laps, self.robots)

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """One batch for each lap."""
        laps = range(1, self.effective()[1] + 1)
        return {f"lap_{number}": partial(self._run_lap, evaluator, number) for number in laps}

    def _run_lap(self, evaluator: Evaluator, number: int) -> Part:
        """Every robot of every mode walks one lap."""
        lap, laps, robots = self.effective()
        seed = self.seed + number - 1
        trials = [Trial(mode, robot=robot) for mode in self.modes for robot in range(robots)]
        streams = [trial.robot for trial in trials]
        task = course_env_cfg(lap, [self.level] * len(lap), self.stuck_after, seed, evaluator.robot)
        env = CourseEnv(evaluator.make_env(task, streams, self.speed, seed), lap)
        trace = evaluator.rollout(
            f"lap {number}/{laps}, at most",
            env,
            trials,
            time_limit(lap, self.stuck_after),
            seed,
            on_step=lambda result: bool(env.finished.all()),
            injector=PlaceInjector(env, streams, self.severity, seed),
        )
        logs = {name: env.logged(name) for name in env.log}
        runs = [_run(logs, trace, trial, i, number, len(lap)) for i, trial in enumerate(trials)]
        shown = next((i for i, trial in enumerate(trials) if trial.mode == "renet"), None)
        timeline = None if shown is None else _timeline(logs, trace, shown)
        return {"runs": [run | {"seed": seed} for run in runs], "timeline": timeline}

    def summarise(self, parts: Mapping[str, Part], evaluator: Evaluator) -> dict[str, Any]:
        """Rows by robot and lap, and sums by mode, robot and passage."""
        lap, laps, robots = self.effective()
        runs = [run for part in parts.values() for run in part["runs"]]
        return {
            "runs": runs,
            "totals": [_total([r for r in runs if r["mode"] == mode]) for mode in self.modes],
            "robots": [
                _total([r for r in runs if (r["mode"], r["robot"]) == (mode, robot)])
                | {"robot": robot}
                for mode in self.modes
                for robot in range(robots)
            ],
            "passages": _passages(runs, lap),
            "beta": evaluator.beta,
            "lap_m": course_length(lap),
            "laps": laps,
        }

    def draw(self, summary: dict[str, Any], parts: Mapping[str, Part]) -> Figures:
        """course.png, where RENet was run, and passages.png."""
        drawn = {"passages.png": draw_passages(summary["passages"])}
        timelines = [part["timeline"] for part in parts.values() if part["timeline"]]
        if timelines:
            lap = self.effective()[0]
            drawn["course.png"] = draw_timelines(timelines, lap, summary["beta"])
        return drawn

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Totals by mode."""
        rows = [
            (
                total["mode"],
                f"{total['distance_m'] / 1000:.2f}",
                f"{total['crossed']} of {total['passages']}",
                total["falls"],
                total["stuck"],
                total["switches"],
            )
            for total in summary["totals"]
        ]
        header = ("mode", "walked (km)", "passages crossed", "falls", "stuck", "switches")
        laps = f"{summary['laps']} lap{'s' if summary['laps'] > 1 else ''}"
        return [(f"{laps} of {summary['lap_m']:.0f} m", header, rows)]


def _run(
    logs: dict[str, np.ndarray], trace: Trace, trial: Trial, index: int, lap: int, passages: int
) -> dict[str, Any]:
    """One robot's lap."""
    steps = int((~logs["finished"][:, index]).sum())
    log = {name: values[:steps, index] for name, values in logs.items()}
    ends = ["crossed"] * passages
    for name in ("fell", "stuck"):
        for where in log["passage"][log[name]]:
            ends[int(where)] = name
    vision = trace.vision[:steps, index]
    failing = trace.failing[:steps, index]
    return {
        "mode": trial.mode,
        "lap": lap,
        "robot": trial.robot,
        "distance_m": float(log["metres"].sum()),
        "seconds": steps * CONTROL_DT,
        "falls": int(log["fell"].sum()),
        "stuck": int(log["stuck"].sum()),
        "switches": int(metrics.switches(trace.trusted[:steps, :, index : index + 1])[0]),
        "vision_share": float(vision.mean()),
        "vision_share_healthy": float(vision[~failing].mean()),
        "vision_share_failing": float(vision[failing].mean()) if failing.any() else None,
        "ends": ends,
    }


def _timeline(logs: dict[str, np.ndarray], trace: Trace, index: int) -> dict[str, Any]:
    """What the figure shows of one robot's lap, at 10 Hz."""
    steps = int((~logs["finished"][:, index]).sum())
    ticks = slice(STEPS_PER_TICK - 1, steps, STEPS_PER_TICK)

    def events(name: str) -> list[float]:
        return (np.flatnonzero(logs[name][:steps, index]) * CONTROL_DT).tolist()

    return {
        "anomaly": trace.anomaly[ticks, index],
        "probability": trace.probability[ticks, index],
        "vision": trace.vision[ticks, index].astype(int),
        "passage": logs["passage"][ticks, index],
        "fell": events("fell"),
        "stuck": events("stuck"),
    }


def _total(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Sums over the laps of one mode."""
    distance, failures = (sum(r[k] for r in runs) for k in ("distance_m", "falls"))
    return {
        "mode": runs[0]["mode"],
        "distance_m": distance,
        "seconds": sum(r["seconds"] for r in runs),
        "falls": failures,
        "stuck": sum(r["stuck"] for r in runs),
        "falls_per_km": 1000 * failures / distance if distance > 0 else None,
        "passages": sum(len(r["ends"]) for r in runs),
        "crossed": sum(r["ends"].count("crossed") for r in runs),
        "switches": sum(r["switches"] for r in runs),
    }


def _passages(runs: list[dict[str, Any]], lap: tuple[str, ...]) -> list[dict[str, Any]]:
    """How each kind of passage went in each mode."""
    rows = []
    for mode in dict.fromkeys(run["mode"] for run in runs):
        for kind in dict.fromkeys(lap):
            ends = [
                end
                for run in runs
                if run["mode"] == mode
                for end, here in zip(run["ends"], lap, strict=True)
                if here == kind
            ]
            counts = {name: ends.count(name) for name in ("crossed", "fell", "stuck")}
            rows.append({"mode": mode, "kind": kind, "tries": len(ends), **counts})
    return rows


def draw_timelines(laps: Sequence[dict[str, Any]], lap: Sequence[str], beta: float) -> Figure:
    """The paper's figure: loss, P_t and the estimator in charge, one line for each lap.

    Args:
        laps: the laps' timelines, at 10 Hz.
        lap: kinds of passage.
        beta: threshold.
    """
    every, marks, events = CONTROL_DT * STEPS_PER_TICK, [], []
    for line in laps:
        where = [int(i) for i in line["passage"]]
        starts = [k for k in range(len(where)) if k == 0 or where[k] != where[k - 1]]
        marks.append([(k * every, lap[where[k]]) for k in starts])
        events.append([(instant, name) for name in ("fell", "stuck") for instant in line[name]])
    return figures.timelines(laps, marks, beta, "", events, every)


def draw_passages(passages: Sequence[dict[str, Any]]) -> Figure:
    """Shares of tries on each kind of passage that were crossed, got stuck or fell, by mode."""
    modes = list(dict.fromkeys(row["mode"] for row in passages))
    kinds = list(dict.fromkeys(row["kind"] for row in passages))
    with plt.rc_context({"axes.grid": False}):
        figure, axes = plt.subplots(
            1, len(modes), figsize=(9, 0.32 * len(kinds) + 1.5), sharey=True, squeeze=False
        )
        for axis, mode in zip(axes[0], modes, strict=True):
            rows = {row["kind"]: row for row in passages if row["mode"] == mode}
            left = np.zeros(len(kinds))
            for end, colour in ENDS.items():
                share = np.array([100 * rows[k][end] / max(rows[k]["tries"], 1) for k in kinds])
                axis.barh(kinds, share, left=left, color=colour, label=end, height=0.72)
                left += share
            for y, kind in enumerate(kinds):
                row = rows[kind]
                text = f"{row['crossed']} of {row['tries']}"
                axis.text(2, y, text, va="center", fontsize=8, color=figures.INK)
            axis.set(title=figures.MODE_NAMES[mode], xlabel="tries (%)", xlim=(0, 100))
            axis.tick_params(axis="y", length=0)
        axes[0][0].invert_yaxis()
        handles, labels = axes[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), fontsize=9)
        return figure
