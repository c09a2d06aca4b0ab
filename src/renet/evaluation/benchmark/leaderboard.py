"""Ranking of policies by their result files: `renet evaluate leaderboard`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from renet.errors import RenetError, printable
from renet.evaluation.benchmark.episodes import EPISODES
from renet.evaluation.benchmark.results import BENCHMARK_VERSION, read_result, rows_of_entry
from renet.evaluation.benchmark.scores import (
    LEAST_TRAININGS,
    by_family,
    crossed_shares,
    interval_over_trainings,
    lead,
    score_interval,
    score_rows,
)
from renet.evaluation.metrics import share_interval
from renet.evaluation.results import Table, as_text, column, markdown
from renet.files import write_atomically
from renet.terminal import show

Result = Mapping[str, Any]
"""Content of a result file."""
_COLUMNS = ("", "policy", "entry", "robot", "score", "95 %", "over", "behind it")
_MEASURES = {
    "loud": "loud",
    "lies": "lies",
    "stranger": "stranger",
    "falls": "falls",
    "energy_per_metre": "J/m",
    "peak_torque": "peak N m",
    "speed_error": "error m/s",
}
"""Headings of the table of measures, by the names of the scores."""
_SHARES = ("loud", "lies", "stranger", "falls")
"""Measures that are shares; they are shown in per cent."""


@dataclass(frozen=True)
class LeaderboardCfg:
    """Rank policies by their result files, and compare each with the first entry of the first."""

    files: tyro.conf.Positional[tuple[Path, ...]]
    """result.json of each policy; `renet evaluate benchmark` writes one."""
    out: Path = Path("results/leaderboard.md")
    """The tables as Markdown."""


@dataclass(frozen=True)
class LeaderboardEntry:
    """Line of the leaderboard: an entry of one policy, or of several trainings of one method."""

    method: str
    """Name of the method, the same for all its trainings."""
    name: str
    """Name of the entry, such as memory."""
    robot: str
    """Name of the robot."""
    trainings: tuple[Sequence[Mapping[str, Any]], ...]
    """Rows of the episodes, one sequence for each training."""

    @property
    def scores(self) -> dict[str, Any]:
        """Scores over all episodes of all trainings."""
        return score_rows(list(chain.from_iterable(self.trainings)))

    @property
    def interval(self) -> tuple[float, float, str]:
        """Low and high end of the score's 95 % interval, and the samples it is taken over."""
        # The interval of a method is over its trainings, if there are enough of them.
        if len(self.trainings) >= LEAST_TRAININGS:
            means = column(list(map(score_rows, self.trainings)), "score")
            return (*interval_over_trainings(means), f"{len(means)} trainings")
        # All trainings walk the same episodes, each of which counts once.
        return (*score_interval(crossed_shares(_mean_rows(self))), "episodes")


def make_leaderboard(cfg: LeaderboardCfg) -> Path:
    """Print the tables, write them and return their path; raises as `read_result` and `ranking`."""
    if not cfg.files:
        raise RenetError("give result files: `renet evaluate benchmark` writes result.json")
    results = list(map(read_result, cfg.files))
    tables = [ranking(results), measures(results)]
    for result in results:
        tables.append(family_table(result))
    write_atomically(cfg.out, "\n".join(map(markdown, tables)).encode())
    for table in tables:
        show(*table)
    return cfg.out


def entries_of(results: Sequence[Result]) -> list[LeaderboardEntry]:
    """Return the entries of result files in the files' order, the trainings of a method joined.

    Raises RenetError if two results of a method's entry are of the same policy.
    """
    # Rows of each training, by its policy's hash, of each method, entry and robot.
    trainings: dict[tuple[str, str, str], dict[str, Sequence[Mapping[str, Any]]]] = {}
    for result in results:
        policy = result["policy"]
        for name in result["scores"]:
            of_entry = trainings.setdefault((policy["method"], name, policy["robot"]), {})
            # A policy that counted twice would make the interval over trainings too narrow.
            if policy["sha256"] in of_entry:
                raise RenetError(
                    printable(
                        f"two results of {policy['method']}, {name}, are of one policy,"
                        f" {policy['name']} {policy['sha256'][:12]}: give each training once"
                    )
                )
            of_entry[policy["sha256"]] = rows_of_entry(result, name)
    entries = []
    for (method, name, robot), of_entry in trainings.items():
        entries.append(LeaderboardEntry(method, name, robot, tuple(of_entry.values())))
    return entries


def rank_entries(results: Sequence[Result]) -> list[LeaderboardEntry]:
    """Sort the entries of result files, best first.

    Raises RenetError as `entries_of`, or if their episodes differ.
    """
    if len(set(column(results, "episodes"))) > 1:
        raise RenetError("give results of the same episodes: all quick, all full, or all sealed")
    return sorted(entries_of(results), key=lambda entry: -entry.scores["score"])


def ranking(results: Sequence[Result]) -> Table:
    """Tabulate the entries, best first, with shares in per cent.

    The last column is the difference in points to the first entry of the first file, with a 95 %
    interval over paired episodes. Raises as `rank_entries`.
    """
    reference = entries_of(results)[0]
    rows = []
    for place, entry in enumerate(rank_entries(results), start=1):
        rows.append(_line(place, entry, reference))
    title = (
        f"renet-faults, version {BENCHMARK_VERSION}, {_episodes(results[0])};"
        f" it: {reference.method}, {reference.name}"
    )
    return title, _COLUMNS, rows


def _episodes(result: Result) -> str:
    """Say in words which episodes a result has, and how many."""
    count = len(rows_of_entry(result, next(iter(result["scores"]))))
    words = {"full": f"all {count} episodes", "sealed": f"{count} sealed episodes"}
    return words.get(result["episodes"], f"first {count} of {EPISODES} episodes")


def _line(place: int, entry: LeaderboardEntry, reference: LeaderboardEntry) -> tuple[str, ...]:
    """Format the ranking's row of an entry at a place, compared with a reference."""
    low, high, over = entry.interval
    # The reference has no difference to itself.
    difference = "-"
    if entry != reference:
        points = lead(_mean_rows(reference), _mean_rows(entry))
        mean, least, most = (100 * point for point in points)
        difference = f"{mean:+.1f} ({_interval(least, most, '+.1f')})"
    return (
        str(place),
        entry.method,
        entry.name,
        entry.robot,
        as_text(entry.scores["score"], ".1f", 100),
        _interval(100 * low, 100 * high, ".1f"),
        over,
        difference,
    )


def _interval(low: float, high: float, digits: str) -> str:
    """Say an interval in words; equal ends, as of a bootstrap of equal numbers, are none."""
    return "all alike" if low == high else f"{low:{digits}} to {high:{digits}}"


def measures(results: Sequence[Result]) -> Table:
    """Tabulate the entries' other measures, in the ranking's order, with shares in per cent."""
    rows = []
    entries = rank_entries(results)
    for entry in entries:
        scores = entry.scores
        cells = []
        for name in _MEASURES:
            share = name in _SHARES
            cells.append(as_text(scores[name], ".1f" if share else ".3g", 100 if share else 1))
        rows.append((entry.method, entry.name, *cells))
    # All entries walk the same episodes.
    episodes = entries[0].trainings[0]
    lies = sum(column(episodes, "lie"))
    title = (
        f"Measures: {len(episodes) - lies} episodes with loud faults, {lies} with lies,"
        f" {sum(column(episodes, 'stranger'))} of strangers"
    )
    return title, ("policy", "entry", *_MEASURES.values()), rows


def counts(result: Result) -> Table:
    """Tabulate obstacles and episodes, each of how many, by entry; intervals are in per cent."""
    rows = []
    for entry in result["scores"]:
        episodes = rows_of_entry(result, entry)
        crossed = sum(column(episodes, "crossed"))
        cells = [f"{crossed} of {sum(column(episodes, 'obstacles'))}"]
        for name in ("arrived", "fell"):
            ends = np.array(column(episodes, name))
            low, high = share_interval(ends)
            cells += [f"{ends.sum()} of {len(ends)}", _interval(100 * low, 100 * high, ".1f")]
        rows.append((entry, *cells))
    header = ("entry", "obstacles crossed", "courses crossed", "95 %", "falls", "95 %")
    return "Counts, with intervals of their shares", header, rows


def _mean_rows(entry: LeaderboardEntry) -> list[dict[str, Any]]:
    """Average the obstacles crossed over the trainings; returns a row for each episode."""
    means = []
    for rows in zip(*entry.trainings, strict=True):
        crossed = np.mean(column(rows, "crossed"))
        means.append({"obstacles": rows[0]["obstacles"], "crossed": crossed})
    return means


def family_table(result: Result) -> Table:
    """Tabulate the obstacles crossed under each family of faults, in per cent, by entry."""
    scores = {entry: by_family(rows_of_entry(result, entry)) for entry in result["scores"]}
    # All entries walk the same episodes.
    first = next(iter(scores.values()))
    rows = []
    for family in sorted(first):
        shares = [as_text(families[family]["score"], ".1f", 100) for families in scores.values()]
        rows.append((family, *shares, first[family]["episodes"]))
    title = f"{result['policy']['name']}: crossed by family, %"
    return title, ("family", *scores, "episodes"), rows
