"""The course: about a kilometre unattended, in laps, with the paper's timeline of the selector.

Each lap is one batch of robots on a strip of passages (see `course_track`). A robot that falls or
gets stuck is counted and set down at the beginning of the next passage; nobody helps otherwise.
Finished laps are kept in `parts/`, so an interrupted course goes on where it stopped.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from renet.errors import RenetError
from renet.evaluation import course_figures, metrics
from renet.evaluation.course_track import LAP, SHORT_LAP, course_env_cfg, passage
from renet.evaluation.course_world import CourseWorld, PlaceInjector, course_length, time_limit
from renet.evaluation.lab import Lab
from renet.evaluation.results import Parts, output_folder, write_csv, write_json
from renet.evaluation.rollout import Row, Trace, check_modes, check_speed, run_rollout
from renet.evaluation.terminal import progress, show
from renet.faults import SEVERITIES
from renet.interface import CONTROL_DT, STEPS_PER_TICK


@dataclass(frozen=True)
class CourseCfg:
    """Settings of the course."""

    out: Path = Path("results/course")
    """Folder for summary.json, summary.csv, course.png, passages.png and parts/."""
    bundle: Path | None = None
    """Bundle folder; the one that ships with renet by default."""
    lap: tuple[str, ...] = LAP
    """Passages of 8 m: flat, grass, rough, stairs, slope, occlusion, platform, gap, obstacles."""
    laps: int = 10
    """Times each robot walks the lap, every time with other stones: 10 of 104 m by default."""
    quick: bool = False
    """One short lap of 64 m and 2 robots instead: a minute or two."""
    level: int = 1
    """Size of all obstacles, as a level of the training curriculum, 1 to 10."""
    robots: int = 4
    """Robots in each mode; each walks all laps."""
    modes: tuple[str, ...] = ("vp", "renet", "op")
    """Policy modes to compare: vp, renet, op, oracle-switch."""
    severity: int = 4
    """Of the grass (4: three quarters of the way to dense) and the occlusion (4: 75 %), 1 to 5."""
    speed: float = 0.6
    """Commanded forward speed, m/s."""
    patience: float = 25.0
    """Seconds on one passage after which a robot counts as stuck; 8 m take 13 s."""
    selector: str = "monitors"
    """Selector: monitors (all of them) or paper."""
    seed: int = 1
    """Of bodies, starts, stones and grass."""
    engine: str = "auto"
    """Physics engine: auto, native or warp."""

    def __post_init__(self) -> None:
        if not self.lap:
            raise RenetError("the lap has no passages")
        for kind in self.lap:
            passage(kind, self.level)
        check_modes(self.modes)
        check_speed(self.speed)
        if self.severity not in SEVERITIES:
            raise RenetError(f"severity {self.severity}: choose 1 to 5")
        if self.laps < 1 or self.robots < 1 or self.patience <= 0:
            raise RenetError("laps and robots must be at least 1, patience positive")

    def effective(self) -> tuple[tuple[str, ...], int, int]:
        """Lap, number of laps and robots after `quick`."""
        return (SHORT_LAP, 1, 2) if self.quick else (self.lap, self.laps, self.robots)


def run_course(cfg: CourseCfg, lab: Lab | None = None) -> dict[str, Any]:
    """Run what has not been run yet, write the results to `cfg.out` and return the summary.

    Raises:
        RenetError: a bundle that cannot be used, or a folder that cannot be written to.
    """
    lab = lab or Lab(cfg.bundle, cfg.engine, cfg.selector)
    out = output_folder(cfg.out)
    provenance = lab.provenance(cfg.seed)
    parts = Parts(out, cfg, provenance, free=("laps",))
    lap, laps, _ = cfg.effective()
    done = [parts.get(f"lap_{n}", partial(_run_lap, cfg, lab, n)) for n in range(1, laps + 1)]
    runs = [run for part in done for run in part["runs"]]
    summary = {
        "study": "course",
        "runs": runs,
        "totals": [_total([r for r in runs if r["mode"] == mode]) for mode in cfg.modes],
        "robots": [
            _total([r for r in runs if (r["mode"], r["robot"]) == (mode, robot)]) | {"robot": robot}
            for mode in cfg.modes
            for robot in range(cfg.effective()[2])
        ],
        "passages": _passages(runs, lap),
        "lap_m": course_length(lap),
        "laps": laps,
        "settings": asdict(cfg),
        "provenance": vars(provenance),
    }
    write_json(out / "summary.json", summary)
    write_csv(out / "summary.csv", [{k: v for k, v in r.items() if k != "ends"} for r in runs])
    timelines = [part["timeline"] for part in done if part["timeline"]]
    if timelines:
        course_figures.draw_timelines(timelines, lap, lab.beta, out / "course.png", provenance)
    course_figures.draw_passages(summary["passages"], out / "passages.png", provenance)
    return summary


def _run_lap(cfg: CourseCfg, lab: Lab, number: int) -> dict[str, Any]:
    """Every robot of every mode walks one lap."""
    lap, laps, robots = cfg.effective()
    seed = cfg.seed + number - 1
    rows = [Row(mode, robot=robot) for mode in cfg.modes for robot in range(robots)]
    streams = [row.robot for row in rows]
    task = course_env_cfg(lap, [cfg.level] * len(lap), cfg.patience, seed)
    world = CourseWorld(lab.world(task, streams, cfg.speed, seed), lap)
    steps = time_limit(lap, cfg.patience)
    with progress(f"lap {number}/{laps}", len(lap) * len(rows)) as advance:
        shown = 0

        def on_step() -> bool:
            nonlocal shown
            passed = int(np.where(world.finished, len(lap), world.passage).sum())
            while shown < passed:
                advance()
                shown += 1
            return bool(world.finished.all())

        trace = run_rollout(
            world,
            lab.controller(len(rows)),
            lab.switch(len(rows)),
            rows,
            steps,
            seed,
            on_step=on_step,
            injector=PlaceInjector(world, streams, cfg.severity, seed),
        )
    logs = {name: world.logged(name) for name in world.log}
    runs = [_run(logs, trace, row, i, number, len(lap)) for i, row in enumerate(rows)]
    shown_row = next((i for i, row in enumerate(rows) if row.mode == "renet"), None)
    timeline = None if shown_row is None else _timeline(logs, trace, shown_row)
    return {"runs": [run | {"seed": seed} for run in runs], "timeline": timeline}


def _run(
    logs: dict[str, np.ndarray], trace: Trace, row: Row, index: int, lap: int, passages: int
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
        "mode": row.mode,
        "lap": lap,
        "robot": row.robot,
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


def main(cfg: CourseCfg) -> None:
    """`renet evaluate course`."""
    summary = run_course(cfg)
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
    show(f"{laps} of {summary['lap_m']:.0f} m", header, rows)
