"""What the fault benchmark measures of one setting: survival, detection, return, separability."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from renet.evaluation import metrics
from renet.evaluation.trace import Trace
from renet.faults import fault_class
from renet.interface import CONTROL_DT, STEPS_PER_TICK

ROC_POINTS = 60
"""Points kept of a curve."""


@dataclass(frozen=True)
class Batch:
    """One fault's rollout and what the probe recorded."""

    trace: Trace
    paper: np.ndarray
    """[T, U, N] bool: vision trusted by the paper's selector."""
    reconstruction: np.ndarray
    """[ticks, N] the reconstruction score."""
    monitors: np.ndarray
    """[ticks, N] the whole set's score; see `monitor_log.combined_score`."""
    onset: int
    """Control step at which the fault begins."""
    over: int
    """Control step at which every fault has ended."""


def end_of(fault: str, severity: int, onset: int, over: int) -> int:
    """The control step at which a fault is over: by itself, or because the study ends it."""
    model = fault_class(fault)
    lasts = model.lasts(model.level_of(severity))
    return over if np.isinf(lasts) else min(over, onset + round(lasts / CONTROL_DT))


def measure(batch: Batch, rows: slice, fault: str, severity: int) -> dict[str, Any]:
    """The measured half of one row of the summary.

    A fault that is noticed only after it is over, or after the robot fell, was missed; one that
    comes while vision is not trusted can be neither noticed nor missed: `vision_active_at_onset`
    counts the robots that trusted vision.
    """
    trace, end = batch.trace, end_of(fault, severity, batch.onset, batch.over)
    upright = ~trace.fallen[-1, rows]
    # A last image from before the end is judged until the next tick.
    until = end + STEPS_PER_TICK
    delay = detection(trace.trusted[:, :, rows], trace.fallen[:, rows], batch.onset, until)
    vision_active_at_onset = ~away(trace.trusted[:, :, rows], trace.fallen[:, rows], batch.onset)
    vision_active_at_onset &= ~trace.fallen[batch.onset - 1, rows]
    paper = detection(batch.paper[:, :, rows], trace.fallen[:, rows], batch.onset, until)
    paper[~vision_active_at_onset] = np.nan
    back = recovery(trace.trusted[:, :, rows], trace.fallen[:, rows], end)
    speed = trace.speed[: batch.over, rows]
    return {
        "robots": len(upright),
        "falls": int((~upright).sum()),
        "survival": float(upright.mean()),
        **metrics.with_interval("survival", upright),
        "mean_forward_velocity": metrics.mean_forward_velocity(speed),
        **metrics.with_interval("velocity", speed[metrics.window(3.0)].mean(axis=0)),
        "distance": float(trace.speed[:, rows].sum(axis=0).mean() * CONTROL_DT),
        "collisions": float(trace.collisions[batch.onset :, rows].mean()),
        "vision_active_at_onset": int(vision_active_at_onset.sum()),
        "detected": int((~np.isnan(delay)).sum()),
        **_delays("detection_delay", delay),
        "detected_by_paper": int((~np.isnan(paper)).sum()),
        "paper_detection_delay_s": _delays("paper", paper)["paper_s"],
        "away_at_end": int(
            (~trace.trusted[end - 1, -1, rows] & ~trace.fallen[end - 1, rows]).sum()
        ),
        "recovered": int((~np.isnan(back)).sum()),
        "recovery_delay_s": _delays("back", back)["back_s"],
        "recovery_delay_p95_s": _delays("back", back)["back_p95_s"],
    }


def detection(trusted: np.ndarray, fallen: np.ndarray, onset: int, end: int) -> np.ndarray:
    """[N] seconds from the onset to the selector's departure from vision.

    NaN where it missed the fault, or had left before.

    Args:
        trusted: [T, U, N] bool. fallen: [T, N] bool. onset, end: control steps.
    """
    delay = metrics.switch_delay(trusted, onset, end)
    return np.where(trusted[onset - 1, -1], _upright(delay, fallen, onset), np.nan)


def recovery(trusted: np.ndarray, fallen: np.ndarray, over: int) -> np.ndarray:
    """[N] seconds from the end of a fault to the return to vision.

    NaN where vision was not left, or the robot fell first: one that starts anew trusts vision.

    Args:
        trusted: [T, U, N] bool. fallen: [T, N] bool. over: control step.
    """
    if over >= len(trusted):
        return np.full(trusted.shape[-1], np.nan)
    delay = _upright(metrics.recovery_delay(trusted, over), fallen, over)
    return np.where(away(trusted, fallen, over), delay, np.nan)


def _upright(delay: np.ndarray, fallen: np.ndarray, start: int) -> np.ndarray:
    """`delay` [N] s from the control step `start`; NaN where the robot fell before it was over."""
    fall = np.where(fallen.any(axis=0), fallen.argmax(axis=0) - start + 1, np.inf) * CONTROL_DT
    return np.where(delay <= fall, delay, np.nan)


def away(trusted: np.ndarray, fallen: np.ndarray, over: int) -> np.ndarray:
    """[N] bool: on its feet and without vision just before a control step; see `recovery`."""
    return ~trusted[over - 1, -1] & ~fallen[over - 1]


def _delays(name: str, delay: np.ndarray) -> dict[str, float | None]:
    """Median with its interval, and 95th percentile, of the delays there are."""
    found = delay[~np.isnan(delay)]
    known = len(found) > 0
    low, high = metrics.bootstrap_interval(found, np.median)
    return {
        f"{name}_s": float(np.median(found)) if known else None,
        f"{name}_p95_s": float(np.quantile(found, 0.95)) if known else None,
        f"{name}_ci95_low": low if known else None,
        f"{name}_ci95_high": high if known else None,
    }


def separability(batch: Batch, rows: slice, fault: str, severity: int) -> dict[str, Any]:
    """How well a threshold on a score could tell frames of before the onset from frames after.

    Returns:
        The area under the curve and the curve itself, [false, true] positive rates, for the
        reconstruction score alone and for the whole set; frames after a fall do not count.
    """
    end = end_of(fault, severity, batch.onset, batch.over)
    first, last = batch.onset // STEPS_PER_TICK, -(-end // STEPS_PER_TICK)
    counts = ~batch.trace.fallen[::STEPS_PER_TICK, rows]
    found: dict[str, Any] = {"severity": severity}
    for name, scores in (("reconstruction", batch.reconstruction), ("monitors", batch.monitors)):
        before = scores[:first, rows][counts[:first]]
        after = scores[first:last, rows][counts[first:last]]
        false, true, area = metrics.roc(before, after)
        keep = np.unique(np.linspace(0, len(false) - 1, ROC_POINTS).round().astype(int))
        found[f"auc_{name}"] = area
        found[name] = [false[keep].round(4), true[keep].round(4)]
    return found
