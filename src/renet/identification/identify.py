"""`renet identify`: measure a robot's motors in a log of its joints."""

import math
import os
import shlex
import sys
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

from renet import plug_ins
from renet.errors import RenetError, unknown_name
from renet.identification.fit import (
    KIND_INDEX,
    WARM_UP,
    Fit,
    MotorFitter,
    check_motion,
    per_joint,
    per_kind,
    valid_rows,
)
from renet.identification.motion_log import CsvCfg, MotionLog, read_motion_log
from renet.identification.replay import SuspendedRobot
from renet.interface import JOINTS
from renet.motors import KINDS, PARAMETERS, MotorFit, MotorParameters, write_motors
from renet.plug_ins import load_plug_ins
from renet.robots import Robot, robots
from renet.terminal import show
from renet.version import code_version

MIN_SECONDS = 2.0
"""Shortest duration of the part that is fitted, and of the part that is held out, s."""
OUTSIDE = 0.3
"""Angle by which a joint may be measured beyond its limits, rad, as encoders' zeros are inexact."""
HEADER = ("motor", "armature, kg m²", "damping, N m s/rad", "friction, N m", "delay, ms")
PRINTED_UNITS = (1.0, 1.0, 1.0, 1000.0)
"""Factors from `motors.PARAMETERS` to the columns of the table."""


@dataclass(frozen=True)
class IdentifyCfg:
    """Measure a robot's motors: armature, damping, friction and delay.

    Targets of a log are replayed on the robot in MuJoCo, its trunk held in the air, and its motors
    fitted so that its joints move as they were measured. The log must be of a robot that hangs or
    stands on a box, its legs free.
    """

    log: tyro.conf.Positional[Path]
    """CSV file of targets, positions and velocities of all twelve joints, or a recording of `renet
    deploy`."""
    robot: str
    """Whose log it is: go1, go2, or the name of another robot that has a description."""
    out: Path = Path("motors.json")
    """File of the motors, JSON; replaced if there is one."""
    csv: Annotated[CsvCfg, tyro.conf.arg(name="")] = field(default_factory=CsvCfg)
    per: Literal["kind", "joint"] = "kind"
    """Whether hips, thighs and calves each have motors alike, or each joint its own."""
    fit_share: float = 0.5
    """Share of the log, from its beginning on, that is fitted; the rest is held out to judge."""
    timestep: float = 0.001
    """Longest physics step of the replay, s."""

    def __post_init__(self) -> None:
        if not 0.1 <= self.fit_share <= 0.9:
            raise RenetError(f"--fit-share must be from 0.1 to 0.9, got {self.fit_share:g}")
        if not 1e-4 <= self.timestep <= 0.01:
            raise RenetError(f"--timestep must be from 0.0001 to 0.01 s, got {self.timestep:g}")


def identify(cfg: IdentifyCfg) -> Path:
    """Fit motors to the first part of a log, judge them on the rest and write them; returns `out`.

    Raises:
        RenetError: The log cannot be used or is of another robot, the robot is unknown, or the file
            cannot be written.
    """
    description = _describe(cfg.robot)
    _check_out(cfg.out)
    log = read_motion_log(cfg.log, cfg.csv)
    _check_robot(description, log)
    robot = SuspendedRobot(description, log, cfg.timestep)
    fitted, held_out = _split(log, cfg.fit_share)
    _check_positions(robot, log)
    check_motion(log, fitted, valid_rows(robot, log))
    start = robot.described_motors
    if cfg.per == "kind":
        start = per_kind(start)
    _say(f"fitting {len(fitted) * log.period:.1f} s; each iteration replays them 13 times")
    fit = MotorFitter(robot, log, fitted, _say).fit(start)
    evidence = _evidence(cfg, log, robot, fit, (fitted, held_out))
    names = KINDS if cfg.per == "kind" else JOINTS
    motors = {}
    for name, values in zip(names, fit.motors, strict=True):
        motors[name] = MotorParameters(*(float(f"{value:.6g}") for value in values))
    write_motors(cfg.out, MotorFit(description.name, motors, evidence))
    _show(names, fit, evidence)
    return cfg.out


def _describe(name: str) -> Robot:
    """Find the description of a robot (see `look_up_robot`), also in other packages."""
    with suppress(RenetError):
        return look_up_robot(name)
    for group in (plug_ins.ROBOTS, plug_ins.TASKS):
        load_plug_ins(group)
    return look_up_robot(name)


def look_up_robot(name: str) -> Robot:
    """Find the description of a robot by its name or the name's last word, such as go2."""
    for description in robots().values():
        if name.lower() in (description.name.lower(), description.name.lower().split()[-1]):
            return description
    raise unknown_name("robot", name, robots())


def _check_robot(description: Robot, log: MotionLog) -> None:
    """Raise RenetError if a log is a recording of another robot that has a description."""
    try:
        recorded = look_up_robot(log.robot)
    except RenetError:
        # CSV files name no robot, and a simulated robot's driver is none of them.
        return
    if recorded.name != description.name:
        raise RenetError(f"the log is of a {recorded.name}, not of a {description.name}")


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _check_out(path: Path) -> None:
    """Raise RenetError if no file can be written at a path, before the fit takes its time."""
    if path.is_dir():
        raise RenetError(f"cannot write the motors {path}: it is a folder")
    folder = path.absolute().parent
    while not os.path.lexists(folder):
        folder = folder.parent
    if not folder.is_dir() or not os.access(folder, os.W_OK):
        raise RenetError(f"cannot write the motors {path}: nothing can be written to {folder}")


def _split(log: MotionLog, share: float) -> tuple[range, range]:
    """Split the rows of a log into those that are fitted and those that are held out."""
    middle = round(share * len(log))
    shortest = min(middle, len(log) - middle) * log.period
    if shortest < MIN_SECONDS:
        raise RenetError(
            f"the log has {log.seconds:.1f} s, of which {shortest:.1f} s are to be fitted or held "
            f"out: at least {MIN_SECONDS:g} s must be"
        )
    return range(middle), range(middle, len(log))


def _check_positions(robot: SuspendedRobot, log: MotionLog) -> None:
    """Raise RenetError if a joint is measured far beyond its limits."""
    low = log.position.min(axis=0)
    high = log.position.max(axis=0)
    for joint, least, most, lower, upper in zip(
        JOINTS, low, high, robot.lower, robot.upper, strict=True
    ):
        if least < lower - OUTSIDE or most > upper + OUTSIDE:
            raise RenetError(
                f"{joint} is measured from {least:.2f} to {most:.2f} rad, its limits are "
                f"{lower:.2f} and {upper:.2f}: are the log's angles in rad, and its joints in this "
                "order?"
            )


def _evidence(
    cfg: IdentifyCfg,
    log: MotionLog,
    robot: SuspendedRobot,
    fit: Fit,
    parts: tuple[range, range],
) -> dict[str, Any]:
    """Describe how the motors were measured, and how well they predict, as JSON values."""
    names = KINDS if cfg.per == "kind" else JOINTS
    rmse = {}
    for title, rows in zip(("fitted", "held_out"), parts, strict=True):
        replays = robot.replay([robot.described_motors, per_joint(fit.motors)], rows)
        errors = replays - log.position[rows.start : rows.stop]
        weight = valid_rows(robot, log)[rows.start : rows.stop]
        described_errors, measured_errors = errors
        rmse[title] = {
            "seconds": [round(rows.start * log.period, 3), round(rows.stop * log.period, 3)],
            "described": root_mean_squares(described_errors, weight, log.period),
            "measured": root_mean_squares(measured_errors, weight, log.period),
        }
    standard_errors = {}
    for name, values in zip(names, fit.standard_error, strict=True):
        known = zip(PARAMETERS, values, strict=True)
        standard_errors[name] = {
            parameter: None if math.isnan(value) else float(f"{value:.3g}")
            for parameter, value in known
        }
    return {
        "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "renet": code_version(),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "log": {
            "file": cfg.log.name,
            "sha256": log.sha256,
            "rows": len(log),
            "seconds": round(log.seconds, 3),
            "period_s": log.period,
        },
        "kp": log.stiffness.tolist(),
        "kd": log.damping.tolist(),
        "timestep_s": cfg.timestep,
        "iterations": fit.iterations,
        "rmse_rad": rmse,
        "standard_error": standard_errors,
    }


def root_mean_squares(errors: np.ndarray, weight: np.ndarray, period: float) -> dict[str, float]:
    """Compute root mean square errors in rad: of all joints, by kind, and within joint limits.

    Args:
        errors: Errors of a replay, [T, 12] rad.
        weight: True where a joint's motor can be compared, [T, 12] bool.
        period: Duration of a row, s.
    """
    square = errors[round(WARM_UP / period) :] ** 2
    weight = weight[round(WARM_UP / period) :]
    result = {"all": square.mean(), "within_limits": square[weight].mean()}
    for number, kind in enumerate(KINDS):
        result[kind] = square[:, number == KIND_INDEX].mean()
    return {name: round(math.sqrt(value), 5) for name, value in result.items()}


def _show(names: tuple[str, ...], fit: Fit, evidence: Mapping[str, Any]) -> None:
    """Print the motors with their standard errors, and what they are worth."""
    rows = []
    for name, values, errors in zip(names, fit.motors, fit.standard_error, strict=True):
        row = [name]
        for value, error, unit in zip(values, errors, PRINTED_UNITS, strict=True):
            uncertain = "at its least" if math.isnan(error) else f"± {unit * error:.2g}"
            row.append(f"{unit * value:.4g} {uncertain}")
        rows.append(row)
    show("Motors, with standard errors", HEADER, rows)
    rmse = evidence["rmse_rad"]["held_out"]
    print(
        f"RMSE of what was held out: {rmse['measured']['all']:.4f} rad, with the described motors "
        f"{rmse['described']['all']:.4f}; within the joints' limits "
        f"{rmse['measured']['within_limits']:.4f} and {rmse['described']['within_limits']:.4f}"
    )
