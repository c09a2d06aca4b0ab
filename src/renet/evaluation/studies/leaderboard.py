"""`renet evaluate leaderboard`: policies ranked by their result files, and the tables behind.

These are by ground and severity, and show RENet beside VP, robot by robot.
"""

import csv
import math
import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

from renet.errors import RenetError, printable
from renet.evaluation.metrics import bootstrap_interval
from renet.evaluation.results import grouped
from renet.evaluation.studies.benchmark import GROUNDS, ONSETS, PROTOCOL, read_result
from renet.evaluation.studies.crossing import ranking
from renet.evaluation.studies.faults import FaultStudy
from renet.evaluation.study import Table
from renet.files import MAX_JSON, read_bytes, write_atomically
from renet.terminal import show

Settings = Sequence[Mapping[str, Any]]
"""Settings of result files."""
Policies = Mapping[tuple[str, str], Settings]
"""The same by the names of policy and mode."""
HEADER = ("", "policy", "mode", "crossed", "95 %", "upright", "speed error", "J/m", "blind (s)")


@dataclass(frozen=True)
class LeaderboardCfg:
    """Rank policies by their result files of the fault benchmark, and print the tables behind."""

    files: tyro.conf.Positional[tuple[Path, ...]]
    """result.json of each policy; `renet evaluate faults` writes one."""
    out: Path = Path("results/leaderboard.md")
    """All tables, as Markdown."""
    severity: Literal[1, 2, 3, 4, 5] | None = None
    """Severity that counts in the tables behind the ranking; all by default."""
    onset: Literal["on_the_way", "before_the_edge"] | None = None
    """Onset that counts there; both by default."""
    noticed: Path | None = None
    """summary.csv of a study: who noticed its faults."""


def make_leaderboard(cfg: LeaderboardCfg) -> Path:
    """Print the tables, write them and return their path; raises as `read_result` and `rank`."""
    noticed_tables = [study_table(cfg.noticed)] if cfg.noticed else []
    results = [read_result(path) for path in cfg.files]
    versions = {result["version"] for result in results}
    if len(versions) > 1:
        each = ", ".join(
            f"{p} is of {r['version']}" for p, r in zip(cfg.files, results, strict=True)
        )
        raise RenetError(f"give results of one version of the benchmark: {each}")
    tables: list[Table] = []
    try:
        if versions == {2}:
            tables += [ranking(results)]
        else:
            tables += [("Fault benchmark, version 1", HEADER, rank(results))]
            tables += result_tables(results, cfg.severity, cfg.onset)
    except (LookupError, TypeError, ValueError) as error:
        names = ", ".join(map(str, cfg.files))
        raise RenetError(f"{names}: a number is missing, or not one a robot ({error})") from error
    tables += noticed_tables
    write_atomically(cfg.out, "\n".join(map(_markdown, tables)).encode())
    for table in tables:
        show(*table)
    return cfg.out


def _markdown(table: Table) -> str:
    title, header, rows = table
    cells = [map(_plain, header), ["---"] * len(header), *(map(_plain, row) for row in rows)]
    lines = [" | ".join(row) for row in cells]
    return f"## {_plain(title)}\n\n" + "".join(f"| {line} |\n" for line in lines)


def _plain(cell: object) -> str:
    """A cell's text, of which nothing is markup: names are a stranger's."""
    text = re.sub(r"[\\`|<>]", r"\\\g<0>", printable(str(cell)))
    return text.replace("](", r"]\(")


def rank(results: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Rows of the leaderboard, best first, those of other robots or fewer settings last.

    Raises RenetError for results of different protocols.
    """
    if len({tuple(r["protocol"][name] for name in ("quick", "speed")) for r in results}) != 1:
        raise RenetError("give results of one protocol: all of them quick, or none")
    rows = []
    pairs = [(result, mode) for result in results for mode in result["policy"]["modes"]]
    for result, mode in pairs:
        entries = [entry for entry in result["settings"] if entry["mode"] == mode]
        tiles = [entry for entry in entries if entry["ground"] != "flat"]
        crossed, upright = _mean(tiles, "crossed"), _mean(entries, "upright")
        others = ("speed_error", "energy_per_metre", "seconds_without_sight")
        cells = (
            result["policy"]["name"],
            mode,
            f"{100 * crossed:.1f} %",
            _interval(result, mode, Counter(entry["ground"] for entry in tiles)),
            f"{100 * upright:.1f} %",
            *(f"{_mean(entries, name):.2f}" for name in others),
        )
        rows.append((not _is_complete(result["protocol"], entries), -crossed, -upright, cells))
    rows.sort(key=lambda row: row[:3])
    return [
        ("incomplete" if row[0] else str(place), *row[-1])
        for place, row in enumerate(rows, start=1)
    ]


def _mean(settings: Settings, name: str, twins: bool = False) -> float:
    """The mean of a measure over the settings, or twins there, it was taken in; NaN without any."""
    measures = [setting["measures"][name] for setting in settings]
    measured = np.array([measure["value"] for measure in measures], float)
    if twins:
        measured -= np.array([measure["change"]["value"] for measure in measures], float)
    return float(np.nanmean(measured)) if (~np.isnan(measured)).any() else math.nan


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


def result_tables(
    results: Sequence[Mapping[str, Any]], severity: int | None, onset: str | None
) -> Iterator[Table]:
    """Tables of result files, from their settings of one severity and onset, or all of them."""
    policies: dict[tuple[str, str], list[Mapping[str, Any]]] = defaultdict(list)
    for result in results:
        for row in result["settings"]:
            if severity in (None, row["severity"]) and onset in (None, row["onset"]):
                policies[result["policy"]["name"], row["mode"]].append(row)
    yield by_ground(policies)
    yield by_severity(policies)
    for result in results:
        if {"camera", "memory"} <= result.get("by_robot", {}).keys():
            yield paired(result)


def percent(tiles: Settings, settings: Settings, twins: bool = False) -> str:
    """The mean share that crosses `tiles` and, in parentheses, stays upright in `settings`, %."""
    if not tiles:
        return "-"
    crossed, upright = _mean(tiles, "crossed", twins), _mean(settings, "upright", twins)
    return f"{100 * crossed:.1f} ({100 * upright:.1f})"


def by_ground(policies: Policies) -> Table:
    """Means over the settings of each ground, and how many settings there are in all."""
    columns = {ground: (ground,) for ground in GROUNDS}
    columns |= {"all but flat": tuple(GROUNDS)[1:], "all": tuple(GROUNDS)}
    rows = []
    for policy, settings in policies.items():
        cells = []
        for grounds in columns.values():
            chosen = [row for row in settings if row["ground"] in grounds]
            cell = percent(chosen, chosen)
            if chosen and len(grounds) == 1:
                switches = _mean(chosen, "switches", twins=True)
                cell += f" [{percent(chosen, chosen, twins=True)}, {switches:.2f}]"
            cells.append(cell)
        rows.append((*policy, *cells, len(settings)))
    title = "Crossed (upright), %, by ground; in brackets: with a healthy camera, switches"
    return title, ("policy", "mode", *columns, "settings"), rows


def by_severity(policies: Policies) -> Table:
    """Crossed on all ground but the flat, and upright on all."""
    severities = sorted({row["severity"] for settings in policies.values() for row in settings})
    rows = []
    for policy, settings in policies.items():
        cells = []
        for severity in severities:
            chosen = [row for row in settings if row["severity"] == severity]
            tiles = [row for row in chosen if row["ground"] != "flat"]
            cells.append(percent(tiles, chosen))
        rows.append((*policy, *cells))
    title = "Crossed on tiles (upright on all ground), %, by severity"
    return title, ("policy", "mode", *map(str, severities)), rows


def paired(result: Mapping[str, Any]) -> Table:
    """RENet less VP, robot by robot over all settings, in points with 95 % intervals."""
    vp, renet = (result["by_robot"][mode] for mode in ("camera", "memory"))
    settings = Counter(row["ground"] for row in result["settings"] if row["mode"] == "camera")
    groups = {ground: (ground,) for ground in settings}
    groups |= {"all but the first": tuple(settings)[1:], "all": tuple(settings)}
    rows = []
    for title, grounds in groups.items():
        cells = []
        for name in ("crossed", "upright") if grounds else ():
            gains = [np.subtract(renet[ground][name], vp[ground][name]) for ground in grounds]
            gain = np.average(gains, axis=0, weights=[settings[ground] for ground in grounds])
            low, high = bootstrap_interval(100 * gain)
            cells.append(f"{100 * gain.mean():+.1f} ({low:+.1f} to {high:+.1f})")
        rows.append((title, *cells))
    title = f"RENet less VP, points with 95 % intervals over robots, {result['policy']['name']}"
    return title, ("ground", "crossed", "upright"), rows


def study_table(path: Path) -> Table:
    """Who noticed which fault, by the rows of a study's summary.csv.

    Raises RenetError for any other file.
    """
    lines = read_bytes(path, MAX_JSON, "summary").decode(errors="replace").splitlines()
    numbers = ("severity", "detected", "vision_active_at_onset")
    try:
        rows = [row | {name: int(row[name]) for name in numbers} for row in csv.DictReader(lines)]
        return noticed(rows)
    except (csv.Error, LookupError, TypeError, ValueError) as error:
        raise RenetError(
            f"{path} is no summary.csv of the study `renet evaluate faults`"
        ) from error


def noticed(runs: Sequence[Mapping[str, Any]]) -> Table:
    """Robots in mode memory that noticed a fault, of those that used vision, by severity."""
    faults = grouped([run for run in runs if run["mode"] == "memory"], "fault")
    severities = sorted({run["severity"] for rows in faults.values() for run in rows})
    table = []
    for (fault,), rows in faults.items():
        groups = grouped(rows, "severity")
        counts = [sum(run["detected"] for run in groups.get((s,), ())) for s in severities]
        robots = sum(run["vision_active_at_onset"] for run in rows)
        table.append((fault, *counts, robots // len(groups)))
    return "Robots that noticed, by severity", ("fault", *map(str, severities), "of each"), table
