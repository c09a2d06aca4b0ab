"""`renet evaluate leaderboard`: policies ranked by their result files of the fault benchmark."""

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
from renet.evaluation.studies.faults import FaultStudy
from renet.files import write_atomically
from renet.terminal import show

HEADER = ("", "policy", "mode", "crossed", "95 %", "upright", "speed error", "J/m", "blind (s)")


@dataclass(frozen=True)
class LeaderboardCfg:
    """Rank policies by their result files of the fault benchmark."""

    files: tyro.conf.Positional[tuple[Path, ...]]
    """result.json of each policy; `renet evaluate faults` writes one."""
    out: Path = Path("results/leaderboard.md")
    """The table, as Markdown."""


def make_leaderboard(cfg: LeaderboardCfg) -> Path:
    """Print the table, write it and return its path.

    Raises:
        RenetError: a file that is no result of this version, or results of different protocols.
    """
    results = [read_result(path) for path in cfg.files]
    rows = rank(results)
    lines = ["| " + " | ".join(map(str, row)) + " |" for row in (HEADER, ["---"] * 9, *rows)]
    write_atomically(cfg.out, ("\n".join(lines) + "\n").encode())
    show("Fault benchmark, version 1", HEADER, rows)
    return cfg.out


def rank(results: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Rows of the leaderboard, best first; results of other robots or fewer settings come last.

    Raises:
        RenetError: results of different protocols.
    """
    if len({tuple(found["protocol"][n] for n in ("quick", "speed")) for found in results}) != 1:
        raise RenetError("give results of one protocol: all of them quick, or none")
    rows = [_row(found, mode) for found in results for mode in found["policy"]["modes"]]
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


def _row(found: Mapping[str, Any], mode: str) -> dict[str, Any]:
    """One policy in one mode: means over the settings."""
    own = [entry for entry in found["settings"] if entry["mode"] == mode]
    tiles = [entry for entry in own if entry["ground"] != "flat"]

    def mean(entries: Sequence[Mapping[str, Any]], name: str) -> float:
        measured = np.array([entry["measures"][name]["value"] for entry in entries], float)
        return float(np.nanmean(measured)) if (~np.isnan(measured)).any() else math.nan

    study = FaultStudy(quick=found["protocol"]["quick"])
    asked = {"robots": study.robots_each, **{name: getattr(study, name) for name in PROTOCOL}}
    levels = study.levels
    wanted = {
        (*setting[:1], levels[setting.ground], ONSETS[setting.onset], *setting[2:])
        for settings in study.batches.values()
        for setting in settings
    }
    names = ("ground", "level", "onset", "fault", "severity")
    return {
        "policy": found["policy"]["name"],
        "mode": mode,
        "complete": asked == found["protocol"]
        and wanted <= {tuple(entry[name] for name in names) for entry in own},
        "crossed": mean(tiles, "crossed"),
        "interval": _interval(found, mode, Counter(entry["ground"] for entry in tiles)),
        "upright": mean(own, "upright"),
        "speed_error": mean(own, "speed_error"),
        "energy": mean(own, "energy_per_metre"),
        "blind": mean(own, "seconds_without_sight"),
    }


def _interval(found: Mapping[str, Any], mode: str, settings: Mapping[str, int]) -> str:
    """Of the share that crossed, over robots: the same ones stand in all settings of a ground."""
    if "by_robot" not in found or not settings:
        return "-"
    crossed = [found["by_robot"][mode][ground]["crossed"] for ground in settings]
    robots = np.average(crossed, axis=0, weights=list(settings.values()))
    return "{:.1f} to {:.1f}".format(*(100 * end for end in bootstrap_interval(robots)))
