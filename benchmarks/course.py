"""The course: about a kilometre unattended, in laps, with the paper's timeline of the selector.

`python benchmarks/course.py` takes 6 minutes on one core and leaves results/course.

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
import tyro
from matplotlib.figure import Figure

from course_env import CourseEnv, PlaceInjector, course_env_cfg, course_length, time_limit
from course_terrain import LAP, SHORT_LAP, passage
from facts import errors_in_one_line
from renet.errors import RenetError
from renet.evaluation import figures
from renet.evaluation.evaluator import Evaluator
from renet.evaluation.rollout import Trial
from renet.evaluation.study import Figures, Part, Table, WalkingStudy
from renet.evaluation.trace import Trace
from renet.faults import SEVERITIES
from renet.interface import CONTROL_DT, STEPS_PER_TICK, TICK_DT

ENDS = ("crossed", "fell", "stuck")
"""How a passage ends."""


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
    """Severity of grass (4: three quarters of the way to dense) and occlusion (4: 75 %), 1 to 5."""
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
        task = course_env_cfg(lap, self.level, self.stuck_after, seed, evaluator.robot)
        evaluator.set_conditions(task)
        env = CourseEnv(evaluator.make_env(task, streams, self.speed, seed), lap)
        rollout = evaluator.rollout(env, trials, seed)
        rollout.injector = PlaceInjector(env, streams, self.severity, seed)
        steps, title = time_limit(lap, self.stuck_after), f"lap {number}/{laps}, at most"
        trace = rollout.run(steps, title, on_step=lambda step: bool(env.finished.all()))
        logs, runs, timeline = env.logged(), [], None
        for robot, trial in enumerate(trials):
            steps = int((~logs["finished"][:, robot]).sum())
            log = {name: values[:steps, robot] for name, values in logs.items()}
            lap_trace = trace.robots(slice(robot, robot + 1)).until(steps)
            named = {"mode": trial.mode, "lap": number, "robot": trial.robot}
            runs.append(named | _run(log, lap_trace, len(lap)) | {"seed": seed})
            if trial.mode == "memory" and timeline is None:
                timeline = _timeline(log, lap_trace)
        return {"runs": runs, "timeline": timeline}

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


def _run(log: dict[str, np.ndarray], trace: Trace, passages: int) -> dict[str, Any]:
    """One robot's lap, from what `CourseEnv.logged` and the trace hold of it."""
    ends = ["crossed"] * passages
    for name in ("fell", "stuck"):
        for where in log["passage"][log[name]]:
            ends[int(where)] = name
    vision, failing = trace.vision, trace.failing
    return {
        "distance_m": float(log["metres"].sum()),
        "seconds": len(vision) * CONTROL_DT,
        "falls": int(log["fell"].sum()),
        "stuck": int(log["stuck"].sum()),
        "switches": int(np.diff(trace.vision[:, 0]).sum()),
        "vision_share": float(vision.mean()),
        "vision_share_healthy": float(vision[~failing].mean()),
        "vision_share_failing": float(vision[failing].mean()) if failing.any() else None,
        "ends": ends,
    }


def _timeline(log: dict[str, np.ndarray], trace: Trace) -> dict[str, Any]:
    """What the figure shows of one robot's lap, at 10 Hz, and the seconds at which it failed."""
    ticks = slice(STEPS_PER_TICK - 1, None, STEPS_PER_TICK)
    return {
        "anomaly": trace.anomaly[ticks, 0],
        "probability": trace.probability[ticks, 0],
        "vision": trace.vision[ticks, 0].astype(int),
        "passage": log["passage"][ticks],
        **{name: np.flatnonzero(log[name]) * CONTROL_DT for name in ("fell", "stuck")},
    }


def _total(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Sums over the laps of one mode."""
    names = ("distance_m", "seconds", "falls", "stuck", "switches")
    sums = {name: sum(run[name] for run in runs) for name in names}
    ends = [end for run in runs for end in run["ends"]]
    distance = sums["distance_m"]
    return {
        "mode": runs[0]["mode"],
        **sums,
        "falls_per_km": 1000 * sums["falls"] / distance if distance > 0 else None,
        "passages": len(ends),
        "crossed": ends.count("crossed"),
    }


def _passages(runs: list[dict[str, Any]], lap: tuple[str, ...]) -> list[dict[str, Any]]:
    """How each kind of passage went in each mode."""
    ends: dict[tuple[str, str], list[str]] = {}
    for run in runs:
        for kind, end in zip(lap, run["ends"], strict=True):
            ends.setdefault((run["mode"], kind), []).append(end)
    return [
        {"mode": mode, "kind": kind, "tries": len(kind_ends)}
        | {end: kind_ends.count(end) for end in ENDS}
        for (mode, kind), kind_ends in ends.items()
    ]


def draw_timelines(laps: Sequence[dict[str, Any]], lap: Sequence[str], beta: float) -> Figure:
    """The paper's figure: loss, P_t and the estimator in charge, one line for each lap.

    Args:
        laps: the laps' timelines, at 10 Hz.
        lap: kinds of passage.
        beta: threshold.
    """
    size = (11, 1.75 * len(laps) + 0.9)
    figure, axes = plt.subplots(len(laps), 1, figsize=size, squeeze=False)
    for number, (axis, line) in enumerate(zip(axes[:, 0], laps, strict=True), start=1):
        where = line["passage"]
        starts = np.flatnonzero(np.diff(where, prepend=-1))
        marks = [(k * TICK_DT, lap[where[k]]) for k in starts]
        right = figures.draw_timeline(axis, line, marks, beta, TICK_DT)
        axis.set_ylabel(f"lap {number}")
        look = {"ha": "right", "fontweight": "bold", "color": "#9c1f12"}
        for name in ("fell", "stuck"):
            for instant in line[name]:
                figures.write_beside(axis, instant, name, 0.04, **look)
    axis.set_xlabel("time (s)")
    figures.legend(figure, axis, right)
    return figure


def draw_passages(passages: Sequence[dict[str, Any]]) -> Figure:
    """A table of colours: tries on each kind of passage that crossed it, and how others ended."""
    cells = {}
    for row in passages:
        text = f"{row['crossed']} of {row['tries']}"
        ends = [f"{row[end]} {end}" for end in ("fell", "stuck") if row[end]]
        share = 100 * row["crossed"] / row["tries"]
        cells[row["kind"], row["mode"]] = share, ", ".join([text, *ends])
    return figures.colour_tables({"": cells}, "Passages crossed", width=1.7)


if __name__ == "__main__":
    with errors_in_one_line():
        cfg = tyro.cli(CourseStudy)
        cfg.main()
        print(f"Results: {cfg.out}")
