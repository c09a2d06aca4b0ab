"""Thresholds from healthy runs: the paper's maximum, or a rate of false alarms."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from renet.errors import RenetError
from renet.selector.monitors import MONITORS

TAIL = 0.02
"""Share of the highest scores to which a distribution's tail is fitted."""
FEWEST_PEAKS = 20
"""Smallest number of peaks from which the shape of a tail is fitted; with fewer it is
exponential."""
APART = 10
"""Smallest number of scores between two alarms (1 s at 10 Hz): vision does not return earlier."""
LEFT_OUT = 0.6
"""Largest share of the allowed false alarms that runs may take which are left out."""


def calibrate(scores: np.ndarray, false_alarm: float = 0.0) -> float:
    """Compute beta from the anomaly scores of successful episodes with healthy cameras.

    Args:
        scores: Scores, of any shape.
        false_alarm: Largest probability that a new healthy score exceeds beta (split conformal
            prediction): of n scores, beta is the one of rank ceil((n + 1)(1 - false_alarm)). 0 is
            the paper's rule, the largest score (RENet, Method B).

    Raises:
        RenetError: There are no scores, one is not finite, or there are too few for the
            probability.
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


class Calibration(NamedTuple):
    """Thresholds from healthy runs, and what they rest on."""

    thresholds: dict[str, float]
    """Thresholds by the monitors' names."""
    hours: float
    """Duration of the runs, robot hours."""
    left_out: int
    """Number of odd runs that were left out."""


def calibrate_monitors(
    scores: Mapping[str, Sequence[np.ndarray]],
    false_alarms_per_hour: float = 0.5,
    rate_hz: float = 10.0,
) -> Calibration:
    """Compute thresholds at which healthy robots leave vision at most at a given rate.

    A frame above a threshold is a false alarm, because the paper's filter is shorter than a frame;
    some monitors need several in a row. The rate is divided equally among the monitors whose scores
    vary. In a long calibration single runs may be left out: a robot whose camera comes to within
    centimetres of an edge has scores far above those of all others, and thresholds above them
    notice no fault. The alarms in such runs count as false, and the others share what remains of
    the rate.

    Args:
        scores: Scores of healthy runs by monitor: for each continuous run an array [T]. All
            monitors have the same runs.
        false_alarms_per_hour: Rate of all monitors together, above 0.
        rate_hz: Number of scores per second.

    Raises:
        RenetError: There are no scores, or one is not finite.
    """
    runs = list(next(iter(scores.values())))
    hours = sum(map(len, runs)) / rate_hz / 3600.0
    allowed = false_alarms_per_hour * hours
    scales: dict[str, float] = {}
    sequences: dict[str, Sequence[np.ndarray]] = {}
    for name, own in scores.items():
        joined = _checked(*own)
        scales[name] = float(joined.std()) if np.ptp(joined) > 0.0 else 0.0
        sequences[name] = [lowest_in_a_row(run, MONITORS[name].in_a_row) for run in own]

    best = Calibration(_thresholds(sequences, scales, allowed), hours, 0)
    odd: list[dict[str, np.ndarray]] = []
    for left_out in range(1, min(int(LEFT_OUT * allowed) + 1, len(runs))):
        number = _worst_run(sequences, scales, allowed)
        odd.append({name: own[number] for name, own in sequences.items()})
        sequences = _without(sequences, number)
        # Each of these runs has an alarm; whether it has more depends on the thresholds.
        thresholds = _thresholds(sequences, scales, allowed - left_out)
        spent = max(sum(_alarms(run, thresholds) for run in odd), left_out)
        if spent > LEFT_OUT * allowed:
            break
        thresholds = _thresholds(sequences, scales, allowed - spent)
        if _difference(best.thresholds, thresholds, scales) > 0.0:
            best = Calibration(thresholds, hours, left_out)
    return best


def _thresholds(
    sequences: Mapping[str, Sequence[np.ndarray]], scales: Mapping[str, float], allowed: float
) -> dict[str, float]:
    """Compute thresholds by monitor for a number of false alarms of all monitors together.

    Args:
        sequences: Lowest scores in a row of each run, [T], by monitor.
        scales: Standard deviation of the scores, by monitor; 0 for scores that never vary.
        allowed: Number of false alarms.
    """
    share = allowed / max(sum(scale > 0.0 for scale in scales.values()), 1)
    thresholds = {}
    for name, runs in sequences.items():
        monitor = MONITORS[name]
        # Scores that never vary, such as a simulated camera's holes, have no tail. Their threshold
        # is the monitor's floor, if it has one.
        if scales[name] > 0.0 or monitor.floor > -math.inf:
            level = max(return_level(runs, share), monitor.floor)
            thresholds[name] = min(level, monitor.ceiling)
    return thresholds


def _worst_run(
    sequences: Mapping[str, Sequence[np.ndarray]], scales: Mapping[str, float], allowed: float
) -> int:
    """Return the run without which thresholds fall most; arguments as of `_thresholds`."""
    thresholds = _thresholds(sequences, scales, allowed)
    falls = {}
    # Only a run with the highest score of a monitor can set its threshold.
    for number in {_highest_run(runs) for runs in sequences.values()}:
        others = _thresholds(_without(sequences, number), scales, allowed)
        falls[number] = _difference(thresholds, others, scales)
    return max(falls, key=falls.__getitem__)


def _without(
    sequences: Mapping[str, Sequence[np.ndarray]], number: int
) -> dict[str, Sequence[np.ndarray]]:
    """Return the scores by monitor without one of the runs."""
    others: dict[str, Sequence[np.ndarray]] = {}
    for name, runs in sequences.items():
        others[name] = [*runs[:number], *runs[number + 1 :]]
    return others


def _alarms(run: Mapping[str, np.ndarray], thresholds: Mapping[str, float]) -> int:
    """Count the alarms of all monitors in a run; those of several at a time are one."""
    above = np.zeros(max(map(len, run.values())))
    for name, threshold in thresholds.items():
        sequence = run[name]
        above[: len(sequence)] += sequence > threshold
    return len(decluster(above, 0.0))


def _highest_run(runs: Sequence[np.ndarray]) -> int:
    """Return the number of the run with the highest score."""
    return int(np.argmax([run.max(initial=-math.inf) for run in runs]))


def _difference(
    first: Mapping[str, float], second: Mapping[str, float], scales: Mapping[str, float]
) -> float:
    """Sum up by how many standard deviations thresholds differ."""
    varied = [name for name in first if scales[name] > 0.0]
    return sum((first[name] - second[name]) / scales[name] for name in varied)


def lowest_in_a_row(run: np.ndarray, count: int) -> np.ndarray:
    """Return the lowest of each `count` scores in a row, [T - count + 1] of a run of T scores."""
    if len(run) < count:
        return run[:0]
    return np.lib.stride_tricks.sliding_window_view(run, count).min(axis=-1)


def return_level(runs: Sequence[np.ndarray], expected: float) -> float:
    """Compute the level that new runs of the same length are expected to exceed `expected` times.

    The method is peaks over threshold: peaks of the clusters above a high quantile follow a
    generalised Pareto distribution (Pickands, Balkema and de Haan). Its shape is fitted by moments,
    and limited to the range from -0.5 (a bounded tail, such as that of shares of an image) to 0 (an
    exponential one). As a margin for heavier tails, the level is at least the maximum plus the mean
    exceedance.

    Args:
        runs: Scores of each continuous run, [T].
        expected: Number of exceedances, which may be below 1.
    """
    # Exceedances of a high quantile, one for each cluster.
    joined = _checked(*runs)
    high = float(np.quantile(joined, 1.0 - TAIL))
    peaks: list[float] = []
    for run in runs:
        peaks += decluster(run, high)
    excess = np.array(peaks) - high
    if len(excess) == 0:
        return float(np.nextafter(joined.max(), np.inf))

    # Shape and scale by moments. Equal peaks, as of counts of equal images, have no variance.
    mean = float(excess.mean())
    spread = max(float(excess.var()), 1e-9 * mean**2)
    shape = 0.5 * (1.0 - mean**2 / spread) if len(excess) >= FEWEST_PEAKS else 0.0
    shape = float(np.clip(shape, -0.5, 0.0))
    scale = mean * (1.0 - shape)

    # Level that a peak exceeds with probability 1 / ratio.
    ratio = max(len(excess) / expected, 1.0)
    rise = scale * (math.log(ratio) if shape == 0.0 else (ratio**shape - 1.0) / shape)
    return max(high + rise, float(joined.max()) + mean)


def stale_above(staleness: np.ndarray, fell: np.ndarray, expected: np.ndarray) -> float:
    """Find the staleness of memory above which a robot falls less often with OP.

    Args:
        staleness: Expected error of the map, m, or age of the last image, s, at moments of walking
            from memory, [M].
        fell: True where the robot fell at this moment, [M] bool.
        expected: Falls per moment with OP on the same ground, [M].

    Returns:
        The staleness above which falls exceed those of OP by the largest number. It is infinite if
        this number is within two standard deviations of a Poisson count.
    """
    # Falls with memory and with OP at all moments that are at least as stale.
    order = np.argsort(-staleness, kind="stable")
    stalest_first = staleness[order]
    falls = np.cumsum(fell[order])
    blind = np.cumsum(expected[order])
    if len(falls) == 0:
        return math.inf
    # Moments that are as stale as each other count together, whatever their order.
    is_last = np.append(stalest_first[1:] < stalest_first[:-1], True)
    surplus = np.where(is_last, falls - blind, -np.inf)
    most = int(surplus.argmax())
    beyond_chance = surplus[most] > 2.0 * math.sqrt(max(blind[most], 1.0))
    return float(stalest_first[most]) if beyond_chance else math.inf


def decluster(run: np.ndarray, level: float) -> list[float]:
    """Return the peak of each cluster of scores above `level`; clusters are APART scores apart.

    Args:
        run: Scores of a continuous run, [T].
        level: Level to exceed.
    """
    above = np.flatnonzero(np.asarray(run) > level)
    if len(above) == 0:
        return []
    groups = np.split(above, np.flatnonzero(np.diff(above) >= APART) + 1)
    return [float(np.asarray(run)[group].max()) for group in groups]


def _checked(*runs: np.ndarray) -> np.ndarray:
    """Join the scores of all runs, [M]; raises RenetError for none, or one that is not finite."""
    scores = np.concatenate([np.zeros(0), *map(np.ravel, runs)])
    if scores.size == 0 or not np.isfinite(scores).all():
        raise RenetError("calibration needs at least one score, all of them finite")
    return scores
