"""Tables of the documentation from result files of the fault benchmark, and who noticed what.

`python benchmarks/fault_tables.py benchmarks/results/leaderboard/go1-parkour.json --noticed
benchmarks/results/shipped/faults.csv` prints those of docs/pretrained.md, and with `--severity 5
--onset before_the_edge` and all files of that folder those of docs/comparison.md.
"""

from __future__ import annotations

import csv
from collections import Counter, defaultdict
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from facts import errors_in_one_line
from renet.errors import RenetError
from renet.evaluation.metrics import bootstrap_interval
from renet.evaluation.studies.benchmark import GROUNDS, read_result
from renet.evaluation.studies.fault_findings import SEVERE, findings

LOSS = 0.1 - 1e-6
"""Share of robots from which on a difference counts as ten points."""
BLIND = ("platform", "gap")
"""Grounds that OP seldom crosses."""
Setting = tuple[str, ...]
"""Ground, onset, fault, severity."""


@dataclass(frozen=True)
class Cfg:
    """Print tables of result files."""

    files: tyro.conf.Positional[tuple[Path, ...]]
    """result.json of each policy."""
    severity: int | None = None
    """Of the settings that count; all by default."""
    onset: str | None = None
    """on_the_way or before_the_edge; both by default."""
    noticed: Path | None = None
    """summary.csv of a study: who noticed its faults, and what it claims."""


def shares(cfg: Cfg) -> dict[str, dict[Setting, np.ndarray]]:
    """By policy and mode and by setting: crossed, upright; the same of healthy twins; switches."""
    found: dict[str, dict[Setting, np.ndarray]] = defaultdict(dict)
    for result in map(read_result, cfg.files):
        for row in result["settings"]:
            chosen = cfg.severity in (None, row["severity"]) and cfg.onset in (None, row["onset"])
            if not chosen:
                continue
            measures = [row["measures"][name] for name in ("crossed", "upright", "switches")]
            own = [measure["value"] for measure in measures]
            twin = [measure["value"] - measure["change"]["value"] for measure in measures]
            place = row["ground"], row["onset"], row["fault"], row["severity"]
            found[f"{result['policy']['name']} {row['mode']}"][place] = np.array(own[:2] + twin)
    return found


def percent(values: np.ndarray) -> str:
    """Robots that cross, and in parentheses that stay upright."""
    return f"{100 * values[0]:.1f} ({100 * values[1]:.1f})"


def by_ground(found: dict[str, dict[Setting, np.ndarray]]) -> None:
    """A row for each policy and mode: a fault, and in brackets a healthy camera and switches."""
    print("| policy and mode |", *(f"{ground} |" for ground in GROUNDS), "all but flat | all |")
    for name, settings in found.items():
        cells = []
        for grounds in (*((ground,) for ground in GROUNDS), tuple(GROUNDS)[1:], tuple(GROUNDS)):
            values = [value for place, value in settings.items() if place[0] in grounds]
            if not values:
                cells.append("-")
                continue
            mean = np.mean(values, axis=0)
            healthy = f" [{percent(mean[2:4])}, {mean[4]:.2f}]" if len(grounds) == 1 else ""
            cells.append(f"{percent(mean)}{healthy}, {len(values)} settings")
        print(f"| {name} |", " | ".join(cells), "|")


def by_severity(found: dict[str, dict[Setting, np.ndarray]]) -> None:
    """Crossed on all ground but the flat, and upright on all."""
    for name, settings in found.items():
        for severity in sorted({place[3] for place in settings}):
            rows = [(p[0], v) for p, v in settings.items() if p[3] == severity]
            crossed = np.mean([value[0] for ground, value in rows if ground != "flat"])
            upright = np.mean([value[1] for _, value in rows])
            print(f"{name}, severity {severity}: {100 * crossed:.1f} ({100 * upright:.1f})")


def separation(vp: dict[Setting, np.ndarray], renet: dict[Setting, np.ndarray]) -> None:
    """Settings in which one is ten points behind the other, of those in which a fault harms."""
    count: Counter[tuple[str, str]] = Counter()
    for place, (own, other) in {place: (vp[place], renet[place]) for place in vp}.items():
        # Harm to either: chance that lowers one of the two alone would speak for the other.
        harmed = any((row[2:4] - row[:2] > LOSS).any() for row in (own, other))
        ahead = bool((other[:2] - own[:2] > LOSS).any())
        behind = bool((own[:2] - other[:2] > LOSS).any())
        for ground in (place[0], "on platforms and gaps" if place[0] in BLIND else "elsewhere"):
            count[ground, "settings"] += 1
            count[ground, "RENet ahead"] += ahead
            count[ground, "VP ahead"] += behind
            count[ground, "a fault harms either"] += harmed
            count[ground, "and RENet is ahead"] += harmed and ahead
            count[ground, "and VP is ahead"] += harmed and behind
    for ground in dict.fromkeys(ground for ground, _ in count):
        told = (f"{what} {number}" for (where, what), number in count.items() if where == ground)
        print(f"{ground}: {', '.join(told)}")


def paired(path: Path) -> None:
    """RENet less VP, robot by robot over all settings, in points with 95 % intervals."""
    result = read_result(path)
    if not {"vp", "renet"} <= set(result.get("by_robot", {})):
        return
    vp, renet = (result["by_robot"][mode] for mode in ("vp", "renet"))
    settings = Counter(row["ground"] for row in result["settings"] if row["mode"] == "vp")
    for grounds in (*((ground,) for ground in settings), tuple(settings)[1:], tuple(settings)):
        cells = []
        for name in ("crossed", "upright"):
            gains = [np.subtract(renet[ground][name], vp[ground][name]) for ground in grounds]
            gain = np.average(gains, axis=0, weights=[settings[ground] for ground in grounds])
            low, high = bootstrap_interval(100 * gain)
            cells.append(f"{name} {100 * gain.mean():+.1f} ({low:+.1f} to {high:+.1f})")
        print(f"RENet less VP, {', '.join(grounds)}: {', '.join(cells)}")


def costs(vp: dict[Setting, np.ndarray]) -> None:
    """Points of crossing that VP loses to its healthy twins from severity 3 on, fault by fault."""
    lost: dict[str, list[float]] = defaultdict(list)
    for (ground, _, fault, severity), value in vp.items():
        if int(severity) >= SEVERE:
            lost[f"{fault} on {ground}"].append(100 * (value[2] - value[0]))
    means = {place: np.mean(points) for place, points in lost.items()}
    found = sorted((place for place in means if means[place] >= 5), key=lambda p: -means[p])
    print("points VP loses:", ", ".join(f"{place} {means[place]:.0f}" for place in found))


def study_rows(path: Path) -> list[dict[str, Any]]:
    """Rows of a study's summary.csv, numbers as such; an empty cell is None."""
    rows = list(csv.DictReader(path.read_text().splitlines() if path.is_file() else ()))
    if not rows or "over_op" not in rows[0]:
        raise RenetError(f"{path} is no summary.csv of the study `renet evaluate faults`")
    return [{name: number(text) for name, text in row.items()} for row in rows]


def number(text: str) -> Any:
    """What a cell holds."""
    for kind in (int, float):
        with suppress(ValueError):
            return kind(text)
    return text or None


def noticing(rows: list[dict[str, Any]]) -> None:
    """Robots in mode renet that noticed, of those that used vision, severity by severity."""
    seen: dict[str, Counter[str]] = defaultdict(Counter)
    for row in rows:
        if row["mode"] == "renet":
            seen[row["fault"]][row["severity"]] += row["detected"]
            seen[row["fault"]]["of"] += row["vision_active_at_onset"]
    for fault, counts in seen.items():
        robots = counts.pop("of") // len(counts)
        print(f"{fault}: {', '.join(map(str, counts.values()))} of {robots} each")


def claims(rows: list[dict[str, Any]]) -> None:
    """The study's claims, and settings in which RENet falls more often than OP robot by robot."""
    twins = [
        {**row, "falls": row["falls"] - row["falls_by_fault"] + row["falls_spared"]}
        for row in rows
        if row["mode"] != "renet"
    ]
    for claim in findings(rows, twins, {"robot_hours": 0})["claims"]:
        print(f"{claim['claim']}: {claim['measured']}")
    below = Counter(row["ground"] for row in rows if (row["over_op_ci95_high"] or 0) < 0)
    print("settings in which RENet falls more often than OP, interval below zero:", dict(below))


def main(cfg: Cfg) -> None:
    """Print all tables."""
    found = shares(cfg)
    by_ground(found)
    by_severity(found)
    policies = {name.rsplit(" ", 1)[0] for name in found}
    for policy in sorted(policies):
        if {f"{policy} vp", f"{policy} renet"} <= set(found):
            costs(found[f"{policy} vp"])
            separation(found[f"{policy} vp"], found[f"{policy} renet"])
    for path in cfg.files:
        paired(path)
    if cfg.noticed is not None:
        rows = study_rows(cfg.noticed)
        noticing(rows)
        claims(rows)


if __name__ == "__main__":
    with errors_in_one_line():
        main(tyro.cli(Cfg))
