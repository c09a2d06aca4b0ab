"""Measures of the study of single faults, of each robot and setting, with intervals and pairs.

Robots fall over obstacles with healthy cameras, too. Each robot of a fault's batch therefore has a
twin without the fault: same mode, body, start, camera and noise, bit for bit alike until the onset.
Differences are taken between twins, robot by robot.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from renet.evaluation import metrics
from renet.evaluation.results import grouped
from renet.evaluation.studies.fault_settings import Setting
from renet.evaluation.trace import Trace
from renet.faults import fault_class
from renet.interface import CONTROL_DT, STEPS_PER_TICK
from renet.terrain.tiles import TILE

SHARES = ("crossed", "upright")
TRAVELLED = 0.2
"""m from the onset on; below it energy per metre is not computed."""
Values = Mapping[str, Any]
"""A number for each robot, [N], by measure; NaN or None where it was not taken."""


def robot_measures(trace: Trace, onset: int, command: float, steps: int) -> dict[str, np.ndarray]:
    """Every measure of each robot, [N].

    Args:
        trace: of the run. onset: control step from which on they count.
        command: commanded speed, m/s. steps: of the longest run, whose rest a fallen robot lies.
    """
    crossed, fell, seconds = trace.first_try()
    # On endless ground, or towards a tile's corner, half a tile's width counts as crossed.
    crossed = crossed | (np.isnan(seconds) & (trace.travelled.max(axis=0) >= TILE / 2))
    since = np.arange(len(trace.ended))[:, None] >= onset
    walking = since & ~trace.over
    walked = walking.sum(axis=0)
    lying = np.where(fell, steps - onset - walked, 0)
    error = (np.abs(trace.forward_velocity - command) * walking).sum(0) + command * lying
    last = (~trace.over).sum(axis=0) - 1
    robots = np.arange(len(last))
    distance = trace.travelled[last, robots] - trace.travelled[onset - 1, robots]
    distance = np.where((walked > 0) & (distance >= TRAVELLED), distance, np.nan)
    changed = np.diff(trace.vision, axis=0, prepend=trace.vision[:1])
    with np.errstate(invalid="ignore"):
        return {
            "crossed": crossed.astype(float),
            "upright": (~fell).astype(float),
            "speed_error": error / (walked + lying),
            "energy_per_metre": (trace.power * walking).sum(0) * CONTROL_DT / distance,
            "collisions": (trace.collisions * walking).sum(0) / walked,
            "seconds_without_sight": (~trace.vision & walking).sum(0) * CONTROL_DT,
            "switches": (changed & walking).sum(0).astype(float),
        }


def estimates(values: Values, twins: Values) -> dict[str, dict[str, Any]]:
    """Each measure's mean over the robots and its mean change from their twins, with intervals."""
    rows = {}
    for name in values:
        faulty, healthy = (np.array(part[name], float) for part in (values, twins))
        interval = metrics.share_interval if name in SHARES else metrics.bootstrap_interval
        change = _mean(faulty - healthy, metrics.bootstrap_interval)
        rows[name] = _mean(faulty, interval) | {"change": change}
    return rows


def _mean(values: np.ndarray, interval: Any) -> dict[str, Any]:
    """Mean and interval of the values there are; None where there are none."""
    values = values[~np.isnan(values)]
    if not len(values):
        return {"value": None, "ci95": None}
    return {"value": float(values.mean()), "ci95": list(interval(values))}


def by_robot(runs: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, dict[str, np.ndarray]]]:
    """Each robot's mean over the settings, [N], by mode, ground and share.

    The same robots stand in all settings: an interval of a mean over settings is one over robots.
    """
    means: dict[str, dict[str, dict[str, np.ndarray]]] = {}
    for (mode, ground), rows in grouped(runs, "mode", "ground").items():
        means.setdefault(mode, {})[ground] = {
            name: np.mean([row["values"][name] for row in rows], axis=0) for name in SHARES
        }
    return means


def pair_counts(values: Values, twins: Values) -> dict[str, int]:
    """Robots that fell while their twins did not, and the other way round."""
    fell, calm = (1 - np.array(part["upright"], float) > 0 for part in (values, twins))
    by_fault, spared = int((fell & ~calm).sum()), int((calm & ~fell).sum())
    return {"falls_by_fault": by_fault, "falls_spared": spared}


def beside_op(values: Values, op: Values | None) -> dict[str, Any]:
    """Gain in survival of robots in mode memory over the same robots blind; None without these."""
    if op is None:
        return dict.fromkeys(("over_op", "over_op_ci95_low", "over_op_ci95_high"))
    gain = np.array(values["upright"], float) - np.array(op["upright"], float)
    return {"over_op": float(gain.mean()), **metrics.with_interval("over_op", gain)}


def end_of(setting: Setting, over: int) -> int:
    """The control step at which a fault is over: by itself, or because the study ends it."""
    lasts = fault_class(setting.fault).lasts(setting.level)
    return over if np.isinf(lasts) else min(over, setting.step + round(lasts / CONTROL_DT))


def survival(trace: Trace, until: int) -> dict[str, Any]:
    """Falls, and the mean speed over the 3 s before control step `until`, with intervals.

    A fallen robot counts with zero, one that has left its tile until then.
    """
    upright, last = ~trace.fallen[-1], slice(max(until - round(3.0 / CONTROL_DT), 0), until)
    counted = (~trace.over | trace.fallen)[last]
    walked = counted.any(axis=0)
    speed = trace.speed[last][:, walked].mean(axis=0, where=counted[:, walked])
    return {
        "robots": len(upright),
        "falls": int((~upright).sum()),
        "survival": float(upright.mean()),
        **metrics.with_share_interval("survival", upright),
        "mean_forward_velocity": float(speed.mean()) if len(speed) else math.nan,
        **metrics.with_interval("velocity", speed),
    }


def noticing(trace: Trace, paper: np.ndarray, onset: int, end: int) -> dict[str, Any]:
    """Who noticed the fault, who saw again after it, and how soon.

    Who notices ceases to see: its images are withheld, or OP takes over. A fault that is noticed
    only after it is over, or after the robot fell, was missed; one that comes while a robot does
    not see can be neither noticed nor missed: `vision_active_at_onset` counts those who see.

    Args:
        trace: of robots under one fault. paper: [T, U, N] bool, the paper's selector trusts vision.
        onset: control step at which the fault begins. end: the one at which it is over.
    """
    sees, over = trace.sees, trace.over
    # A last image from before the end is judged until the next tick.
    until = end + STEPS_PER_TICK
    delay = departure(sees, over, onset, until)
    active = sees[onset - 1, -1] & ~over[onset - 1]
    by_paper = np.where(active, departure(paper, over, onset, until), np.nan)
    back = departure(~sees, over, end)
    return {
        "vision_active_at_onset": int(active.sum()),
        "detected": int((~np.isnan(delay)).sum()),
        "detection_delay_s": _quantile(delay, 0.5),
        "detection_delay_p95_s": _quantile(delay, 0.95),
        **metrics.with_interval("detection_delay", delay, np.median),
        "detected_by_paper": int((~np.isnan(by_paper)).sum()),
        "paper_detection_delay_s": _quantile(by_paper, 0.5),
        "away_at_end": int((~sees[end - 1, -1] & ~over[end - 1]).sum()),
        "recovered": int((~np.isnan(back)).sum()),
        "recovery_delay_s": _quantile(back, 0.5),
        "recovery_delay_p95_s": _quantile(back, 0.95),
    }


def departure(
    trusted: np.ndarray, gone: np.ndarray, start: int, end: int | None = None
) -> np.ndarray:
    """Seconds from a control step until the selector first stops trusting vision.

    Of `~trusted` it is the delay of the return to vision. A robot that starts anew after a fall
    trusts vision, which is no return.

    Args:
        trusted: [T, U, N] bool. gone: [T, N] bool, fallen or across.
        start: control step. end: the one from which on departures do not count.

    Returns:
        [N]; NaN where it had left vision before `start`, or has not when it is gone or at `end`.
    """
    if start >= len(trusted):
        return np.full(trusted.shape[-1], np.nan)
    delay = metrics.switch_delay(trusted, start, end)
    left = np.where(gone.any(axis=0), gone.argmax(axis=0) - start + 1, np.inf) * CONTROL_DT
    return np.where(trusted[start - 1, -1] & (delay <= left), delay, np.nan)


def _quantile(values: np.ndarray, share: float) -> float | None:
    """A quantile of the values [N] there are; None where there are none."""
    values = values[~np.isnan(values)]
    return float(np.quantile(values, share)) if len(values) else None
