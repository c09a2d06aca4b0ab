"""What counts: obstacles crossed without a fall over all obstacles of the courses.

An obstacle that a robot never reached counts as not crossed, so that all policies are judged by the
same obstacles, and to stand still earns nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy

from renet.evaluation.metrics import bootstrap_interval
from renet.evaluation.results import grouped

if TYPE_CHECKING:
    from renet.evaluation.benchmark.episodes import Episode
    from renet.evaluation.benchmark.walking import Walk

Row = Mapping[str, Any]
"""One episode of one entry."""
SHORT = 0.5
"""Energy per metre says nothing of shorter ways, m."""
LEAST_TRAININGS = 3
"""Trainings of one method from which on the interval is over them."""


def rows_of(walks: Mapping[str, Walk], episodes: Sequence[Episode]) -> list[Row]:
    """A row for every episode of every entry."""
    return [
        {
            "entry": entry,
            "episode": episode.number,
            "family": episode.family,
            "lie": episode.lie,
            "fault": episode.fault,
            "stranger": episode.stranger,
            "obstacles": len(episode.obstacles),
        }
        | {name: values[i].item() for name, values in vars(walk).items()}
        for entry, walk in walks.items()
        for i, episode in enumerate(episodes)
    ]


def shares(rows: Sequence[Row]) -> np.ndarray:
    """Share of each row's obstacles that was crossed, [rows]."""
    return np.array([row["crossed"] / row["obstacles"] for row in rows])


def score(rows: Sequence[Row]) -> dict[str, Any]:
    """The scores of one entry from its rows.

    `score` is the mean share of the obstacles crossed, over episodes; its 95 % interval is a
    bootstrap over episodes. `loud` and `lies` are the same of the episodes with such faults,
    `stranger` of those with another robot; None without any. `falls` is the share of episodes that
    end in a fall.
    """
    crossed = shares(rows)
    low, high = bootstrap_interval(crossed)
    walked = [row for row in rows if row["metres"] >= SHORT]
    joules = sum(row["joules"] for row in walked)
    return {
        "episodes": len(rows),
        "score": crossed.mean(),
        "ci95_low": low,
        "ci95_high": high,
        "loud": _mean(shares([row for row in rows if not row["lie"]])),
        "lies": _mean(shares([row for row in rows if row["lie"]])),
        "stranger": _mean(shares([row for row in rows if row["stranger"]])),
        "falls": _mean([row["fell"] for row in rows]),
        "energy_per_metre": joules / sum(row["metres"] for row in walked) if walked else None,
        "peak_torque": _mean([row["peak_torque"] for row in rows]),
        "speed_error": _mean([row["speed_error"] for row in rows]),
    }


def _mean(values: Sequence[float] | np.ndarray) -> float | None:
    return float(np.mean(values)) if len(values) else None


def by_family(rows: Sequence[Row]) -> dict[str, dict[str, Any]]:
    """Share of obstacles crossed, and the number of episodes, by family of faults."""
    return {
        family: {"score": float(shares(group).mean()), "episodes": len(group)}
        for (family,), group in grouped(rows, "family").items()
    }


def lead(rows: Sequence[Row], others: Sequence[Row]) -> tuple[float, float, float]:
    """How much more one entry crosses than another: mean and 95 % interval over paired episodes.

    Rows are of the same episodes in the same order.
    """
    gain = shares(rows) - shares(others)
    return (float(gain.mean()), *bootstrap_interval(gain))


def interval_over_trainings(means: Sequence[float]) -> tuple[float, float]:
    """Student's 95 % interval of the mean of several trainings' scores."""
    values = np.array(means)
    half = scipy.stats.t.ppf(0.975, len(values) - 1) * scipy.stats.sem(values)
    return float(values.mean() - half), float(values.mean() + half)
