"""The runs of the fault benchmark: one batch for each fault, one with healthy cameras."""

from __future__ import annotations

from typing import Any

import numpy as np

from renet.evaluation import metrics
from renet.evaluation.fault_cfg import FaultsCfg
from renet.evaluation.fault_measures import Batch, measure, separability
from renet.evaluation.healthy import healthy_series
from renet.evaluation.lab import Lab
from renet.evaluation.rollout import Row, World
from renet.evaluation.witness import Witness, suspicion
from renet.faults import Injection, fault_class
from renet.interface import CONTROL_DT, STEPS_PER_TICK
from renet.selector.calibration import decluster

HEALTHY_ROBOTS = 64
"""Robots side by side in the run without faults."""


def run_fault(cfg: FaultsCfg, lab: Lab, world: World, fault: str, name: str) -> dict[str, Any]:
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
    return {"runs": runs, "roc": roc, "fell": batch.trace.fallen[-1].astype(int)}


def run_baseline(cfg: FaultsCfg, lab: Lab, world: World, terrain: str) -> dict[str, Any]:
    """Every fault's twins, with cameras that never fail: what they fall over by themselves."""
    severities, robots = cfg.effective()
    rows = [Row(mode, (), n) for _ in severities for mode in cfg.modes for n in range(robots)]
    trace = lab.walk(f"no fault, {terrain}", world, rows, cfg.steps, cfg.seed)
    runs = []
    for mode in cfg.modes:
        index = np.array([row.mode == mode for row in rows])
        upright = ~trace.fallen[-1, index]
        low, high = metrics.bootstrap_interval(upright)
        runs.append(
            {
                "mode": mode,
                "terrain": terrain,
                "robots": len(upright),
                "falls": int((~upright).sum()),
                "survival": float(upright.mean()),
                "survival_ci95_low": low,
                "survival_ci95_high": high,
                "mean_forward_velocity": metrics.mean_forward_velocity(trace.speed[:, index]),
                "seed": cfg.seed,
            }
        )
    return {
        "runs": runs,
        "fell": trace.fallen[-1].astype(int),
        "false_switches": metrics.false_switches(trace.trusted, trace.fallen),
        "healthy_robot_hours": metrics.healthy_hours(trace.fallen),
    }


def _observe(cfg: FaultsCfg, lab: Lab, world: World, rows: list[Row], name: str) -> Batch:
    """Run a batch and score it with every monitor and the paper's selector."""
    witness = Witness(len(rows), {"paper": lab.switch(len(rows), "paper")})
    trace = lab.walk(name, world, rows, cfg.steps, cfg.seed, on_sight=witness)
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


def run_healthy(cfg: FaultsCfg, lab: Lab) -> dict[str, Any]:
    """RENet with a camera that never fails: every departure from vision is a false switch."""
    robots = min(HEALTHY_ROBOTS, max(1, round(cfg.healthy_minutes)))
    steps = max(round(60 * cfg.healthy_minutes / robots / CONTROL_DT), STEPS_PER_TICK)
    # Another seed than the calibration's and the faults': these robots are strangers.
    seed = cfg.seed + 1000
    witness = Witness(robots, {})
    world = lab.world(cfg.task(cfg.terrain), range(robots), cfg.speed, seed)
    rows = [Row("renet", (), robot) for robot in range(robots)]
    trace = lab.walk("healthy cameras", world, rows, steps, seed, on_sight=witness)
    series = healthy_series(witness.log, trace)
    return {
        "false_switches": metrics.false_switches(trace.trusted, trace.failing),
        "robot_hours": metrics.healthy_hours(trace.failing),
        "falls": int(trace.fell.sum()),
        "alarms": {
            name: sum(len(decluster(run, np.nextafter(threshold, -np.inf))) for run in series[name])
            for name, threshold in lab.thresholds.items()
        },
    }
