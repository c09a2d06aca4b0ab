"""The fault benchmark: every camera fault, severity and policy mode, judged by the true pose.

Every fault begins at one control step and is over at another, or earlier by itself, so that both
ways of the selector are measured. One fault is one batch; what is finished is kept in `parts/` and
not run again, so an interrupted study goes on where it stopped.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from renet.errors import RenetError
from renet.evaluation import metrics
from renet.evaluation.fault_figures import draw_detection, draw_gallery, draw_roc, draw_survival
from renet.evaluation.fault_findings import findings
from renet.evaluation.fault_measures import Batch, measure, separability
from renet.evaluation.faults import FAULTS, SEVERITIES, Injection, fault_class
from renet.evaluation.faults.physical import Glass
from renet.evaluation.healthy import healthy_series
from renet.evaluation.lab import Lab
from renet.evaluation.results import (
    Provenance,
    output_folder,
    plain,
    read_json,
    write_csv,
    write_json,
)
from renet.evaluation.rollout import MODES, Row, World, run_rollout
from renet.evaluation.switches import check_selector
from renet.evaluation.terminal import progress, show
from renet.evaluation.witness import Witness, suspicion
from renet.selector.calibration import bursts
from renet.tasks import RenetEnvCfg
from renet.tasks.config import tile_env_cfg
from renet.tasks.terrains import single_tile_terrain
from renet.vocabulary import CONTROL_DT, STEPS_PER_TICK

FLAT = "flat"
HEALTHY_ROBOTS = 64
"""Robots side by side in the run without faults."""


@dataclass(frozen=True)
class FaultsCfg:
    """Settings of the fault benchmark."""

    out: Path = Path("results/faults")
    """Folder for summary.json, summary.csv, pictures and parts/."""
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
    over: int = 300
    """Control step at which it is over at the latest."""
    steps: int = 375
    """Control steps of each run."""
    healthy_minutes: float = 60.0
    """Robot minutes with a healthy camera, in which false switches are counted; 0: none."""
    selector: str = "guarded"
    """What `renet` trusts: guarded (all monitors, dwell) or paper (reconstruction alone)."""
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
        if self.robots < 1 or not 0 < self.onset < self.over < self.steps:
            raise RenetError(
                f"robots {self.robots} must be >= 1 and 0 < onset {self.onset} < over {self.over}"
                f" < steps {self.steps}"
            )
        if self.healthy_minutes < 0:
            raise RenetError(f"healthy minutes must be >= 0, got {self.healthy_minutes}")
        check_selector(self.selector)
        self.task(self.terrain)

    def task(self, terrain: str) -> str | RenetEnvCfg:
        """The environment to walk in."""
        if terrain == FLAT:
            return "Renet-Go1-Flat"
        return tile_env_cfg(single_tile_terrain(terrain, self.level), play=True)

    def terrain_of(self, fault: str) -> str:
        """Where a fault is studied: glass needs obstacles that can be glass."""
        fits = fault != Glass.name or self.terrain in Glass.terrains
        return self.terrain if fits else Glass.terrains[0]

    def effective(self) -> tuple[tuple[int, ...], int]:
        """Severities and robots after `quick`."""
        return ((1, 3, 5), 10) if self.quick else (self.severities, self.robots)


def run_faults(cfg: FaultsCfg, lab: Lab | None = None) -> dict[str, Any]:
    """Run what has not been run yet, write the results to `cfg.out` and return the summary.

    Raises:
        RenetError: a bundle that cannot be used, or a folder that cannot be written to.
    """
    lab = lab or Lab(cfg.bundle, cfg.engine, cfg.selector)
    out = output_folder(cfg.out)
    parts = output_folder(out / "parts")
    provenance = lab.provenance(cfg.seed)
    severities, robots = cfg.effective()
    key, worlds = _key(cfg, provenance), {}
    numbers = list(range(robots)) * (len(severities) * len(cfg.modes))

    def world(terrain: str) -> World:
        if terrain not in worlds:
            worlds[terrain] = lab.world(cfg.task(terrain), numbers, cfg.speed, cfg.seed)
        return worlds[terrain]

    results = []
    for number, fault in enumerate(cfg.faults, start=1):
        path = parts / f"{fault}.json"
        part = _finished(path, key)
        if part is None:
            name = f"{number}/{len(cfg.faults)} {fault}"
            part = _run_fault(cfg, lab, world(cfg.terrain_of(fault)), fault, name) | key
            write_json(path, part)
        results.append(part)
    healthy = _finished(parts / "healthy.json", key)
    if healthy is None and cfg.healthy_minutes > 0:
        healthy = _run_healthy(cfg, lab) | key
        write_json(parts / "healthy.json", healthy)
    summary = summarise(cfg, results, healthy, provenance)
    write_json(out / "summary.json", summary)
    write_csv(out / "summary.csv", summary["runs"])
    draw_survival(summary["runs"], cfg.modes, severities, out / "survival.png", provenance)
    draw_detection(summary["runs"], severities, out / "detection.png", provenance)
    curves = {fault: part["roc"] for fault, part in zip(cfg.faults, results, strict=True)}
    draw_roc(curves, out / "roc.png", provenance)
    draw_gallery(cfg.faults, cfg.seed, out / "gallery.png", provenance)
    return summary


def _key(cfg: FaultsCfg, provenance: Provenance) -> dict[str, Any]:
    """What a finished part must agree with to be used again."""
    settings = asdict(cfg)
    for name in ("out", "bundle", "faults"):
        settings.pop(name)
    return {"settings": plain(settings), "bundle_hash": provenance.bundle_hash}


def _finished(path: Path, key: dict[str, Any]) -> dict[str, Any] | None:
    """A part from an earlier run with the same settings and bundle, or None."""
    if not path.exists():
        return None
    part = read_json(path)
    return part if part.items() >= key.items() else None


def _run_fault(cfg: FaultsCfg, lab: Lab, world: World, fault: str, name: str) -> dict[str, Any]:
    """All severities and modes of one fault."""
    severities, robots = cfg.effective()
    seconds = (cfg.over - cfg.onset) * CONTROL_DT
    rows = [
        Row(mode, (Injection.of(fault, severity, cfg.onset, seconds),), robot)
        for severity in severities
        for mode in cfg.modes
        for robot in range(robots)
    ]
    batch = _observe(cfg, lab, world, rows, name)
    runs, roc, size = [], [], robots * len(cfg.modes)
    for s, severity in enumerate(severities):
        found = separability(batch, slice(s * size, (s + 1) * size), fault, severity)
        for m, mode in enumerate(cfg.modes):
            start = s * size + m * robots
            measured = measure(batch, slice(start, start + robots), fault, severity)
            areas = {key: value for key, value in found.items() if key.startswith("auc_")}
            runs.append(_labels(cfg, fault, severity, mode) | measured | areas)
            runs[-1]["seed"] = cfg.seed
        roc.append(found)
    before = slice(None, cfg.onset)
    return {
        "runs": runs,
        "roc": roc,
        "false_switches": metrics.false_switches(
            batch.trace.trusted[before], batch.trace.failing[before]
        ),
        "healthy_robot_hours": metrics.healthy_hours(batch.trace.failing[before]),
    }


def _observe(cfg: FaultsCfg, lab: Lab, world: World, rows: list[Row], name: str) -> Batch:
    """Run a batch and score it with every monitor and the paper's selector."""
    witness = Witness(len(rows), {"paper": lab.switch(len(rows), "paper")})
    with progress(name, cfg.steps) as advance:
        trace = run_rollout(
            world,
            lab.controller(len(rows)),
            lab.switch(len(rows)),
            rows,
            cfg.steps,
            cfg.seed,
            on_step=advance,
            on_sight=witness,
        )
    scores = witness.log.scores
    return Batch(
        trace,
        witness.trusted("paper"),
        scores["reconstruction"],
        suspicion(scores, lab.thresholds, cfg.onset // STEPS_PER_TICK),
        cfg.onset,
        cfg.over,
    )


def _labels(cfg: FaultsCfg, fault: str, severity: int, mode: str) -> dict[str, Any]:
    """The first half of one row of the summary: which setting it is."""
    model = fault_class(fault)
    return {
        "fault": fault,
        "severity": severity,
        "level": model.level_of(severity),
        "unit": model.unit,
        "mode": mode,
        "terrain": cfg.terrain_of(fault),
    }


def _run_healthy(cfg: FaultsCfg, lab: Lab) -> dict[str, Any]:
    """RENet with a camera that never fails: every departure from vision is a false switch."""
    robots = min(HEALTHY_ROBOTS, max(1, round(cfg.healthy_minutes)))
    steps = max(round(cfg.healthy_minutes * 60 / robots / CONTROL_DT), STEPS_PER_TICK)
    # Another seed than the calibration's and the faults': these robots are strangers.
    seed = cfg.seed + 1000
    witness = Witness(robots, {})
    with progress("healthy cameras", steps) as advance:
        trace = run_rollout(
            lab.world(cfg.task(cfg.terrain), range(robots), cfg.speed, seed),
            lab.controller(robots),
            lab.switch(robots),
            [Row("renet", (), robot) for robot in range(robots)],
            steps,
            seed,
            on_step=advance,
            on_sight=witness,
        )
    series = healthy_series(witness.log, trace)
    return {
        "false_switches": metrics.false_switches(trace.trusted, trace.failing),
        "robot_hours": metrics.healthy_hours(trace.failing),
        "falls": int(trace.fell.sum()),
        "alarms": {
            name: sum(len(bursts(run, np.nextafter(threshold, -np.inf))) for run in series[name])
            for name, threshold in lab.thresholds.items()
        },
    }


def summarise(
    cfg: FaultsCfg,
    parts: list[dict[str, Any]],
    healthy: dict[str, Any] | None,
    provenance: Provenance,
) -> dict[str, Any]:
    """The content of summary.json."""
    runs = [run for part in parts for run in part["runs"]]
    hours = sum(part["healthy_robot_hours"] for part in parts)
    switches = sum(part["false_switches"] for part in parts)
    if healthy is not None:
        hours, switches = hours + healthy["robot_hours"], switches + healthy["false_switches"]
    calm = {
        "false_switches": switches,
        "robot_hours": hours,
        "false_switches_per_hour": switches / hours,
        "upper_95_per_hour": metrics.poisson_upper(switches) / hours,
        "alarms_by_monitor": {} if healthy is None else healthy["alarms"],
    }
    return {
        "study": "faults",
        "runs": runs,
        **findings(runs, calm["false_switches_per_hour"]),
        "healthy": calm,
        "run_seconds": cfg.steps * CONTROL_DT,
        "settings": asdict(cfg),
        "provenance": vars(provenance),
    }


def main(cfg: FaultsCfg) -> None:
    """`renet evaluate faults`."""
    summary = run_faults(cfg)
    share: dict[tuple[str, int], list[str]] = {}
    for run in summary["runs"]:
        share.setdefault((run["fault"], run["severity"]), []).append(f"{100 * run['survival']:.0f}")
    rows = [(*setting, *values) for setting, values in share.items()]
    show("Robots on their feet at the end (%)", ("fault", "severity", *cfg.modes), rows)
    claims = [
        ("yes" if claim["met"] else "NO", claim["claim"], claim["measured"])
        for claim in summary["claims"]
    ]
    show("What is promised, and what was measured", ("met", "promise", "measured"), claims)
    print(f"Results: {cfg.out}")
