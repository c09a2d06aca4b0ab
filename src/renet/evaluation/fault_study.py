"""The fault benchmark: every camera fault, severity and policy mode, judged by the true pose.

One fault is one batch; what is finished is kept in `parts/` and not run again, so an interrupted
study goes on where it stopped.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from renet.errors import RenetError
from renet.evaluation import metrics
from renet.evaluation.fault_figures import draw_gallery, draw_survival
from renet.evaluation.faults import FAULTS, SEVERITIES, Injection, fault_class
from renet.evaluation.lab import Lab
from renet.evaluation.results import (
    Provenance,
    output_folder,
    plain,
    read_json,
    write_csv,
    write_json,
)
from renet.evaluation.rollout import MODES, Row, Trace, World, run_rollout
from renet.evaluation.terminal import progress, show
from renet.tasks import RenetEnvCfg
from renet.tasks.config import tile_env_cfg
from renet.tasks.terrains import single_tile_terrain
from renet.vocabulary import CONTROL_DT

MARGIN = 0.02
"""RENet's survival may be this much below OP's before a fault is listed as harmful."""


@dataclass(frozen=True)
class FaultsCfg:
    """Settings of the fault benchmark."""

    out: Path = Path("results/faults")
    """Folder for summary.json, summary.csv, survival.png, gallery.png and parts/."""
    bundle: Path | None = None
    """Bundle folder; the one that ships with renet by default."""
    faults: tuple[str, ...] = tuple(FAULTS)
    """Faults to inject."""
    severities: tuple[int, ...] = SEVERITIES
    """Severities, 1 to 5."""
    modes: tuple[str, ...] = ("vp", "renet", "op")
    """Policy modes to compare: vp, renet, op, oracle-switch."""
    robots: int = 20
    """Robots in each setting."""
    quick: bool = False
    """Severities 1, 3, 5 and 10 robots instead."""
    terrain: str = "flat"
    """"flat", or a kind of tile: rough, obstacles, stairs_up, stairs_down, gap, platform."""
    level: int = 3
    """Level of the tile, 1 to 10."""
    speed: float = 0.6
    """Commanded forward speed, m/s."""
    onset: int = 100
    """Control step (0.02 s) at which the fault begins."""
    steps: int = 350
    """Control steps of each run."""
    seed: int = 1
    """Of the robots' starts and of the faults."""
    engine: str = "auto"
    """Physics engine: auto, native or warp."""

    def __post_init__(self) -> None:
        for fault in self.faults:
            for severity in self.severities:
                fault_class(fault).level_of(severity)
        unknown = [mode for mode in self.modes if mode not in MODES]
        if unknown:
            raise RenetError(f"unknown mode '{unknown[0]}': choose among {', '.join(MODES)}")
        if not (self.faults and self.severities and self.modes):
            raise RenetError("give at least one fault, one severity and one mode")
        if self.robots < 1 or not 0 < self.onset < self.steps:
            raise RenetError(
                f"robots {self.robots} must be >= 1 and 0 < onset {self.onset} < steps {self.steps}"
            )
        self.task()

    def task(self) -> str | RenetEnvCfg:
        """The environment to walk in."""
        if self.terrain == "flat":
            return "Renet-Go1-Flat"
        return tile_env_cfg(single_tile_terrain(self.terrain, self.level), play=True)

    def effective(self) -> tuple[tuple[int, ...], int]:
        """Severities and robots after `quick`."""
        return ((1, 3, 5), 10) if self.quick else (self.severities, self.robots)


def run_faults(cfg: FaultsCfg, lab: Lab | None = None) -> dict[str, Any]:
    """Run what has not been run yet, write the results to `cfg.out` and return the summary.

    Raises:
        RenetError: a bundle that cannot be used, or a folder that cannot be written to.
    """
    lab = lab or Lab(cfg.bundle, cfg.engine)
    out = output_folder(cfg.out)
    parts = output_folder(out / "parts")
    provenance = lab.provenance(cfg.seed)
    severities, robots = cfg.effective()
    numbers = list(range(robots)) * (len(severities) * len(cfg.modes))
    world: World | None = None
    results = []
    for number, fault in enumerate(cfg.faults, start=1):
        path = parts / f"{fault}.json"
        part = _finished(path, cfg, provenance)
        if part is None:
            world = world or lab.world(cfg.task(), numbers, cfg.speed, cfg.seed)
            name = f"{number}/{len(cfg.faults)} {fault}"
            part = _run_fault(cfg, lab, world, fault, name) | _key(cfg, provenance)
            write_json(path, part)
        results.append(part)
    summary = summarise(cfg, results, provenance)
    write_json(out / "summary.json", summary)
    write_csv(out / "summary.csv", summary["runs"])
    draw_survival(summary["runs"], cfg.modes, severities, out / "survival.png", provenance)
    draw_gallery(cfg.faults, cfg.seed, out / "gallery.png", provenance)
    return summary


def _key(cfg: FaultsCfg, provenance: Provenance) -> dict[str, Any]:
    """What a finished part must agree with to be used again."""
    settings = asdict(cfg)
    for name in ("out", "bundle", "faults"):
        settings.pop(name)
    return {"settings": plain(settings), "bundle_hash": provenance.bundle_hash}


def _finished(path: Path, cfg: FaultsCfg, provenance: Provenance) -> dict[str, Any] | None:
    """A part from an earlier run with the same settings and bundle, or None."""
    if not path.exists():
        return None
    part = read_json(path)
    return part if part.items() >= _key(cfg, provenance).items() else None


def _run_fault(cfg: FaultsCfg, lab: Lab, world: World, fault: str, name: str) -> dict[str, Any]:
    """All severities and modes of one fault."""
    severities, robots = cfg.effective()
    rows = [
        Row(mode, (Injection.of(fault, severity, cfg.onset),), robot)
        for severity in severities
        for mode in cfg.modes
        for robot in range(robots)
    ]
    with progress(name, cfg.steps) as advance:
        trace = run_rollout(
            world,
            lab.controller(len(rows)),
            lab.switch(len(rows)),
            rows,
            cfg.steps,
            cfg.seed,
            on_step=advance,
        )
    runs, start = [], 0
    for severity in severities:
        for mode in cfg.modes:
            runs.append(_run(cfg, trace, slice(start, start + robots), fault, severity, mode))
            start += robots
    return {
        "runs": runs,
        "false_switches": metrics.false_switches(
            trace.trusted[: cfg.onset], trace.failing[: cfg.onset]
        ),
        "healthy_robot_hours": metrics.healthy_hours(trace.failing[: cfg.onset]),
    }


def _run(
    cfg: FaultsCfg, trace: Trace, index: slice, fault: str, severity: int, mode: str
) -> dict[str, Any]:
    """One row of the summary."""
    model = fault_class(fault)
    upright = ~trace.fallen[-1, index]
    low, high = metrics.bootstrap_interval(upright)
    delay = metrics.switch_delay(trace.trusted[:, :, index], cfg.onset)
    detected = ~np.isnan(delay)
    known = bool(detected.any())
    return {
        "fault": fault,
        "severity": severity,
        "level": model.level_of(severity),
        "unit": model.unit,
        "mode": mode,
        "terrain": cfg.terrain,
        "robots": len(upright),
        "falls": int((~upright).sum()),
        "survival": float(upright.mean()),
        "survival_ci95_low": low,
        "survival_ci95_high": high,
        "mean_forward_velocity": metrics.mean_forward_velocity(trace.speed[:, index]),
        "collisions": float(trace.collisions[cfg.onset :, index].mean()),
        "detected": int(detected.sum()),
        "detection_delay_s": float(np.median(delay[detected])) if known else None,
        "detection_delay_p95_s": float(np.quantile(delay[detected], 0.95)) if known else None,
        "seed": cfg.seed,
    }


def summarise(
    cfg: FaultsCfg, parts: list[dict[str, Any]], provenance: Provenance
) -> dict[str, Any]:
    """The content of summary.json."""
    runs = [run for part in parts for run in part["runs"]]
    hours = sum(part["healthy_robot_hours"] for part in parts)
    switches = sum(part["false_switches"] for part in parts)
    return {
        "study": "faults",
        "runs": runs,
        "harmful": harmful(runs),
        "missed": missed(runs),
        "healthy": {
            "false_switches": switches,
            "robot_hours": hours,
            "false_switches_per_hour": switches / hours,
        },
        "run_seconds": cfg.steps * CONTROL_DT,
        "settings": asdict(cfg),
        "provenance": vars(provenance),
    }


def harmful(runs: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Faults under which RENet survives less often than OP alone would, beyond the margin."""
    op = {(r["fault"], r["severity"]): r["survival"] for r in runs if r["mode"] == "op"}
    return [
        {"fault": r["fault"], "severity": r["severity"], "renet": r["survival"], "op": other}
        for r in runs
        if r["mode"] == "renet"
        and (other := op.get((r["fault"], r["severity"]))) is not None
        and r["survival"] < other - MARGIN
    ]


def missed(runs: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Faults that make VP fall and that the selector did not notice on every robot."""
    falls = {(r["fault"], r["severity"]): r["falls"] for r in runs if r["mode"] == "vp"}
    return [
        {
            "fault": r["fault"],
            "severity": r["severity"],
            "undetected": r["robots"] - r["detected"],
            "vp_falls": falls[r["fault"], r["severity"]],
        }
        for r in runs
        if r["mode"] == "renet"
        and falls.get((r["fault"], r["severity"]), 0) > 0
        and r["detected"] < r["robots"]
    ]


def main(cfg: FaultsCfg) -> None:
    """`renet evaluate faults`."""
    summary = run_faults(cfg)
    share: dict[tuple[str, int], list[str]] = {}
    for run in summary["runs"]:
        share.setdefault((run["fault"], run["severity"]), []).append(f"{100 * run['survival']:.0f}")
    rows = [(*setting, *values) for setting, values in share.items()]
    show("Robots on their feet at the end (%)", ("fault", "severity", *cfg.modes), rows)
    print(
        f"{len(summary['harmful'])} settings worse than OP alone, {len(summary['missed'])}"
        f" that make VP fall and go unnoticed\nResults: {cfg.out}"
    )
