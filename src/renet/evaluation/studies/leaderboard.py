"""`renet evaluate leaderboard`: policies ranked by their result files, and the tables behind."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from renet.errors import RenetError
from renet.evaluation.metrics import bootstrap_interval
from renet.evaluation.studies.benchmark import ONSETS, PROTOCOL, read_result
from renet.evaluation.studies.fault_tables import result_tables, study_tables
from renet.evaluation.studies.faults import FaultStudy
from renet.evaluation.study import Table
from renet.files import write_atomically
from renet.terminal import show

HEADER = ("", "policy", "mode", "crossed", "95 %", "upright", "speed error", "J/m", "blind (s)")


@dataclass(frozen=True)
class LeaderboardCfg:
    """Rank policies by their result files of the fault benchmark, and print the tables behind."""

    files: tyro.conf.Positional[tuple[Path, ...]]
    """result.json of each policy; `renet evaluate faults` writes one."""
    out: Path = Path("results/leaderboard.md")
    """All tables, as Markdown."""
    severity: int | None = None
    """Severity that counts in the tables behind the ranking; all by default."""
    onset: str | None = None
    """Onset that counts there, on_the_way or before_the_edge; both by default."""
    noticed: Path | None = None
    """summary.csv of a study: who noticed its faults, and what it claims."""


def make_leaderboard(cfg: LeaderboardCfg) -> Path:
    """Print the tables, write them and return their path.

    Raises:
        RenetError: a file that is no result of this version, or results of different protocols.
    """
    results = [read_result(path) for path in cfg.files]
    tables: list[Table] = [("Fault benchmark, version 1", HEADER, rank(results))]
    tables += result_tables(results, cfg.severity, cfg.onset)
    tables += study_tables(cfg.noticed) if cfg.noticed else ()
    write_atomically(cfg.out, "\n".join(map(_markdown, tables)).encode())
    for table in tables:
        show(*table)
    return cfg.out


def _markdown(table: Table) -> str:
    title, header, rows = table
    lines = [" | ".join(map(str, row)) for row in (header, ["---"] * len(header), *rows)]
    return f"## {title}\n\n" + "".join(f"| {line} |\n" for line in lines)


def rank(results: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Rows of the leaderboard, best first; results of other robots or fewer settings come last.

    Raises:
        RenetError: results of different protocols.
    """
    if len({tuple(r["protocol"][name] for name in ("quick", "speed")) for r in results}) != 1:
        raise RenetError("give results of one protocol: all of them quick, or none")
    rows = [_row(result, mode) for result in results for mode in result["policy"]["modes"]]
    rows.sort(key=lambda row: (not row["complete"], -row["crossed"], -row["upright"]))
    return [
        (
            str(place) if row["complete"] else "incomplete",
            row["policy"],
            row["mode"],
            f"{100 * row['crossed']:.1f} %",
            row["interval"],
            f"{100 * row['upright']:.1f} %",
            *(f"{row[name]:.2f}" for name in ("speed_error", "energy", "blind")),
        )
        for place, row in enumerate(rows, start=1)
    ]


def _row(result: Mapping[str, Any], mode: str) -> dict[str, Any]:
    """One policy in one mode: means over the settings."""
    entries = [entry for entry in result["settings"] if entry["mode"] == mode]
    tiles = [entry for entry in entries if entry["ground"] != "flat"]

    def mean(entries: Sequence[Mapping[str, Any]], name: str) -> float:
        measured = np.array([entry["measures"][name]["value"] for entry in entries], float)
        return float(np.nanmean(measured)) if (~np.isnan(measured)).any() else math.nan

    return {
        "policy": result["policy"]["name"],
        "mode": mode,
        "complete": _is_complete(result["protocol"], entries),
        "crossed": mean(tiles, "crossed"),
        "interval": _interval(result, mode, Counter(entry["ground"] for entry in tiles)),
        "upright": mean(entries, "upright"),
        "speed_error": mean(entries, "speed_error"),
        "energy": mean(entries, "energy_per_metre"),
        "blind": mean(entries, "seconds_without_sight"),
    }


def _is_complete(protocol: Mapping[str, Any], entries: Sequence[Mapping[str, Any]]) -> bool:
    """Whether the benchmark's robots walked in all of its settings."""
    study = FaultStudy(quick=protocol["quick"])
    if {"robots": study.robots_each, **{n: getattr(study, n) for n in PROTOCOL}} != protocol:
        return False
    settings = {
        (s.ground, study.levels[s.ground], ONSETS[s.onset], s.fault, s.severity)
        for batch in study.batches.values()
        for s in batch
    }
    names = ("ground", "level", "onset", "fault", "severity")
    return settings <= {tuple(entry[name] for name in names) for entry in entries}


def _interval(result: Mapping[str, Any], mode: str, settings: Mapping[str, int]) -> str:
    """Interval of the share that crossed, over robots, which stand in all settings of a ground."""
    if "by_robot" not in result or not settings:
        return "-"
    crossed = [result["by_robot"][mode][ground]["crossed"] for ground in settings]
    robots = np.average(crossed, axis=0, weights=list(settings.values()))
    return "{:.1f} to {:.1f}".format(*(100 * end for end in bootstrap_interval(robots)))
