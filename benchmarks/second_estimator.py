"""What the second estimator adds: trainings with both, beside trainings of the vision one alone.

Robots of every training have one try at each ground in training's conditions: with a healthy
camera, with a fault half a second before the edge, and with a camera that is dead from the start.
Trainings of both estimators are walked as they ship (memory, then OP), by VP that is never handed
over, and by OP. Intervals are over trainings, so that at least two of each kind are needed.

python benchmarks/second_estimator.py --both BUNDLE... --vision-alone BUNDLE... [--json FILE]
takes three minutes for each bundle on two cores.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import scipy
import tyro

from facts import errors_in_one_line, report
from renet.bundle import find_bundle
from renet.errors import RenetError
from renet.evaluation.evaluator import Evaluator
from renet.evaluation.rollout import Trial, robot_numbers
from renet.evaluation.studies.grounds import NEAREST
from renet.evaluation.trace import Trace
from renet.faults import Injection
from renet.interface import CONTROL_DT, control_steps
from renet.selector.monitors import MONITORS
from renet.selector.selector import MonitorSelector

LEVELS: dict[str, int] = {
    "gap": 3,
    "platform": 4,
    "stairs_up": 6,
    "stairs_down": 6,
    "obstacles": 6,
}
"""Grounds and their levels, 1 to 10; a policy of 30 M steps crosses most of them."""
FAULTS = ("blackout", "gaussian", "frozen", "occlusion", "glare", "textureless")
"""Faults, all at severity 5."""
HEALTHY = "healthy"
DEAD = "dead from the start"
REMEMBERED = 2.0
"""Time without an image, s, in which a robot comes to the end of what it has seen."""
SECONDS = 12.0
"""Time for a try, s."""


@dataclass(frozen=True)
class Cfg:
    both: tuple[Path, ...]
    """Bundles of trainings with both estimators, calibrated."""
    vision_alone: tuple[Path, ...]
    """Bundles of trainings with `--agent.model.perception vp`, calibrated."""
    json: Path | None = None
    """File for the results."""
    robots: int = 40
    """Robots of each ground and camera."""
    speed: float = 0.6
    """Their speed, m/s."""
    seed: int = 1
    levels: dict[str, int] = field(default_factory=lambda: dict(LEVELS))
    """Level of each ground, 1 to 10."""


class NeverHandedOver(Evaluator):
    """Evaluator of VP that is never handed over; bad images are withheld from it as ever."""

    def make_selector(self, kind: str, num_robots: int) -> MonitorSelector:
        """Make a selector whose memory lasts for ever, and which no estimator's monitor ends."""
        spec = self.bundle.manifest.selector
        of_images = {}
        for name, limit in spec.used_thresholds.items():
            if MONITORS[name].of_image:
                of_images[name] = limit
        return MonitorSelector(of_images, spec, num_robots, longest_memory=math.inf)


def schedules(speed: float) -> dict[str, tuple[Injection, ...]]:
    """Faults of each camera, by its name.

    Args:
        speed: commanded speed, m/s.
    """
    edge = NEAREST / speed
    onset = control_steps(edge - 0.5)
    cameras: dict[str, tuple[Injection, ...]] = {HEALTHY: ()}
    for fault in FAULTS:
        cameras[fault] = (Injection.of(fault, 5, onset),)
    cameras[DEAD] = (Injection.of("blackout", 5, 0),)
    return cameras


def walk(evaluator: Evaluator, mode: str, cfg: Cfg) -> dict[str, Any]:
    """Walk one training in one mode.

    Returns:
        `crossed`, the share of robots by camera, and `falls_per_minute`, the rate of falls from
        `REMEMBERED` after a blackout on.
    """
    cameras = schedules(cfg.speed)
    trials = []
    for schedule in cameras.values():
        for ground in cfg.levels:
            trials += [Trial(mode, schedule, robot, ground) for robot in range(cfg.robots)]
    env = evaluator.make_env(cfg.levels, robot_numbers(trials), cfg.speed, cfg.seed)
    env.place_on([trial.ground for trial in trials])
    rollout = evaluator.rollout(env, trials, cfg.seed)
    steps = control_steps(SECONDS)
    trace = rollout.run(steps, f"{evaluator.bundle.name} {mode}", until_ended=1, retire=True)
    groups = dict(zip(cameras, trace.groups(len(cfg.levels) * cfg.robots), strict=True))
    crossed = {}
    for camera, group in groups.items():
        crossed[camera] = float(group.first_try()[0].mean())
    beyond = cameras["blackout"][0].onset + control_steps(REMEMBERED)
    return {
        "crossed": crossed,
        "falls_per_minute": falls_per_minute(groups["blackout"], beyond),
    }


def falls_per_minute(trace: Trace, start: int) -> float:
    """Falls of first tries in each minute of walking, from a control step on."""
    walks = trace.trying[start:]
    minutes = walks.sum() * CONTROL_DT / 60.0
    return float((walks & trace.fell[start:]).sum() / minutes) if minutes else math.nan


def mean_interval(values: Sequence[float]) -> dict[str, float]:
    """Mean of one number for each training, with Student's 95 % interval."""
    mean = float(np.mean(values))
    error = float(scipy.stats.sem(values))
    half = error * float(scipy.stats.t.ppf(0.975, len(values) - 1))
    return {"mean": mean, "low": mean - half, "high": mean + half}


def difference(first: Sequence[float], second: Sequence[float]) -> dict[str, float]:
    """Difference of the means of two kinds of trainings, with Welch's 95 % interval."""
    mean = float(np.mean(first) - np.mean(second))
    squares = [scipy.stats.sem(values) ** 2 for values in (first, second)]
    error = float(np.sqrt(sum(squares)))
    # Without any spread there is no interval.
    if error == 0.0:
        return {"mean": mean, "low": mean, "high": mean}
    # Welch and Satterthwaite's degrees of freedom.
    degrees = error**4 / (squares[0] ** 2 / (len(first) - 1) + squares[1] ** 2 / (len(second) - 1))
    half = error * float(scipy.stats.t.ppf(0.975, degrees))
    return {"mean": mean, "low": mean - half, "high": mean + half}


def summarise(results: Mapping[str, Sequence[Mapping[str, Any]]]) -> list[dict[str, Any]]:
    """Make one row for each measure: every kind of pilot's mean, and what OP adds.

    Args:
        results: results of `walk` for every training, by the kind of pilot.

    Returns:
        Rows with `measure`, one interval for each kind of pilot, and `adds`: the difference between
        trainings of both estimators, as they ship, and trainings of vision alone.
    """
    rows = []
    first = next(iter(results.values()))[0]
    for measure in (*first["crossed"], "falls_per_minute"):
        values = {}
        for pilot, runs in results.items():
            values[pilot] = [_value(run, measure) for run in runs]
        row: dict[str, Any] = {"measure": measure}
        row |= {pilot: mean_interval(numbers) for pilot, numbers in values.items()}
        row["adds"] = difference(values["both"], values["vision_alone"])
        rows.append(row)
    return rows


def _value(run: Mapping[str, Any], measure: str) -> float:
    """Return a measure of one walk: the share that crossed with a camera, or the rate of falls."""
    return run[measure] if measure == "falls_per_minute" else run["crossed"][measure]


def line(row: Mapping[str, Any]) -> str:
    """Format a row of `summarise` as a line of text."""
    cells = []
    for name, value in row.items():
        if name != "measure":
            cells.append(f"{name} {value['mean']:.3f} ({value['low']:.3f} to {value['high']:.3f})")
    return f"{row['measure']:<20} {', '.join(cells)}"


def main(cfg: Cfg) -> None:
    if min(len(cfg.both), len(cfg.vision_alone)) < 2:
        raise RenetError("intervals over trainings need two bundles of each kind at least")
    results: dict[str, list[dict[str, Any]]] = {}
    for path in map(find_bundle, cfg.both):
        results.setdefault("both", []).append(walk(Evaluator(path), "memory", cfg))
        results.setdefault("vp_of_both", []).append(walk(NeverHandedOver(path), "memory", cfg))
        results.setdefault("op_of_both", []).append(walk(Evaluator(path), "blind", cfg))
    for path in map(find_bundle, cfg.vision_alone):
        results.setdefault("vision_alone", []).append(walk(NeverHandedOver(path), "memory", cfg))
    rows = summarise(results)
    for row in rows:
        print(line(row))
    trainings = {"both": len(cfg.both), "vision_alone": len(cfg.vision_alone)}
    levels = {"levels": dict(cfg.levels), "robots": cfg.robots}
    report({"trainings": trainings, **levels, "rows": rows, "walks": results}, cfg.json)


if __name__ == "__main__":
    with errors_in_one_line():
        main(tyro.cli(Cfg, description=__doc__))
