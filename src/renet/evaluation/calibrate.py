"""`renet calibrate`: measure the selector's thresholds on healthy runs and store them.

From flight logs this needs nothing but the runtime; simulated runs are in `calibration_runs`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import tyro

from renet.deploy.bundle import Bundle, write_manifest
from renet.deploy.calibration_log import recorded_scores
from renet.errors import RenetError
from renet.evaluation.healthy import TICK_RATE
from renet.evaluation.terminal import show
from renet.selector.calibration import calibrate, calibrate_monitors, conformal_threshold

if TYPE_CHECKING:
    from renet.evaluation.lab import Lab

PARKOUR = "Renet-Go1-Parkour"


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
    tasks: tuple[str, ...] = ("Renet-Go1-Flat", PARKOUR)
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

    def __post_init__(self) -> None:
        if not 0.0 <= self.false_alarm < 1.0:
            raise RenetError(f"false alarm must be at least 0 and below 1, got {self.false_alarm}")
        if not 0.0 < self.false_alarms_per_hour < math.inf:
            raise RenetError(
                f"false alarms per hour must be positive, got {self.false_alarms_per_hour}"
            )


def run_calibrate(cfg: CalibrateCfg, lab: Lab | None = None) -> float:
    """Measure β and the monitors' thresholds, write them into the manifest and return β.

    Raises:
        RenetError: a bundle or a log that cannot be used, or a policy that never succeeds.
    """
    if cfg.log:
        bundle = Bundle.load(cfg.bundle)
        scores = recorded_scores(cfg.log, bundle)
        return _store(cfg, bundle, scores, f"{len(cfg.log)} recording(s)")
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
