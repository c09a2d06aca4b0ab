"""Calibration of the selector's thresholds on healthy runs: `renet calibrate`.

Calibration from recordings imports the runtime only, no simulator.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
import tyro

from renet.bundle import SHIPPED, Bundle, pretrained, write_manifest
from renet.deploy.recording.calibration_images import image_scores
from renet.deploy.recording.calibration_log import recorded_scores
from renet.errors import RenetError
from renet.evaluation.calibrate_memory import MEMORY, Memory, memory_limits
from renet.evaluation.monitor_log import MonitorLog, healthy_series
from renet.evaluation.rollout import Trial
from renet.evaluation.settings import (
    FLAT_GROUND,
    PARKOUR,
    Conditions,
    check_finite,
    check_names,
    check_speed,
)
from renet.faults import Injection
from renet.interface import TICK_DT, Engine, control_steps
from renet.selector.calibration import (
    Calibration,
    calibrate,
    calibrate_monitors,
    lowest_in_a_row,
)
from renet.selector.monitors import MONITORS
from renet.terminal import show

if TYPE_CHECKING:
    from renet.evaluation.evaluator import Evaluator

SPARSE_GRASS = 2
"""Severity of `tall_grass` up to which the variance detector learns to accept blades."""
IN_SPARSE_GRASS = 0.98
"""Share of the runs through sparse grass that a monitor accepts."""
Series = dict[str, list[np.ndarray]]
"""Scores [T] of each unbroken run, by monitor."""


@dataclass(frozen=True)
class CalibrateCfg:
    """Measure β and the monitors' thresholds on successful episodes with healthy cameras.

    β is the paper's; the monitors of mode memory have thresholds of their own.
    """

    bundle: tyro.conf.Positional[Path]
    """Bundle folder; β and the thresholds are written to its manifest."""
    log: tuple[Path, ...] = ()
    """Recordings of your own robot and healthy camera, to be used in place of simulated runs."""
    images: Path | None = None
    """Folder of depth images of your own healthy camera on a walk, in place of simulated runs: PNG
    of 16 bits, one every 0.1 s, in the order of their names. Only monitors of images are
    calibrated."""
    scale: float = 0.001
    """Metres per unit of the values of `--images`."""
    lens: tuple[float, float, float, float] | None = None
    """Lens of `--images`, pixels: FX FY CX CY; by default that of an undistorted view of 87
    degrees."""
    rotate: Literal[0, 180] = 0
    """Degrees by which the camera of `--images` is turned in its mount: 180 is upside down."""
    robots: int = 120
    """Number of robots on each terrain."""
    seconds: float = 60.0
    """Simulated time of each robot, s. By default robots walk for so long altogether that a single
    odd walk can be left out (`selector/calibration.py`)."""
    speed: float = 0.6
    """Commanded forward speed, m/s."""
    terrains: tuple[str, ...] = ("flat", "parkour")
    """Ground to walk on: flat, parkour (all tiles)."""
    levels: int = 10
    """Highest terrain level, 1 to 10; episodes that fail do not count."""
    false_alarm: float = 0.0
    """0: the paper's rule, β is the largest score. Otherwise a healthy frame exceeds β with at most
    this probability (split conformal)."""
    false_alarms_per_hour: float = 0.5
    """False alarms per hour, of all monitors together, that are allowed on a healthy robot."""
    sparse_grass: bool = True
    """Judge images by the model's predicted variance, if it has one, not by the reconstruction, and
    raise thresholds, at most twofold, until each monitor accepts 49 of 50 walks through grass."""
    conditions: Conditions = "training"
    """Conditions of simulated runs (docs/measure.md): with `training` bodies, sensors, delays and
    pushes differ as in training. The limits of memory are measured in nominal ones."""
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
    """Measure β and the monitors' thresholds, write them to the manifest and return β.

    Raises:
        RenetError: A bundle or a log cannot be used, options contradict each other, or the policy
            never succeeds.
    """
    if cfg.log and cfg.images:
        raise RenetError("give --log or --images, not both")
    _refuse_unused(cfg)
    _refuse_shipped(cfg.bundle)
    if not cfg.log and not cfg.images:
        return _calibrate_simulated(cfg)
    bundle = Bundle.load(cfg.bundle.absolute())
    if cfg.images:
        series = image_scores(cfg.images, cfg.scale, cfg.lens, bundle, cfg.rotate == 180)
    else:
        series = recorded_scores(cfg.log, bundle)
    # Monitors of what was not recorded keep their thresholds.
    spec = bundle.manifest.selector
    names = {MEMORY} | (MONITORS.keys() - series.keys())
    unchanged = {name: limit for name, limit in spec.thresholds.items() if name in names}
    calibration = _calibrate_monitors(cfg, bundle, series, {})
    _leave_out_blunt(calibration.thresholds)
    return _store(cfg, bundle, series, calibration, (unchanged, spec.longest_memory))


def _refuse_unused(cfg: CalibrateCfg) -> None:
    """Raise RenetError for settings of images without images."""
    if cfg.images:
        return
    for name in ("scale", "lens", "rotate"):
        if getattr(cfg, name) != getattr(CalibrateCfg, name):
            raise RenetError(f"--{name} is about the images of --images FOLDER: give them, too")


def _refuse_shipped(bundle: Path) -> None:
    """Raise RenetError for a bundle that ships, by its name or its folder."""
    for name in SHIPPED:
        by_name = str(bundle) == name and not os.path.lexists(bundle)
        if by_name or _is_folder(bundle, pretrained(name)):
            raise RenetError(
                f"{bundle} ships with renet and keeps its thresholds: calibrate a copy, "
                f"cp -r {pretrained(name)} my-bundle"
            )


def _is_folder(path: Path, folder: Path) -> bool:
    """Return True if a path, which may be none at all, leads to a folder."""
    try:
        return path.samefile(folder)
    except (OSError, ValueError):
        return False


def _calibrate_simulated(cfg: CalibrateCfg) -> float:
    """Calibrate on simulated robots; returns β."""
    evaluator, series, grassy = _simulated_scores(cfg)
    bundle = evaluator.bundle
    calibration = _calibrate_monitors(cfg, bundle, series, grassy)
    thresholds = calibration.thresholds
    _leave_out_blunt(thresholds)
    memory: Memory = ({}, 0.0)
    longest = bundle.manifest.selector.longest_memory
    if longest:
        # Robots obey the new thresholds: an exported bundle has none.
        evaluator.bundle = _with_thresholds(bundle, thresholds, longest)
        memory = memory_limits(evaluator, 3 * cfg.robots, cfg.levels, cfg.speed, cfg.seed)
    slow_monitors = [name for name in thresholds if MONITORS[name].in_a_row > 1]
    if slow_monitors:
        # These monitors withhold an image before they have an alarm, and what they say of the next
        # one then rests on an older image. So their thresholds need robots that walk with them.
        limits, longest = memory
        evaluator.bundle = _with_thresholds(bundle, thresholds | limits, longest)
        withheld = _healthy_runs(cfg, evaluator, grass=False, mode="memory")
        needed = _calibrate_monitors(cfg, bundle, withheld, {}).thresholds
        for name in slow_monitors:
            thresholds[name] = max(thresholds[name], needed.get(name, -math.inf))
        _leave_out_blunt(thresholds)
    return _store(cfg, bundle, series, calibration, memory)


def _with_thresholds(bundle: Bundle, thresholds: dict[str, float], longest: float) -> Bundle:
    """Copy a bundle, with other thresholds and another longest time without an image, s."""
    spec = bundle.manifest.selector
    selector = replace(spec, thresholds=thresholds, longest_memory=longest)
    return replace(bundle, manifest=replace(bundle.manifest, selector=selector))


def _calibrate_monitors(
    cfg: CalibrateCfg, bundle: Bundle, series: Series, grassy: Series
) -> Calibration:
    """Compute the monitors' thresholds.

    Args:
        cfg: Settings.
        bundle: The bundle whose monitors they are.
        series: Healthy scores by monitor.
        grassy: Healthy scores in sparse grass by monitor.
    """
    # Healthy runs do not tell how long memory is good, and the variance may replace a monitor.
    without = {MEMORY}
    if cfg.sparse_grass and bundle.predicts_variance:
        without.add("reconstruction")
    calibrated = {name: runs for name, runs in series.items() if name not in without}
    calibration = calibrate_monitors(calibrated, cfg.false_alarms_per_hour, 1.0 / TICK_DT)
    _accept_grass(calibration.thresholds, grassy)
    return calibration


def _store(
    cfg: CalibrateCfg,
    bundle: Bundle,
    series: Series,
    calibration: Calibration,
    memory: Memory,
) -> float:
    """Compute β, write it and the thresholds to the manifest, print them and return β.

    Args:
        cfg: Settings.
        bundle: The bundle to write to.
        series: Healthy scores by monitor.
        calibration: The monitors' thresholds, and what they rest on.
        memory: Limits of memory.
    """
    limits, longest = memory
    scores = np.concatenate(series["reconstruction"])
    beta = calibrate(scores, cfg.false_alarm)
    description = _description(cfg, len(scores))
    selector = replace(
        bundle.manifest.selector,
        beta=beta,
        calibration=description,
        thresholds=calibration.thresholds | limits,
        longest_memory=longest,
        false_alarms_per_hour=cfg.false_alarms_per_hour,
        healthy_hours=calibration.hours,
    )
    write_manifest(bundle.path, replace(bundle.manifest, selector=selector))
    print(f"beta {beta:.6g} ({description}) written to {bundle.path}")
    if longest:
        limit = f"expects an error of {limits[MEMORY]:.2g} m or " if MEMORY in limits else ""
        print(f"VP drives from memory until it {limit}has had no image for {longest:.3g} s")
    rate = f"{cfg.false_alarms_per_hour:g} false alarms per hour"
    title = f"Thresholds for {rate}, from {calibration.hours:.2f} healthy robot hours"
    if calibration.left_out:
        title += f", odd walks left out: {calibration.left_out}"
    rows = []
    for name, value in calibration.thresholds.items():
        rows.append((name, f"{value:.4g}"))
    show(title, ("monitor", "threshold"), rows)
    return beta


def _leave_out_blunt(thresholds: dict[str, float]) -> None:
    """Remove monitors whose healthy scores are as high as those of a fault, in place.

    A policy whose expectations are poor, for instance, sees healthy images stand still. A monitor
    that has a fallback is not removed, for it would judge by that.
    """
    for name, value in list(thresholds.items()):
        monitor = MONITORS[name]
        if value > monitor.limit and monitor.fallback is None:
            del thresholds[name]
            print(
                f"{name} is left out: with a threshold of {value:.3g}, which healthy images need, "
                f"it would never object (above {monitor.limit:g})"
            )


def _accept_grass(thresholds: dict[str, float], grassy: Series) -> None:
    """Raise thresholds until monitors accept most runs through sparse grass, in place."""
    for name, runs in grassy.items():
        if name not in thresholds or not any(len(run) >= MONITORS[name].in_a_row for run in runs):
            continue
        lowest = [lowest_in_a_row(run, MONITORS[name].in_a_row) for run in runs]
        peaks = [run.max() for run in lowest if len(run)]
        # Of no two neighbours the mean: it would accept one run fewer than the share.
        passes = float(np.quantile(peaks, IN_SPARSE_GRASS, method="inverted_cdf"))
        # A detector that has not learned grass yet must still notice other faults. A threshold may
        # be negative: then half of it is the higher one.
        twofold = max(2.0 * thresholds[name], 0.5 * thresholds[name])
        passes = min(passes, MONITORS[name].ceiling, twofold)
        thresholds[name] = max(thresholds[name], passes)


def _description(cfg: CalibrateCfg, count: int) -> str:
    """Describe the origin of β, from `count` scores, for the manifest."""
    if cfg.images:
        source = "images"
    elif cfg.log:
        source = f"{len(cfg.log)} recording(s)"
    else:
        source = f"successful episodes, {cfg.conditions} conditions, seed {cfg.seed}"
    rule = f"false alarm {cfg.false_alarm}" if cfg.false_alarm else "maximum"
    return f"{rule} of {count} scores of {source}, {datetime.now(UTC):%Y-%m-%d}"


def _simulated_scores(cfg: CalibrateCfg) -> tuple[Evaluator, Series, Series]:
    """Simulate healthy robots; returns their evaluator, and scores without and with grass."""
    from renet.evaluation.evaluator import Evaluator
    from renet.terrain.tiles import LEVELS

    check_finite(cfg)
    if cfg.robots < 1 or cfg.seconds < 1 or not 1 <= cfg.levels <= LEVELS:
        raise RenetError(
            f"robots {cfg.robots} and seconds {cfg.seconds} must be >= 1, levels {cfg.levels}"
            f" between 1 and {LEVELS}"
        )
    check_names("terrains", cfg.terrains, (FLAT_GROUND, PARKOUR))
    check_speed(cfg.speed)
    evaluator = Evaluator(cfg.bundle.absolute(), cfg.engine, cfg.conditions)
    series = _healthy_runs(cfg, evaluator, grass=False)
    if not series["reconstruction"]:
        raise RenetError("no episode succeeded: train the policy before calibrating its selector")
    through_grass = cfg.sparse_grass and evaluator.bundle.predicts_variance
    grassy = _healthy_runs(cfg, evaluator, grass=True) if through_grass else {}
    return evaluator, series, grassy


def _healthy_runs(
    cfg: CalibrateCfg,
    evaluator: Evaluator,
    grass: bool,
    mode: Literal["camera", "memory"] = "camera",
) -> Series:
    """Collect every monitor's scores in the successful episodes on all terrains, by name.

    Args:
        cfg: Settings.
        evaluator: Evaluator of the bundle, in the conditions of the walks.
        grass: True for robots that walk through sparse grass.
        mode: Mode of the robots.
    """
    from renet.evaluation.evaluator import Task
    from renet.tasks.parkour_env_cfg import parkour_env_cfg
    from renet.terrain.tiles import tiles

    robots = np.arange(cfg.robots)
    steps = control_steps(cfg.seconds)
    faults = (Injection.of("tall_grass", SPARSE_GRASS, onset=0),) if grass else ()
    trials = [Trial(mode, faults, int(robot)) for robot in robots]
    series: Series = {name: [] for name in MONITORS}
    for terrain in cfg.terrains:
        on_tiles = terrain == PARKOUR
        # Tiles of the paper's preset, so that studies, which have others, judge on unseen ones.
        task: Task = terrain
        if on_tiles:
            task = parkour_env_cfg(play=True, robot=evaluator.robot)
            evaluator.set_conditions(task)
        env = evaluator.make_env(task, range(cfg.robots), cfg.speed, cfg.seed)
        if on_tiles:
            env.place(robots // len(tiles()) % cfg.levels, robots % len(tiles()))
        rollout = evaluator.rollout(env, trials, cfg.seed)
        log = MonitorLog(cfg.robots)
        rollout.on_update = log
        trace = rollout.run(steps, terrain)
        for name, runs in healthy_series(log, trace, cfg.speed).items():
            if grass:
                # The first image stands for the one before it, too: its blades would count twice.
                runs = [run[1:] for run in runs if len(run) > 1]
            series[name] += runs
    return series
