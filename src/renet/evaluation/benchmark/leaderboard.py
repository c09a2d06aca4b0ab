"""`renet evaluate leaderboard`: policies ranked by their result files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from renet.errors import RenetError
from renet.evaluation.benchmark.results import VERSION, read_result, rows_of_entry
from renet.evaluation.benchmark.scores import (
    LEAST_TRAININGS,
    by_family,
    interval_over_trainings,
    lead,
    score,
)
from renet.evaluation.results import Table, grouped, markdown
from renet.files import write_atomically
from renet.terminal import show

Result = Mapping[str, Any]
COLUMNS = ("", "policy", "entry", "robot", "score", "95 %", "over", "behind it")
MEASURES = {
    "loud": "loud",
    "lies": "lies",
    "stranger": "stranger",
    "falls": "falls",
    "energy_per_metre": "J/m",
    "peak_torque": "peak N m",
    "speed_error": "error m/s",
}
"""Columns of the table of measures."""
SHARES = ("loud", "lies", "stranger", "falls")


@dataclass(frozen=True)
class LeaderboardCfg:
    """Rank policies by their result files, and compare each with the first file's first entry."""

    files: tyro.conf.Positional[tuple[Path, ...]]
    """result.json of each policy; `renet evaluate benchmark` writes one."""
    out: Path = Path("results/leaderboard.md")
    """The tables as Markdown."""


@dataclass(frozen=True)
class Entry:
    """One line of the leaderboard: an entry of one policy, or of several trainings of a method."""

    method: str
    name: str
    robot: str
    trainings: tuple[Sequence[Mapping[str, Any]], ...]
    """Rows of each training."""

    @property
    def scores(self) -> dict[str, Any]:
        """Scores over all episodes of all trainings."""
        return score([row for rows in self.trainings for row in rows])

    @property
    def interval(self) -> tuple[float, float, str]:
        """95 % interval of the score, and what it is over."""
        if len(self.trainings) >= LEAST_TRAININGS:
            means = [score(rows)["score"] for rows in self.trainings]
            return (*interval_over_trainings(means), f"{len(means)} trainings")
        scores = self.scores
        return scores["ci95_low"], scores["ci95_high"], "episodes"


def make_leaderboard(cfg: LeaderboardCfg) -> Path:
    """Print the tables, write them and return their path; raises as `read_result` and `ranking`."""
    if not cfg.files:
        raise RenetError("give result files: `renet evaluate benchmark` writes result.json")
    results = [read_result(path) for path in cfg.files]
    tables = [ranking(results), measures(results), *map(family_table, results)]
    write_atomically(cfg.out, "\n".join(map(markdown, tables)).encode())
    for table in tables:
        show(*table)
    return cfg.out


def entries_of(results: Sequence[Result]) -> list[Entry]:
    """Entries of result files, those of a method's trainings together, in the files' order."""
    lines = [
        {
            "method": result["policy"]["method"],
            "robot": result["policy"]["robot"],
            "entry": entry,
            "rows": rows_of_entry(result, entry),
        }
        for result in results
        for entry in result["scores"]
    ]
    return [
        Entry(method, name, robot, tuple(line["rows"] for line in group))
        for (method, name, robot), group in grouped(lines, "method", "entry", "robot").items()
    ]


def ranked(results: Sequence[Result]) -> list[Entry]:
    """The entries of result files, best first; raises RenetError for different episodes."""
    if len({result["episodes"] for result in results}) > 1:
        raise RenetError("give results of the same episodes: all quick, all full, or all sealed")
    return sorted(entries_of(results), key=lambda entry: -entry.scores["score"])


def ranking(results: Sequence[Result]) -> Table:
    """The leaderboard, best first; shares in per cent.

    The last column is how many points an entry is behind the first file's first one, with a 95 %
    interval over episodes, each paired with itself. Raises as `ranked`.
    """
    reference = entries_of(results)[0]
    rows = [_line(place, entry, reference) for place, entry in enumerate(ranked(results), start=1)]
    title = (
        f"renet-faults, version {VERSION}, {results[0]['episodes']} episodes;"
        f" it: {reference.method}, {reference.name}"
    )
    return title, COLUMNS, rows


def _line(place: int, entry: Entry, reference: Entry) -> tuple[str, ...]:
    low, high, over = entry.interval
    difference = "-"
    if entry != reference:
        pairs = lead(_mean_rows(reference), _mean_rows(entry))
        difference = "{:+.1f} ({:+.1f} to {:+.1f})".format(*(100 * value for value in pairs))
    return (
        str(place),
        entry.method,
        entry.name,
        entry.robot,
        _percent(entry.scores["score"]),
        f"{_percent(low)} to {_percent(high)}",
        over,
        difference,
    )


def measures(results: Sequence[Result]) -> Table:
    """What else is measured of the entries, in the leaderboard's order; shares in per cent."""
    rows = []
    for entry in ranked(results):
        scores = entry.scores
        cells = [
            _percent(scores[name]) if name in SHARES else _number(scores[name]) for name in MEASURES
        ]
        rows.append((entry.method, entry.name, *cells))
    return "Measures", ("policy", "entry", *MEASURES.values()), rows


def _mean_rows(entry: Entry) -> list[dict[str, Any]]:
    """One row for each episode, in which what was crossed is the mean of the trainings."""
    return [
        {"obstacles": rows[0]["obstacles"], "crossed": np.mean([row["crossed"] for row in rows])}
        for rows in zip(*entry.trainings, strict=True)
    ]


def family_table(result: Result) -> Table:
    """What is crossed under each family of faults, with the number of its episodes."""
    families = {entry: by_family(rows_of_entry(result, entry)) for entry in result["scores"]}
    first = next(iter(families.values()))
    rows = [
        (family, *(_percent(scores[family]["score"]) for scores in families.values()), count)
        for family, count in sorted((name, of["episodes"]) for name, of in first.items())
    ]
    title = f"{result['policy']['name']}: crossed by family, %"
    return title, ("family", *families, "episodes"), rows


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f}"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
