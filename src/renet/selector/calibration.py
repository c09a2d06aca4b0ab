"""Thresholds from healthy runs: the paper's maximum, or a stated rate of false alarms."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from renet.errors import RenetError
from renet.selector.monitors import MONITORS

TAIL = 0.02
"""Share of the highest scores to which a distribution's tail is fitted."""
ENOUGH = 20
"""Least number of peaks to fit a tail's shape to; with fewer it is taken as exponential."""
APART = 10
"""Least number of scores (1 s at 10 Hz) between two alarms: vision does not return earlier."""


def calibrate(scores: np.ndarray, false_alarm: float = 0.0) -> float:
    """Beta from the anomaly scores of successful episodes with healthy cameras.

    Args:
        scores: of any shape.
        false_alarm: 0 is the paper's rule, the largest score (RENet, Method B). Above 0, a new
            healthy score exceeds the result with at most this probability (split conformal): with
            n scores it is the one of rank ceil((n + 1)(1 - false_alarm)).

    Raises:
        RenetError: no scores, one that is not finite, or too few for so small a probability.
    """
    scores = np.sort(_checked(scores))
    if false_alarm == 0.0:
        return float(scores[-1])
    rank = math.ceil((len(scores) + 1) * (1.0 - false_alarm))
    if rank > len(scores):
        raise RenetError(
            f"a false-alarm probability of {false_alarm} needs at least"
            f" {math.ceil(1 / false_alarm) - 1} healthy scores, got {len(scores)}"
        )
    return float(scores[rank - 1])


def calibrate_monitors(
    scores: Mapping[str, Sequence[np.ndarray]],
    false_alarms_per_hour: float = 0.5,
    rate_hz: float = 10.0,
) -> tuple[dict[str, float], float]:
    """Thresholds at which healthy robots leave vision at most at the stated rate.

    One frame above a threshold is a false alarm, as the paper's filter is shorter than a frame. The
    rate is shared equally between the monitors whose scores vary.

    Args:
        scores: for each monitor one array [T] for each unbroken healthy run, T scores at `rate_hz`;
            the same runs for all monitors.
        false_alarms_per_hour: rate of all monitors together, above 0.
        rate_hz: scores per second.

    Returns:
        Thresholds by monitor name, and the robot hours that they are calibrated on.

    Raises:
        RenetError: no scores, or one that is not finite.
    """
    hours = sum(len(run) for run in next(iter(scores.values()))) / rate_hz / 3600.0
    varied = [name for name, runs in scores.items() if np.ptp(_checked(*runs)) > 0]
    share = false_alarms_per_hour / max(len(varied), 1)
    thresholds = {}
    for name, runs in scores.items():
        floor, ceiling = MONITORS[name].floor, MONITORS[name].ceiling
        # Scores that never vary, such as a simulated camera's holes, have no tail.
        if name in varied or floor > -math.inf:
            thresholds[name] = min(max(return_level(runs, share * hours), floor), ceiling)
    return thresholds, hours


def return_level(runs: Sequence[np.ndarray], expected: float) -> float:
    """The level that new runs of the same length are expected to exceed `expected` times.

    Peaks over threshold: the peaks of the clusters above a high quantile follow a generalised
    Pareto distribution (Pickands, Balkema and de Haan). Its shape is fitted by moments, and kept
    from -0.5 (a bounded tail, as of shares of an image) to 0 (an exponential one). As a margin for
    heavier tails, the level is at least the maximum plus the mean exceedance.

    Args:
        runs: [T] scores of each unbroken run.
        expected: number of exceedances, which may be below 1.
    """
    joined = _checked(*runs)
    high = float(np.quantile(joined, 1.0 - TAIL))
    excess = np.array([peak for run in runs for peak in decluster(run, high)]) - high
    if len(excess) == 0:
        return float(np.nextafter(joined.max(), np.inf))
    mean, ratio = float(excess.mean()), max(len(excess) / expected, 1.0)
    # Equal peaks, as of counts of equal images, have no variance.
    spread = max(float(excess.var()), 1e-9 * mean**2)
    shape = 0.5 * (1.0 - mean**2 / spread) if len(excess) >= ENOUGH else 0.0
    shape = float(np.clip(shape, -0.5, 0.0))
    scale = mean * (1.0 - shape)
    rise = scale * (math.log(ratio) if shape == 0.0 else (ratio**shape - 1.0) / shape)
    return max(high + rise, float(joined.max()) + mean)


def stale_above(staleness: np.ndarray, fell: np.ndarray, expected: np.ndarray) -> float:
    """The staleness of memory above which a robot falls less often with OP.

    Args:
        staleness: [n] expected map error in m, or seconds, of moments of walking from memory.
        fell: [n] bool, whether the robot fell in this moment.
        expected: [n] falls per moment with OP on the same ground.

    Returns:
        The level above which the falls exceed OP's by most; infinity where the excess is within two
        standard deviations of a Poisson count.
    """
    order = np.argsort(-staleness, kind="stable")
    falls, blind = np.cumsum(fell[order]), np.cumsum(expected[order])
    if len(falls) == 0:
        return math.inf
    surplus = falls - blind
    most = int(surplus.argmax())
    beyond_chance = surplus[most] > 2.0 * math.sqrt(max(blind[most], 1.0))
    return float(staleness[order][most]) if beyond_chance else math.inf


def decluster(run: np.ndarray, level: float) -> list[float]:
    """The peak of each group of exceedances of `level` that is APART scores from the next."""
    above = np.flatnonzero(np.asarray(run) > level)
    if len(above) == 0:
        return []
    groups = np.split(above, np.flatnonzero(np.diff(above) >= APART) + 1)
    return [float(np.asarray(run)[group].max()) for group in groups]


def _checked(*runs: np.ndarray) -> np.ndarray:
    """All scores of the runs, [n]; raises RenetError for none, or one that is not finite."""
    scores = np.concatenate([np.zeros(0), *map(np.ravel, runs)])
    if scores.size == 0 or not np.isfinite(scores).all():
        raise RenetError("calibration needs at least one score, all of them finite")
    return scores
