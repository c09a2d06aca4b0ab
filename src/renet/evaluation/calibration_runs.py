"""Healthy simulated runs for `renet calibrate`."""

from __future__ import annotations

import numpy as np

from renet.deploy.bundle import Bundle
from renet.errors import RenetError
from renet.evaluation.calibrate import PARKOUR, CalibrateCfg
from renet.evaluation.healthy import ScoreLog, healthy_series
from renet.evaluation.lab import Lab
from renet.evaluation.rollout import Row, check_speed
from renet.evaluation.world import SimWorld
from renet.interface import CONTROL_DT
from renet.tasks import env_cfg
from renet.terrain.tiles import LEVELS, tiles


def simulated_scores(
    cfg: CalibrateCfg, lab: Lab | None = None
) -> tuple[Bundle, dict[str, list[np.ndarray]]]:
    """The bundle, and every monitor's scores in successful episodes, by name.

    Raises:
        RenetError: settings that cannot be run, or a policy that never succeeds.
    """
    if cfg.robots < 1 or cfg.seconds < 1 or not 1 <= cfg.levels <= LEVELS:
        raise RenetError(
            f"robots {cfg.robots} and seconds {cfg.seconds} must be >= 1, levels {cfg.levels}"
            f" between 1 and {LEVELS}"
        )
    if not cfg.tasks:
        raise RenetError("give at least one task")
    check_speed(cfg.speed)
    for task in cfg.tasks:
        env_cfg(task)
    lab = lab or Lab(cfg.bundle, cfg.engine)
    tasks = [_healthy_runs(cfg, lab, task) for task in cfg.tasks]
    series = {name: [run for task in tasks for run in task[name]] for name in tasks[0]}
    if not series["reconstruction"]:
        raise RenetError("no episode succeeded: train the policy before calibrating its selector")
    return lab.bundle, series


def _healthy_runs(cfg: CalibrateCfg, lab: Lab, task: str) -> dict[str, list[np.ndarray]]:
    """Every monitor's scores in one task's successful episodes, VP in charge throughout."""
    steps = round(cfg.seconds / CONTROL_DT)
    world = lab.world(task, range(cfg.robots), cfg.speed, cfg.seed)
    if task == PARKOUR and isinstance(world, SimWorld):
        robot = np.arange(cfg.robots)
        world.place(robot // len(tiles()) % cfg.levels, robot % len(tiles()))
    rows = [Row("vp", robot=i) for i in range(cfg.robots)]
    log = ScoreLog(cfg.robots)
    trace = lab.walk(task, world, rows, steps, cfg.seed, on_sight=log)
    return healthy_series(log, trace, cfg.speed)
