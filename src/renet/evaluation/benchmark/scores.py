"""Scores of the benchmark: obstacles crossed without a fall over all obstacles of the courses.

An obstacle that a robot never reached counts as not crossed, so that all policies are judged by the
same obstacles and a robot that stands still scores nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy

from renet.evaluation.metrics import bootstrap_interval, share_interval
from renet.evaluation.results import column, group_by

if TYPE_CHECKING:
    from renet.evaluation.benchmark.episodes import Episode
    from renet.evaluation.benchmark.walking import Walk

EpisodeRow = Mapping[str, Any]
"""Measures of one entry in one episode, by name."""
_SHORTEST_WALK = 0.5
"""Distance below which a walk does not count for the energy per metre, m."""
LEAST_TRAININGS = 3
"""Number of trainings of one method from which on the score's interval is over trainings."""


def rows_of(walks: Mapping[str, Walk], episodes: Sequence[Episode]) -> list[EpisodeRow]:
    """Make a row for every episode of every entry; `walks` are by entry, each [N] episodes."""
    rows = []
    for entry, walk in walks.items():
        for place, episode in enumerate(episodes):
            row = {
                "entry": entry,
                "episode": episode.number,
                "family": episode.family,
                "lie": episode.lie,
                "fault": episode.fault,
                "stranger": episode.stranger,
                "obstacles": len(episode.obstacles),
            }
            for name, values in vars(walk).items():
                row[name] = values[place].item()
            rows.append(row)
    return rows


def crossed_shares(rows: Sequence[EpisodeRow]) -> np.ndarray:
    """Return the share of each row's obstacles that was crossed, [rows]."""
    return np.array(column(rows, "crossed")) / np.array(column(rows, "obstacles"))


def score_interval(crossed: np.ndarray) -> tuple[float, float]:
    """Compute the 95 % interval of the mean of shares [n], one for each episode; n > 0.

    It is bootstrapped, unless every share is 0 or every share is 1, as for a policy that cannot
    walk in any of a few episodes. All resamples are equal then, and a bootstrap interval would have
    no width. Clopper and Pearson's interval, which also holds for shares, takes its place. If all
    shares are equal and in between, the interval has no width.
    """
    if crossed.max() == 0.0 or crossed.min() == 1.0:
        return share_interval(crossed)
    return bootstrap_interval(crossed)


def score_rows(rows: Sequence[EpisodeRow]) -> dict[str, Any]:
    """Compute the scores of one entry from its rows.

    Returns:
        By name: `score`, the mean share of the obstacles crossed over episodes, with the
        `score_interval` over episodes; `loud`, `lies` and `stranger`, the same of the episodes
        with such faults or robots; `falls`, the share of episodes that end in a fall;
        `energy_per_metre`, J/m; `peak_torque`, N m; `speed_error`, m/s. A measure without any
        episode is None.
    """
    crossed = crossed_shares(rows)
    low, high = score_interval(crossed)
    lie = np.array(column(rows, "lie"), bool)
    stranger = np.array(column(rows, "stranger"), bool)
    # A robot that stands still would have an infinite energy per metre.
    walked = [row for row in rows if row["metres"] >= _SHORTEST_WALK]
    energy_per_metre = None
    if walked:
        energy_per_metre = sum(column(walked, "joules")) / sum(column(walked, "metres"))
    return {
        "episodes": len(rows),
        "score": crossed.mean(),
        "ci95_low": low,
        "ci95_high": high,
        "loud": _mean(crossed[~lie]),
        "lies": _mean(crossed[lie]),
        "stranger": _mean(crossed[stranger]),
        "falls": _mean(column(rows, "fell")),
        "energy_per_metre": energy_per_metre,
        "peak_torque": _mean(column(rows, "peak_torque")),
        "speed_error": _mean(column(rows, "speed_error")),
    }


def _mean(values: Sequence[float] | np.ndarray) -> float | None:
    """Return the mean, or None without any value."""
    return float(np.mean(values)) if len(values) else None


def by_family(rows: Sequence[EpisodeRow]) -> dict[str, dict[str, Any]]:
    """Return the share of obstacles crossed, and the number of episodes, by family of faults."""
    scores = {}
    for (family,), group in group_by(rows, "family").items():
        share = float(crossed_shares(group).mean())
        scores[family] = {"score": share, "episodes": len(group)}
    return scores


def lead(rows: Sequence[EpisodeRow], others: Sequence[EpisodeRow]) -> tuple[float, float, float]:
    """Compute the lead of one entry over another in the share crossed.

    Args:
        rows: Rows of the one.
        others: Rows of the other, of the same episodes in the same order.

    Returns:
        Mean, and low and high end of the 95 % interval, over paired episodes.
    """
    # Pairing removes the differences between episodes from the interval.
    gain = crossed_shares(rows) - crossed_shares(others)
    return (float(gain.mean()), *bootstrap_interval(gain))


def interval_over_trainings(means: Sequence[float]) -> tuple[float, float]:
    """Compute Student's 95 % interval of the mean score of several trainings."""
    # Few trainings: the normal distribution's interval would be too narrow.
    values = np.array(means)
    half = scipy.stats.t.ppf(0.975, len(values) - 1) * scipy.stats.sem(values)
    return float(values.mean() - half), float(values.mean() + half)
