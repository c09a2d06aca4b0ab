"""Measures of the study of single faults, of each robot and setting, with intervals and pairs.

Robots fall over obstacles with healthy cameras, too. Each robot of a fault's batch therefore has a
twin without the fault: same mode, body, start, camera and noise, bit for bit equal until the onset.
Differences are taken between twins, robot by robot.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from renet.evaluation import metrics
from renet.evaluation.results import group_by
from renet.evaluation.studies.fault_settings import Setting
from renet.evaluation.trace import Trace
from renet.faults import fault_class
from renet.interface import CONTROL_DT, STEPS_PER_TICK, control_steps
from renet.terrain.tiles import TILE

_SHARES = ("crossed", "upright")
"""Measures that are 0 or 1 for each robot."""
_SHORTEST_WALK = 0.2
"""Distance from the onset on below which energy per metre is not computed, m."""
Values = Mapping[str, Any]
"""Number for each robot, [N], by measure; NaN or None where it was not measured."""


def robot_measures(trace: Trace, onset: int, command: float, steps: int) -> dict[str, np.ndarray]:
    """Measure each robot, [N] each, by name.

    Args:
        trace: Trace of the run.
        onset: Control step from which on robots are measured.
        command: Commanded speed, m/s.
        steps: Length of the longest run; a fallen robot counts as lying until then.
    """
    crossed, fell, seconds = trace.first_try()
    # On endless ground, or towards a tile's corner, half a tile's width counts as crossed.
    crossed = crossed | (np.isnan(seconds) & (trace.travelled.max(axis=0) >= TILE / 2))
    # [T, N] bool: steps from the onset on in which the first try goes on.
    since = np.arange(len(trace.ended))[:, None] >= onset
    walking = since & ~trace.over
    walked = walking.sum(axis=0)
    lying = np.where(fell, steps - onset - walked, 0)
    error = (np.abs(trace.forward_velocity - command) * walking).sum(0) + command * lying
    # Distance from the onset to the last step of the first try.
    last = (~trace.over).sum(axis=0) - 1
    robots = np.arange(len(last))
    distance = trace.travelled[last, robots] - trace.travelled[onset - 1, robots]
    distance = np.where((walked > 0) & (distance >= _SHORTEST_WALK), distance, np.nan)
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
    """Average each measure over robots, and its change from their twins, with intervals."""
    rows = {}
    for name in values:
        faulty = np.array(values[name], float)
        healthy = np.array(twins[name], float)
        interval = metrics.share_interval if name in _SHARES else metrics.bootstrap_interval
        change = _mean(faulty - healthy, metrics.bootstrap_interval)
        rows[name] = _mean(faulty, interval) | {"change": change}
    return rows


def _mean(values: np.ndarray, interval: Any) -> dict[str, Any]:
    """Return mean and interval of the values that are not NaN; None if all are."""
    values = values[~np.isnan(values)]
    if not len(values):
        return {"value": None, "ci95": None}
    return {"value": float(values.mean()), "ci95": list(interval(values))}


def by_robot(runs: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, dict[str, np.ndarray]]]:
    """Average each robot over the settings, [N], by mode, ground and share.

    The same robots are in all settings, so that an interval of a mean over settings is one over
    robots.
    """
    means: dict[str, dict[str, dict[str, np.ndarray]]] = {}
    for (mode, ground), rows in group_by(runs, "mode", "ground").items():
        shares = {}
        for name in _SHARES:
            shares[name] = np.mean([row["values"][name] for row in rows], axis=0)
        means.setdefault(mode, {})[ground] = shares
    return means


def pair_counts(values: Values, twins: Values) -> dict[str, int]:
    """Count robots that fell while their twins did not, and the other way round."""
    fell = 1 - np.array(values["upright"], float) > 0
    twin_fell = 1 - np.array(twins["upright"], float) > 0
    return {
        "falls_by_fault": int((fell & ~twin_fell).sum()),
        "falls_spared": int((twin_fell & ~fell).sum()),
    }


def beside_op(values: Values, op: Values | None) -> dict[str, Any]:
    """Return memory's gain in survival over mode blind, by robot; None without mode blind."""
    if op is None:
        return dict.fromkeys(("over_op", "over_op_ci95_low", "over_op_ci95_high"))
    gain = np.array(values["upright"], float) - np.array(op["upright"], float)
    return metrics.mean_columns("over_op", gain)


def end_of(setting: Setting, over: int) -> int:
    """Return the control step at which a fault ends: at its own end, or at the study's, `over`."""
    lasts = fault_class(setting.fault).lasts(setting.level)
    return over if np.isinf(lasts) else min(over, setting.step + control_steps(lasts))


def survival(trace: Trace, until: int) -> dict[str, Any]:
    """Measure falls, and the mean speed over the 3 s before control step `until`, with intervals.

    A fallen robot counts with a speed of zero; one that has left its tile counts until then.
    """
    upright = ~trace.fallen[-1]
    last = slice(max(until - control_steps(3.0), 0), until)
    # [steps, N] bool: steps that count.
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
    """Measure how many robots notice a fault and see again after it, and how fast.

    A robot that notices the fault stops seeing: its images are withheld, or OP takes over. A fault
    that is noticed only after its end, or after the robot's fall, is missed. A robot that does not
    see at the onset can neither notice nor miss the fault; `vision_active_at_onset` counts those
    that see.

    Args:
        trace: Trace of robots under one fault.
        paper: True where the paper's selector trusts vision, [T, U, N] bool.
        onset: Control step at which the fault begins.
        end: Control step at which it is over.
    """
    sees = trace.sees
    over = trace.over
    # The last image from before the end is judged until the next tick.
    until = end + STEPS_PER_TICK
    delay = departure(sees, over, onset, until)
    active = sees[onset - 1, -1] & ~over[onset - 1]
    # The paper's selector is compared on the robots that can notice the fault.
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
    """Measure the time from a control step until the selector first stops trusting vision.

    For `~trusted` it is the delay of the return to vision. A robot that is put back at its start
    after a fall trusts vision, which is no return.

    Args:
        trusted: True where vision is trusted, [T, U, N] bool.
        gone: True where the first try is over, [T, N] bool.
        start: Control step from which on time counts.
        end: Control step from which on departures do not count.

    Returns:
        [N] s; NaN where vision was not trusted before `start`, or is still trusted at `end` or at
        the end of the first try.
    """
    if start >= len(trusted):
        return np.full(trusted.shape[-1], np.nan)
    delay = metrics.switch_delay(trusted, start, end)
    left = np.where(gone.any(axis=0), gone.argmax(axis=0) - start + 1, np.inf) * CONTROL_DT
    return np.where(trusted[start - 1, -1] & (delay <= left), delay, np.nan)


def _quantile(values: np.ndarray, share: float) -> float | None:
    """Return the quantile of the values [N] that are not NaN; None if all are."""
    values = values[~np.isnan(values)]
    return float(np.quantile(values, share)) if len(values) else None
