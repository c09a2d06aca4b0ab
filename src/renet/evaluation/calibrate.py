"""`renet calibrate`: measure the selector's thresholds on healthy runs and store them.

From recordings this needs nothing but the runtime.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import tyro

from renet.bundle import Bundle, write_manifest
from renet.deploy.recording.calibration_images import image_scores
from renet.deploy.recording.calibration_log import recorded_scores
from renet.errors import RenetError
from renet.evaluation.calibrate_memory import MEMORY, Memory, memory_limits
from renet.evaluation.monitor_log import MonitorLog, healthy_series
from renet.evaluation.rollout import FLAT, PARKOUR, Trial, check_finite, check_speed
from renet.faults import Injection
from renet.interface import CONTROL_DT, TICK_DT, Engine
from renet.selector.calibration import calibrate, calibrate_monitors
from renet.selector.monitors import MONITORS
from renet.terminal import show

if TYPE_CHECKING:
    from renet.evaluation.evaluator import Evaluator

SPARSE_GRASS = 2
"""Severity of `tall_grass`: the variance detector learns blades up to this density."""
IN_SPARSE_GRASS = 0.98
"""Share of the runs through sparse grass in which a monitor does not object."""
Series = dict[str, list[np.ndarray]]
"""Scores [T] of each unbroken run, by monitor."""


@dataclass(frozen=True)
class CalibrateCfg:
    """How β and the monitors' thresholds are measured: from episodes that succeed, cameras healthy.

    β is the paper's; the monitors of the mode `memory` get thresholds of their own.
    """

    bundle: tyro.conf.Positional[Path]
    """Bundle folder; its manifest gets β and the thresholds."""
    log: tuple[Path, ...] = ()
    """Recordings of your own robot and healthy camera, to be used in place of simulated runs."""
    images: Path | None = None
    """Folder of depth images of your own healthy camera on a walk, in place of simulated runs: PNG
    of 16 bits, one every 0.1 s, in the order of their names. Only monitors of images learn."""
    scale: float = 0.001
    """Metres of one step of the values of `--images`."""
    lens: tuple[float, float, float, float] | None = None
    """Lens of `--images`, pixels: FX FY CX CY; by default of a view of 87 degrees, undistorted."""
    robots: int = 120
    """Robots on each terrain."""
    seconds: float = 30.0
    """Simulated time of each robot."""
    speed: float = 0.6
    """Commanded forward speed, m/s."""
    terrains: tuple[str, ...] = ("flat", "parkour")
    """Ground to walk on: flat, parkour (all tiles)."""
    levels: int = 10
    """Highest terrain level, 1 to 10; episodes that fail do not count."""
    false_alarm: float = 0.0
    """0: the paper's rule, β is the largest score. Otherwise β is exceeded by a healthy frame with
    at most this probability (split conformal)."""
    false_alarms_per_hour: float = 0.5
    """How often all monitors together may make a healthy robot leave vision."""
    sparse_grass: bool = True
    """Judge images by the variance of a model that predicts one, not by the reconstruction; lift
    thresholds, at most twofold, until each monitor accepts 49 of 50 walks through grass."""
    seed: int = 7
    """Seed of the robots' starts."""
    engine: Engine = "auto"
    """Physics engine, on the CPU; auto: native."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.false_alarm < 1.0:
            raise RenetError(f"false alarm must be at least 0 and below 1, got {self.false_alarm}")
        if not 0.0 < self.false_alarms_per_hour < math.inf:
            rate = self.false_alarms_per_hour
            raise RenetError(f"false alarms per hour must be positive, got {rate}")


def run_calibrate(cfg: CalibrateCfg) -> float:
    """Measure β and the monitors' thresholds, write them into the manifest and return β.

    Raises:
        RenetError: a bundle or a log that cannot be used, or a policy that never succeeds.
    """
    if cfg.log and cfg.images:
        raise RenetError("give --log or --images, not both")
    if not cfg.log and not cfg.images:
        return _store(cfg, *_simulated_scores(cfg))
    bundle = Bundle.load(cfg.bundle.absolute())
    if cfg.images:
        series = image_scores(cfg.images, cfg.scale, cfg.lens, bundle)
    else:
        series = recorded_scores(cfg.log, bundle)
    # Thresholds of what was not recorded stay.
    spec, names = bundle.manifest.selector, {MEMORY} | (MONITORS.keys() - series.keys())
    kept = {name: limit for name, limit in spec.thresholds.items() if name in names}
    return _store(cfg, bundle, series, {}, (kept, spec.longest_memory))


def _store(
    cfg: CalibrateCfg, bundle: Bundle, series: Series, grassy: Series, memory: Memory
) -> float:
    """Learn thresholds, and β without the `grassy` runs; write them into the manifest, return β."""
    scores = np.concatenate(series["reconstruction"])
    # Healthy runs say nothing of how stale a memory may be.
    replaced = {"reconstruction"} if cfg.sparse_grass and bundle.predicts_variance else set()
    series = {name: runs for name, runs in series.items() if name not in {MEMORY, *replaced}}
    thresholds, hours = calibrate_monitors(series, cfg.false_alarms_per_hour, 1.0 / TICK_DT)
    for name, runs in grassy.items():
        if name in thresholds and runs:
            passes = float(np.quantile([run.max() for run in runs], IN_SPARSE_GRASS))
            # A detector that has not learned grass yet must still notice other things.
            twofold = max(2.0 * thresholds[name], 0.5 * thresholds[name])  # It may be negative.
            passes = min(passes, MONITORS[name].ceiling, twofold)
            thresholds[name] = max(thresholds[name], passes)
    beta = calibrate(scores, cfg.false_alarm)
    rule = f"false alarm {cfg.false_alarm}" if cfg.false_alarm else "maximum"
    source = f"{len(cfg.log)} recording(s)" if cfg.log else f"successful episodes, seed {cfg.seed}"
    source = "images" if cfg.images else source
    how = f"{rule} of {len(scores)} scores of {source}, {datetime.now(UTC):%Y-%m-%d}"
    manifest, (limits, longest) = bundle.manifest, memory
    selector = replace(
        manifest.selector,
        beta=beta,
        calibration=how,
        thresholds=thresholds | limits,
        longest_memory=longest,
        false_alarms_per_hour=cfg.false_alarms_per_hour,
        healthy_hours=hours,
    )
    write_manifest(bundle.path, replace(manifest, selector=selector))
    print(f"beta {beta:.6g} ({how}) written to {bundle.path}")
    if longest:
        limit = f"expects an error of {limits[MEMORY]:.2g} m or " if MEMORY in limits else ""
        print(f"VP drives from memory until it {limit}has had no image for {longest:.3g} s")
    rate = f"{cfg.false_alarms_per_hour:g} false alarms per hour"
    title = f"Thresholds for {rate}, from {hours:.2f} healthy robot hours"
    rows = [(name, f"{value:.4g}") for name, value in thresholds.items()]
    show(title, ("monitor", "threshold"), rows)
    return beta


def _simulated_scores(cfg: CalibrateCfg) -> tuple[Bundle, Series, Series, Memory]:
    """The bundle, every monitor's scores in successful episodes, without and with grass; memory."""
    from renet.evaluation.evaluator import Evaluator
    from renet.terrain.tiles import LEVELS

    check_finite(cfg)
    if cfg.robots < 1 or cfg.seconds < 1 or not 1 <= cfg.levels <= LEVELS:
        raise RenetError(
            f"robots {cfg.robots} and seconds {cfg.seconds} must be >= 1, levels {cfg.levels}"
            f" between 1 and {LEVELS}"
        )
    if not cfg.terrains or not {*cfg.terrains} <= {FLAT, PARKOUR}:
        raise RenetError(f"terrains {cfg.terrains}: choose among {FLAT}, {PARKOUR}")
    check_speed(cfg.speed)
    # A folder, not the name of a bundle that ships: that one is not written to.
    evaluator = Evaluator(cfg.bundle.absolute(), cfg.engine)
    series = _healthy_runs(cfg, evaluator, grass=False)
    if not series["reconstruction"]:
        raise RenetError("no episode succeeded: train the policy before calibrating its selector")
    through_grass = cfg.sparse_grass and evaluator.bundle.predicts_variance
    grassy = _healthy_runs(cfg, evaluator, grass=True) if through_grass else {}
    memory: Memory = {}, 0.0
    if evaluator.bundle.manifest.selector.longest_memory:
        memory = memory_limits(evaluator, 3 * cfg.robots, cfg.levels, cfg.speed, cfg.seed)
    return evaluator.bundle, series, grassy, memory


def _healthy_runs(cfg: CalibrateCfg, evaluator: Evaluator, grass: bool) -> Series:
    """Every monitor's scores in the successful episodes on all terrains, by name.

    VP is in charge throughout; with `grass` all walk through sparse grass.
    """
    from renet.tasks.parkour_env_cfg import parkour_env_cfg
    from renet.terrain.tiles import tiles

    robots, steps = np.arange(cfg.robots), round(cfg.seconds / CONTROL_DT)
    faults = (Injection.of("tall_grass", SPARSE_GRASS, onset=0),) if grass else ()
    trials = [Trial("camera", faults, int(robot)) for robot in robots]
    series: Series = {name: [] for name in MONITORS}
    for terrain in cfg.terrains:
        tiled = terrain == PARKOUR
        # Tiles of the paper's preset: studies are to judge on others.
        task = parkour_env_cfg(play=True, robot=evaluator.robot) if tiled else terrain
        env = evaluator.make_env(task, range(cfg.robots), cfg.speed, cfg.seed)
        if tiled:
            env.place(robots // len(tiles()) % cfg.levels, robots % len(tiles()))
        rollout = evaluator.rollout(env, trials, cfg.seed)
        rollout.on_update = log = MonitorLog(cfg.robots)
        trace = rollout.run(steps, terrain)
        for name, runs in healthy_series(log, trace, cfg.speed).items():
            # A robot's first image stands in for the one before it, too: the same blades twice.
            series[name] += [run[1:] for run in runs if len(run) > 1] if grass else runs
    return series
