"""`renet calibrate`: measure the selector's thresholds on healthy runs and store them.

From flight logs this needs nothing but the runtime; simulated runs are in `calibration_runs`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import tyro

from renet.deploy.bundle import Bundle, write_manifest
from renet.deploy.logged import logged_scores
from renet.evaluation.healthy import TICK_RATE, successful_runs
from renet.evaluation.terminal import show
from renet.evaluation.trace import Trace
from renet.selector.calibration import calibrate, calibrate_monitors, conformal_threshold
from renet.vocabulary import STEPS_PER_TICK

if TYPE_CHECKING:
    from renet.evaluation.lab import Lab

FLAT, PARKOUR = "Renet-Go1-Flat", "Renet-Go1-Parkour"


@dataclass(frozen=True)
class CalibrateCfg:
    """How β and the monitors' thresholds are measured: from episodes that succeed, cameras healthy.

    β is the paper's; the monitors of the default selector get thresholds of their own.
    """

    bundle: tyro.conf.Positional[Path]
    """Bundle folder; its manifest gets β and the thresholds."""
    log: tuple[Path, ...] = ()
    """Flight logs of your own robot and healthy camera, to be used in place of simulated runs."""
    robots: int = 120
    """Robots on each task."""
    seconds: float = 30.0
    """Simulated time of each robot."""
    speed: float = 0.6
    """Commanded forward speed, m/s."""
    tasks: tuple[str, ...] = (FLAT, PARKOUR)
    """Tasks to run."""
    levels: int = 10
    """Highest terrain level, 1 to 10; episodes that fail do not count."""
    false_alarm: float = 0.0
    """0: the paper's rule, β is the largest score. Otherwise β is exceeded by a healthy frame with
    at most this probability (split conformal)."""
    false_alarms_per_hour: float = 0.5
    """How often all monitors together may make a healthy robot leave vision."""
    seed: int = 7
    """Of the robots' starts."""
    engine: str = "auto"
    """Physics engine: auto, native or warp."""


def run_calibrate(cfg: CalibrateCfg, lab: Lab | None = None) -> float:
    """Measure β and the monitors' thresholds, write them into the manifest and return β.

    Raises:
        RenetError: a bundle or a log that cannot be used, or a policy that never succeeds.
    """
    if cfg.log:
        bundle = Bundle.load(cfg.bundle)
        return _store(cfg, bundle, logged_scores(cfg.log, bundle), f"{len(cfg.log)} flight log(s)")
    from renet.evaluation.calibration_runs import simulated_scores

    bundle, series = simulated_scores(cfg, lab)
    return _store(cfg, bundle, series, f"successful episodes, seed {cfg.seed}")


def _store(
    cfg: CalibrateCfg, bundle: Bundle, series: dict[str, list[np.ndarray]], source: str
) -> float:
    """Learn β and the thresholds from healthy scores, write them into the manifest, return β."""
    scores = np.concatenate(series["reconstruction"])
    monitors = calibrate_monitors(series, cfg.false_alarms_per_hour, TICK_RATE)
    beta = conformal_threshold(scores, cfg.false_alarm) if cfg.false_alarm else calibrate(scores)
    rule = f"false alarm {cfg.false_alarm}" if cfg.false_alarm else "maximum"
    how = f"{rule} of {len(scores)} scores of {source}, {datetime.now(UTC):%Y-%m-%d}"
    manifest = bundle.manifest
    selector = replace(
        manifest.selector,
        beta=beta,
        calibration=how,
        thresholds=monitors.thresholds,
        false_alarms_per_hour=monitors.false_alarms_per_hour,
        healthy_hours=monitors.robot_hours,
    )
    write_manifest(bundle.path, replace(manifest, selector=selector))
    print(f"beta {beta:.6g} ({how}) written to {bundle.path}")
    rows = [(name, f"{value:.4g}") for name, value in monitors.thresholds.items()]
    show(
        f"Thresholds for {monitors.false_alarms_per_hour:g} false alarms per hour, from"
        f" {monitors.robot_hours:.2f} healthy robot hours",
        ("monitor", "threshold"),
        rows,
    )
    return beta


def successful_scores(trace: Trace) -> np.ndarray:
    """Anomaly scores of the vision ticks of every episode that did not end in a fall, [M].

    A robot still on its feet when the run ends succeeded, too. The steps between a restart and
    the next tick have no score of their own and are left out.
    """
    scores = trace.anomaly[::STEPS_PER_TICK]
    kept = [scores[ticks, robot] for robot, ticks in successful_runs(trace)]
    return np.concatenate(kept) if kept else np.zeros(0)
