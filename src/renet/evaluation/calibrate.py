"""`renet calibrate`: measure the selector's threshold β on healthy runs and store it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

import numpy as np
import tyro

from renet.deploy.bundle import write_manifest
from renet.errors import RenetError
from renet.evaluation.lab import Lab
from renet.evaluation.rollout import Row, Trace, run_rollout
from renet.evaluation.terminal import progress
from renet.evaluation.world import SimWorld
from renet.selector.calibration import calibrate, conformal_threshold
from renet.tiles import LEVELS, tiles
from renet.vocabulary import CONTROL_DT, STEPS_PER_TICK

FLAT, PARKOUR = "Renet-Go1-Flat", "Renet-Go1-Parkour"


@dataclass(frozen=True)
class CalibrateCfg:
    """How β is measured: from the anomaly scores of episodes that succeed, cameras healthy."""

    bundle: tyro.conf.Positional[Path]
    """Bundle folder; its manifest gets the new β."""
    robots: int = 120
    """Robots on each task."""
    seconds: float = 20.0
    """Simulated time of each robot."""
    speed: float = 0.6
    """Commanded forward speed, m/s."""
    tasks: tuple[str, ...] = (FLAT, PARKOUR)
    """Tasks to run."""
    levels: int = LEVELS
    """Highest terrain level, 1 to 10; episodes that fail do not count."""
    false_alarm: float = 0.0
    """0: the paper's rule, β is the largest score. Otherwise β is exceeded by a healthy frame with
    at most this probability (split conformal)."""
    seed: int = 7
    """Of the robots' starts."""
    engine: str = "auto"
    """Physics engine: auto, native or warp."""


def run_calibrate(cfg: CalibrateCfg, lab: Lab | None = None) -> float:
    """Measure β, write it into the bundle's manifest and return it.

    Raises:
        RenetError: a bundle that cannot be used, or a policy that never succeeds.
    """
    if cfg.robots < 1 or cfg.seconds < 1 or not 1 <= cfg.levels <= LEVELS:
        raise RenetError(
            f"robots {cfg.robots} and seconds {cfg.seconds} must be >= 1, levels {cfg.levels}"
            f" between 1 and {LEVELS}"
        )
    lab = lab or Lab(cfg.bundle, cfg.engine)
    scores = np.concatenate([_healthy_scores(cfg, lab, task) for task in cfg.tasks])
    if len(scores) == 0:
        raise RenetError("no episode succeeded: train the policy before calibrating its selector")
    beta = conformal_threshold(scores, cfg.false_alarm) if cfg.false_alarm else calibrate(scores)
    rule = f"false alarm {cfg.false_alarm}" if cfg.false_alarm else "maximum"
    how = (
        f"{rule} of {len(scores)} scores of successful episodes, seed {cfg.seed},"
        f" {datetime.now(UTC):%Y-%m-%d}"
    )
    manifest = lab.bundle.manifest
    selector = replace(manifest.selector, beta=beta, calibration=how)
    write_manifest(lab.bundle.path, replace(manifest, selector=selector))
    print(f"beta {beta:.6g} ({how}) written to {lab.bundle.path}")
    return beta


def _healthy_scores(cfg: CalibrateCfg, lab: Lab, task: str) -> np.ndarray:
    """Scores of one task's successful episodes, VP in charge throughout."""
    steps = round(cfg.seconds / CONTROL_DT)
    world = lab.world(task, range(cfg.robots), cfg.speed, cfg.seed)
    if task == PARKOUR and isinstance(world, SimWorld):
        robot = np.arange(cfg.robots)
        world.place(robot // len(tiles()) % cfg.levels, robot % len(tiles()))
    rows = [Row("vp", robot=i) for i in range(cfg.robots)]
    with progress(task, steps) as advance:
        trace = run_rollout(
            world,
            lab.controller(cfg.robots),
            lab.switch(cfg.robots),
            rows,
            steps,
            cfg.seed,
            on_step=advance,
        )
    return successful_scores(trace)


def successful_scores(trace: Trace) -> np.ndarray:
    """Anomaly scores of the vision ticks of every episode that did not end in a fall, [M].

    A robot still on its feet when the run ends succeeded, too. The steps between a restart and
    the next tick have no score of their own and are left out.
    """
    kept = []
    for robot in range(trace.anomaly.shape[1]):
        ends = np.flatnonzero(trace.ended[:, robot])
        edges = [0, *(ends + 1), len(trace.anomaly)]
        for start, end in pairwise(edges):
            if end > start and not trace.fell[end - 1, robot]:
                ticks = np.arange(-(-start // STEPS_PER_TICK) * STEPS_PER_TICK, end, STEPS_PER_TICK)
                kept.append(trace.anomaly[ticks, robot])
    return np.concatenate(kept) if kept else np.zeros(0)
