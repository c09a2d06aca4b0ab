"""Images that lie plausibly, with and without the monitors of expected images; and false alarms.

Robots walk to a gap in training's conditions, and their cameras begin to lie on the way. Twins obey
mode camera, mode memory, and mode memory without these monitors. Robots with healthy cameras walk
on all tiles. `python benchmarks/lies.py BUNDLE` takes six minutes on two cores.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import tyro

from facts import errors_in_one_line, report
from renet.bundle import Bundle, find_bundle, write_bundle
from renet.errors import RenetError
from renet.evaluation.evaluator import Evaluator
from renet.evaluation.metrics import bootstrap_interval
from renet.evaluation.monitor_log import MonitorLog, healthy_series
from renet.evaluation.rollout import Trial
from renet.evaluation.settings import PARKOUR
from renet.interface import TICK_DT, control_steps
from renet.selector.calibration import decluster, lowest_in_a_row
from renet.selector.monitors import MONITORS, Monitor
from renet.tasks.parkour_env_cfg import parkour_env_cfg
from renet.terrain.tiles import LEVELS, tiles

EXPECTING = ("surprise", "stillness")
"""Monitors that compare images with those that were expected."""
LIES = (
    "mirrored",
    "turned",
    "split",
    "half_frozen",
    "gain_drift",
    "wrap_around",
    "quantised",
    "wrong_scale",
    "floor_reflection",
    "stray_light",
    "temporal_filter",
    "mount_creep",
    "wet_patch",
)
"""Faults whose images look healthy. The monitors' rules were chosen while their scores were looked
at, but nothing was trained or calibrated with them."""
UNSEEN = ("disparity_steps", "textureless", "foam", "motion_blur")
"""Faults whose scores nobody had looked at when the rules were chosen."""
CROSSED = "crossed"
"""Measure of a fault study."""


@dataclass(frozen=True)
class Cfg:
    bundle: tyro.conf.Positional[Path]
    """Bundle whose vision model expects images, calibrated."""
    json: Path | None = None
    """File for the results."""
    faults: tuple[str, ...] = LIES + UNSEEN
    """Faults, all at severity 5."""
    level: int = 5
    """Level of the gap: 5 is 37 cm."""
    onset: float = 0.6
    """Time at which cameras begin to lie, s; robots come to the gap after some 2 s."""
    robots: int = 40
    """Robots of each setting at the gap."""
    healthy_robots: int = 120
    """Robots with healthy cameras."""
    seconds: float = 60.0
    """Time for which they walk, s."""
    speed: float = 0.6
    """Their speed, m/s."""
    seed: int = 3
    """Seed of these, which calibration does not use."""


def without_expectation(bundle: Bundle, folder: Path) -> Path:
    """Write a copy of a bundle whose selector has no thresholds of the monitors `EXPECTING`."""
    selector = bundle.manifest.selector
    limits = dict(selector.thresholds)
    for name in EXPECTING:
        limits.pop(name, None)
    manifest = replace(bundle.manifest, selector=replace(selector, thresholds=limits))
    models = {}
    for name in bundle.sessions:
        models[name] = (bundle.path / f"{name}.onnx").read_bytes()
    return write_bundle(folder, models, manifest)


def study(bundle: Path, cfg: Cfg, modes: Sequence[str], out: Path) -> dict[str, Any]:
    """Run the fault study on a bundle; returns its summary.

    Raises:
        RenetError: The command failed.
    """
    command = [sys.executable, "-m", "renet", "evaluate", "faults", "--bundle", str(bundle)]
    command += ["--grounds", "gap", "--level", str(cfg.level), "--onsets", str(cfg.onset)]
    command += ["--severities", "5", "--conditions", "training", "--healthy-minutes", "0"]
    command += ["--robots", str(cfg.robots), "--out", str(out)]
    command += ["--faults", *cfg.faults, "--modes", *modes]
    done = subprocess.run(command, capture_output=True)
    if done.returncode:
        raise RenetError(f"{' '.join(command)} failed: {done.stderr.decode().strip()}")
    return json.loads((out / "summary.json").read_text())


def count_alarms(
    monitor: Monitor, runs: Sequence[np.ndarray], threshold: float
) -> dict[str, float]:
    """Count alarms and single images withheld an hour, in healthy runs of scores [T] each."""
    # At the threshold itself a monitor objects.
    level = float(np.nextafter(threshold, -np.inf))
    hours = sum(map(len, runs)) * TICK_DT / 3600.0
    alarms = 0
    withheld = 0
    for run in runs:
        alarms += len(decluster(lowest_in_a_row(run, monitor.in_a_row), level))
        withheld += int((run > level).sum())
    return {
        "hours": hours,
        "alarms": alarms,
        "alarms_per_hour": alarms / hours,
        "images_withheld_per_hour": withheld / hours,
    }


def walk_healthy(bundle: Path, cfg: Cfg) -> dict[str, list[np.ndarray]]:
    """Return the scores of healthy robots in mode memory on all tiles, [T] for each walk."""
    evaluator = Evaluator(bundle, conditions="training")
    task = parkour_env_cfg(play=True, robot=evaluator.robot)
    evaluator.set_conditions(task)
    robots = np.arange(cfg.healthy_robots)
    env = evaluator.make_env(task, range(cfg.healthy_robots), cfg.speed, cfg.seed)
    kinds = len(tiles())
    env.place(robots // kinds % LEVELS, robots % kinds)
    trials = [Trial("memory", (), int(robot)) for robot in robots]
    rollout = evaluator.rollout(env, trials, cfg.seed)
    rollout.on_update = log = MonitorLog(cfg.healthy_robots)
    trace = rollout.run(control_steps(cfg.seconds), PARKOUR)
    return healthy_series(log, trace, cfg.speed)


def summarise(
    studies: Mapping[str, Mapping[str, Any]],
    healthy: Mapping[str, Mapping[str, float]],
    thresholds: Mapping[str, float],
) -> dict[str, Any]:
    """Sum up the studies `with` and `without` the monitors.

    `gain` is the mean difference of the shares that cross, over faults and robots, with its 95 %
    interval over robots: twins of the two studies have the same bodies, starts and faults. `unseen`
    is the same difference over the faults `UNSEEN` alone, which has no interval.
    """
    rows: dict[str, dict[str, Any]] = {}
    for name, summary in studies.items():
        for run in summary["runs"]:
            row = rows.setdefault(run["fault"], {"fault": run["fault"]})
            label = "camera" if run["mode"] == "camera" else f"memory_{name}"
            row[label] = run["measures"][CROSSED]["value"]
    shares = []
    for name in ("with", "without"):
        shares.append(np.array(studies[name]["by_robot"]["memory"]["gap"][CROSSED]))
    gain = shares[0] - shares[1]
    unseen = [rows[name] for name in UNSEEN if name in rows]
    differences = [row["memory_with"] - row["memory_without"] for row in unseen]
    return {
        "thresholds": dict(thresholds),
        "healthy": dict(healthy),
        "robots": len(gain),
        "gain": float(gain.mean()),
        "gain_ci95": list(bootstrap_interval(gain)),
        "gain_unseen": float(np.mean(differences)) if differences else None,
        "runs": list(rows.values()),
    }


def main(cfg: Cfg) -> None:
    bundle = Bundle.load(find_bundle(cfg.bundle))
    calibrated = bundle.manifest.selector.thresholds
    thresholds = {name: calibrated[name] for name in EXPECTING if name in calibrated}
    if not thresholds:
        raise RenetError(
            f"{cfg.bundle} has no threshold of {' or '.join(EXPECTING)}: train with the recipe, "
            "run `renet calibrate`"
        )
    with TemporaryDirectory() as name:
        folder = Path(name)
        other = without_expectation(bundle, folder / bundle.name)
        studies = {
            "with": study(bundle.path, cfg, ("camera", "memory"), folder / "with"),
            "without": study(other, cfg, ("memory",), folder / "without"),
        }
    walks = walk_healthy(bundle.path, cfg)
    healthy = {}
    for name, threshold in thresholds.items():
        healthy[name] = count_alarms(MONITORS[name], walks[name], threshold)
    facts = {"bundle": bundle.name, "bundle_sha256": bundle.sha256}
    report(facts | summarise(studies, healthy, thresholds), cfg.json)


if __name__ == "__main__":
    with errors_in_one_line():
        main(tyro.cli(Cfg, description=__doc__))
