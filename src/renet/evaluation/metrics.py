"""Measures: pure functions of per-step arrays, [T, N] for T control steps and N robots."""

from collections.abc import Callable

import numpy as np
import scipy

from renet.interface import CONTROL_DT


def switch_delay(vision: np.ndarray, start: int, end: int | None = None) -> np.ndarray:
    """Compute the time from the control step `start` until a selector first leaves vision.

    Args:
        vision: True where vision is trusted after each of a step's U updates, [T, U, N] bool.
        start: Control step at which the fault begins, 1 or later.
        end: Control step at which it is over; later switches do not count.

    Returns:
        [N] s, a multiple of the update period; 0 where vision was not trusted before `start`, NaN
        where it stayed trusted.
    """
    # [steps * U, N], update by update.
    blind = ~vision[start:end].reshape(-1, vision.shape[2])
    delay = (blind.argmax(axis=0) + 1) * (CONTROL_DT / vision.shape[1])
    delay = np.where(blind.any(axis=0), delay, np.nan)
    return np.where(vision[start - 1, -1], delay, 0.0)


def false_switches(vision: np.ndarray, failing: np.ndarray) -> int:
    """Count how often robots left vision, [T, U, N] bool, while not `failing`, [T, N]."""
    flat = vision.reshape(-1, vision.shape[2])
    healthy = ~np.repeat(failing, vision.shape[1], axis=0)
    # Vision was trusted at one update and not at the next.
    return int((flat[:-1] & ~flat[1:] & healthy[1:]).sum())


def healthy_hours(failing: np.ndarray) -> float:
    """Compute the robot hours with a healthy camera, from `failing` [T, N]."""
    return float((~failing).sum()) * CONTROL_DT / 3600


def bootstrap_interval(
    values: np.ndarray, statistic: Callable[..., np.ndarray] = np.mean
) -> tuple[float, float]:
    """Compute a statistic's 95 % percentile bootstrap interval from 2,000 resamples.

    It has no width for a single value, and is NaN without any.

    Args:
        values: One independent number for each robot, [n]; NaNs are left out.
        statistic: Takes an array and `axis`.
    """
    values = np.asarray(values, float)
    values = values[~np.isnan(values)]
    if len(values) < 2:
        only = float(statistic(values)) if len(values) else float("nan")
        return only, only
    options = {"n_resamples": 2000, "method": "percentile", "rng": 0}
    interval = scipy.stats.bootstrap((values,), statistic, **options).confidence_interval
    return float(interval.low), float(interval.high)


def share_interval(successes: np.ndarray) -> tuple[float, float]:
    """Compute Clopper and Pearson's 95 % interval of a share, from 0 or 1 for each robot [n].

    There must be at least one robot. The interval is exact: it covers the true share at least 95 %
    of the time, however few robots there are. Unlike a bootstrap interval, it has a width even if
    all robots succeed or all fail.
    """
    test = scipy.stats.binomtest(int(successes.sum()), len(successes))
    low, high = test.proportion_ci(0.95, "exact")
    return float(low), float(high)


def share_columns(name: str, successes: np.ndarray) -> dict[str, float]:
    """Return a share with its `share_interval`, as columns of a summary's row.

    Args:
        name: Beginning of the columns' names: NAME_rate, NAME_ci95_low and NAME_ci95_high.
        successes: 0 or 1 for each robot, [n]; n > 0.
    """
    return {f"{name}_rate": float(successes.mean()), **with_share_interval(name, successes)}


def mean_columns(name: str, values: np.ndarray) -> dict[str, float]:
    """Return a mean with its `bootstrap_interval`, as columns of a summary's row.

    Args:
        name: Beginning of the columns' names: NAME, NAME_ci95_low and NAME_ci95_high.
        values: One number for each robot, [n].
    """
    return {name: float(values.mean()), **with_interval(name, values)}


def with_share_interval(name: str, successes: np.ndarray) -> dict[str, float]:
    """Return the `share_interval` of 0 or 1 for each robot [n], as columns of a summary's row."""
    low, high = share_interval(successes)
    return {f"{name}_ci95_low": low, f"{name}_ci95_high": high}


def with_interval(
    name: str, values: np.ndarray, statistic: Callable[..., np.ndarray] = np.mean
) -> dict[str, float]:
    """Return the bootstrap interval of a statistic of `values` [n], as columns of a row."""
    low, high = bootstrap_interval(values, statistic)
    return {f"{name}_ci95_low": low, f"{name}_ci95_high": high}


def poisson_upper(count: int) -> float:
    """Compute the exact one-sided 95 % upper limit of a Poisson mean after `count` events.

    At this mean, `count` or fewer events have a probability of 5 %.
    """
    return float(scipy.stats.chi2.ppf(0.95, 2 * (count + 1))) / 2
