"""The fault benchmark: every camera fault, severity and policy mode, judged by the true pose.

Every fault begins at one control step and is over at another, or earlier by itself, so that both
ways of the selector are measured. One fault is one batch; what is finished is kept in `parts/` and
not run again, so an interrupted study goes on where it stopped.
"""

from __future__ import annotations

import math
from dataclasses import asdict
from functools import cache, partial
from typing import Any

from renet.evaluation import metrics
from renet.evaluation.fault_cfg import FaultsCfg
from renet.evaluation.fault_figures import draw_detection, draw_gallery, draw_roc, draw_survival
from renet.evaluation.fault_findings import findings
from renet.evaluation.fault_pairs import paired_runs
from renet.evaluation.fault_runs import run_baseline, run_fault, run_healthy
from renet.evaluation.lab import Lab
from renet.evaluation.results import Parts, Provenance, output_folder, write_csv, write_json
from renet.evaluation.rollout import World
from renet.evaluation.terminal import show
from renet.interface import CONTROL_DT

__all__ = ["FaultsCfg", "main", "run_faults"]


def run_faults(cfg: FaultsCfg, lab: Lab | None = None) -> dict[str, Any]:
    """Run what has not been run yet, write the results to `cfg.out` and return the summary.

    Raises:
        RenetError: a bundle that cannot be used, or a folder that cannot be written to.
    """
    lab = lab or Lab(cfg.bundle, cfg.engine, cfg.selector)
    out = output_folder(cfg.out)
    provenance = lab.provenance(cfg.seed)
    parts = Parts(out, cfg, provenance, free=("faults",))
    severities, robots = cfg.effective()
    numbers = list(range(robots)) * (len(severities) * len(cfg.modes))

    @cache
    def world(terrain: str) -> World:
        return lab.world(cfg.task(terrain), numbers, cfg.speed, cfg.seed)

    def one(fault: str, name: str) -> dict[str, Any]:
        return run_fault(cfg, lab, world(cfg.terrain_of(fault)), fault, name)

    def none(terrain: str) -> dict[str, Any]:
        return run_baseline(cfg, lab, world(terrain), terrain)

    results = [
        parts.get(fault, partial(one, fault, f"{number}/{len(cfg.faults)} {fault}"))
        for number, fault in enumerate(cfg.faults, start=1)
    ]
    baseline = {
        terrain: parts.get(f"no_fault_{terrain}", partial(none, terrain))
        for terrain in dict.fromkeys(cfg.terrain_of(fault) for fault in cfg.faults)
    }
    healthy = None
    if cfg.healthy_minutes > 0:
        healthy = parts.get("healthy", partial(run_healthy, cfg, lab))
    summary = summarise(cfg, results, baseline, healthy, provenance)
    write_json(out / "summary.json", summary)
    write_csv(out / "summary.csv", summary["runs"])
    draw_survival(summary["runs"], cfg.modes, severities, out / "survival.png", provenance)
    draw_detection(summary["runs"], severities, out / "detection.png", provenance)
    curves = {fault: part["roc"] for fault, part in zip(cfg.faults, results, strict=True)}
    draw_roc(curves, out / "roc.png", provenance)
    draw_gallery(cfg.faults, cfg.seed, out / "gallery.png", provenance)
    return summary


def summarise(
    cfg: FaultsCfg,
    parts: list[dict[str, Any]],
    baseline: dict[str, dict[str, Any]],
    healthy: dict[str, Any] | None,
    provenance: Provenance,
) -> dict[str, Any]:
    """The content of summary.json."""
    robots = cfg.effective()[1]
    runs = [
        run
        for part in parts
        for run in paired_runs(part, baseline[part["runs"][0]["terrain"]], cfg.modes, robots)
    ]
    usual = [run for part in baseline.values() for run in part["runs"]]
    # Not the seconds before the faults: they are the same as without, to the bit. Not the ground
    # that glass has to go to.
    calm_parts = [part for terrain, part in baseline.items() if terrain == cfg.terrain]
    hours = sum(part["healthy_robot_hours"] for part in calm_parts)
    switches = sum(part["false_switches"] for part in calm_parts)
    if healthy is not None:
        hours, switches = hours + healthy["robot_hours"], switches + healthy["false_switches"]
    calm = {
        "false_switches": switches,
        "robot_hours": hours,
        "false_switches_per_hour": switches / hours if hours else math.nan,
        "upper_95_per_hour": metrics.poisson_upper(switches) / hours if hours else math.nan,
        "alarms_by_monitor": {} if healthy is None else healthy["alarms"],
    }
    return {
        "study": "faults",
        "runs": runs,
        "baseline": usual,
        **findings(runs, usual, calm),
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
