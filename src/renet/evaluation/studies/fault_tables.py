"""Tables of fault-benchmark results: by ground, severity and fault, and RENet beside VP."""

import csv
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from renet.errors import RenetError
from renet.evaluation.metrics import bootstrap_interval
from renet.evaluation.studies.benchmark import GROUNDS
from renet.evaluation.studies.fault_findings import SEVERE, findings
from renet.evaluation.study import Table

LOSS = 0.1 - 1e-6
"""Share of robots from which on a difference counts as ten points."""
BLIND = ("platform", "gap")
"""Grounds that OP seldom crosses."""
MENTIONED = 5.0
"""Points from which on a loss is listed."""


class Place(NamedTuple):
    """A setting of the benchmark."""

    ground: str
    onset: str
    fault: str
    severity: int


class Shares(NamedTuple):
    """Means over the robots of a setting; `fault` and `healthy` are [crossed, upright]."""

    fault: np.ndarray
    healthy: np.ndarray
    """The same of the robots' twins, whose cameras do not fail."""
    healthy_switches: float


Settings = Mapping[Place, Shares]


def result_tables(
    results: Sequence[Mapping[str, Any]], severity: int | None, onset: str | None
) -> Iterator[Table]:
    """Tables of result files.

    Args:
        results: contents of result files.
        severity: the severity that counts; all by default.
        onset: the onset that counts, on_the_way or before_the_edge; both by default.
    """
    policies = read_shares(results, severity, onset)
    yield by_ground(policies)
    yield by_severity(policies)
    for name in dict.fromkeys(name for name, _ in policies):
        if {(name, "vp"), (name, "renet")} <= policies.keys():
            yield losses(name, policies[name, "vp"])
            yield separation(name, policies[name, "vp"], policies[name, "renet"])
    for result in results:
        if {"vp", "renet"} <= result.get("by_robot", {}).keys():
            yield paired(result)


def read_shares(
    results: Sequence[Mapping[str, Any]], severity: int | None = None, onset: str | None = None
) -> dict[tuple[str, str], dict[Place, Shares]]:
    """Shares by policy and mode, then by setting; see `result_tables`."""
    shares: dict[tuple[str, str], dict[Place, Shares]] = defaultdict(dict)
    for result in results:
        for row in result["settings"]:
            if severity not in (None, row["severity"]) or onset not in (None, row["onset"]):
                continue
            measures = [row["measures"][name] for name in ("crossed", "upright", "switches")]
            values = np.array([measure["value"] for measure in measures])
            twins = values - [measure["change"]["value"] for measure in measures]
            place = Place(row["ground"], row["onset"], row["fault"], row["severity"])
            policy = result["policy"]["name"], row["mode"]
            shares[policy][place] = Shares(values[:2], twins[:2], twins[2])
    return shares


def percent(shares: np.ndarray) -> str:
    """Robots that cross, and in parentheses those that stay upright."""
    return f"{100 * shares[0]:.1f} ({100 * shares[1]:.1f})"


def by_ground(policies: Mapping[tuple[str, str], Settings]) -> Table:
    """Means over the settings of each ground, and how many settings there are in all."""
    columns = {ground: (ground,) for ground in GROUNDS}
    columns |= {"all but flat": tuple(GROUNDS)[1:], "all": tuple(GROUNDS)}
    rows = []
    for policy, settings in policies.items():
        cells = []
        for grounds in columns.values():
            shares = [values for place, values in settings.items() if place.ground in grounds]
            cell = percent(np.mean([s.fault for s in shares], axis=0)) if shares else "-"
            if shares and len(grounds) == 1:
                healthy = percent(np.mean([s.healthy for s in shares], axis=0))
                switches = np.mean([s.healthy_switches for s in shares])
                cell += f" [{healthy}, {switches:.2f}]"
            cells.append(cell)
        rows.append((*policy, *cells, len(settings)))
    title = "Crossed (upright), %, by ground; in brackets: with a healthy camera, switches"
    return title, ("policy", "mode", *columns, "settings"), rows


def by_severity(policies: Mapping[tuple[str, str], Settings]) -> Table:
    """Crossed on all ground but the flat, and upright on all."""
    severities = sorted({place.severity for settings in policies.values() for place in settings})
    rows = []
    for policy, settings in policies.items():
        cells = []
        for severity in severities:
            shares = [(p.ground, s.fault) for p, s in settings.items() if p.severity == severity]
            tiles = [share[0] for ground, share in shares if ground != "flat"]
            both = tiles and [np.mean(tiles), np.mean([share[1] for _, share in shares])]
            cells.append(percent(np.array(both)) if both else "-")
        rows.append((*policy, *cells))
    title = "Crossed on tiles (upright on all ground), %, by severity"
    return title, ("policy", "mode", *map(str, severities)), rows


def losses(policy: str, vp: Settings) -> Table:
    """Points of crossing that VP loses to its healthy twins under severe faults, by fault."""
    points: dict[tuple[str, str], list[float]] = defaultdict(list)
    for place, shares in vp.items():
        if place.severity >= SEVERE:
            lost = 100 * (shares.healthy[0] - shares.fault[0])
            points[place.fault, place.ground].append(lost)
    means = {key: float(np.mean(values)) for key, values in points.items()}
    rows = [
        (*key, f"{means[key]:.0f}")
        for key in sorted(means, key=lambda key: -means[key])
        if means[key] >= MENTIONED
    ]
    title = f"Points of crossing that VP loses from severity {SEVERE} on, {policy}"
    return title, ("fault", "ground", "points"), rows


def separation(policy: str, vp: Settings, renet: Settings) -> Table:
    """Settings in which one is ten points behind the other, of those in which a fault harms."""
    header = ("settings", "RENet ahead", "VP ahead", "harmed", "and RENet ahead", "and VP ahead")
    counts: dict[str, np.ndarray] = defaultdict(lambda: np.zeros(len(header), int))
    for place in vp:
        pair = vp[place], renet[place]
        # Harm to either: chance that lowers one of the two alone would speak for the other.
        harmed = any((shares.healthy - shares.fault > LOSS).any() for shares in pair)
        gain = pair[1].fault - pair[0].fault
        ahead, behind = bool((gain > LOSS).any()), bool((-gain > LOSS).any())
        row = np.array([1, ahead, behind, harmed, harmed and ahead, harmed and behind])
        for key in (place.ground, "platforms and gaps" if place.ground in BLIND else "elsewhere"):
            counts[key] += row
    title = f"Settings in which RENet or VP is ten points ahead, {policy}"
    return title, ("ground", *header), [(key, *row.tolist()) for key, row in counts.items()]


def paired(result: Mapping[str, Any]) -> Table:
    """RENet less VP, robot by robot over all settings, in points with 95 % intervals."""
    vp, renet = (result["by_robot"][mode] for mode in ("vp", "renet"))
    settings = Counter(row["ground"] for row in result["settings"] if row["mode"] == "vp")
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


def study_tables(path: Path) -> Iterator[Table]:
    """Who noticed which fault, and what a study claims.

    Args:
        path: summary.csv of a fault study.

    Raises:
        RenetError: it is none.
    """
    rows = list(csv.DictReader(path.read_text().splitlines() if path.is_file() else ()))
    if not rows or "over_op" not in rows[0]:
        raise RenetError(f"{path} is no summary.csv of the study `renet evaluate faults`")
    runs = [{name: _number(text) for name, text in row.items()} for row in rows]
    yield noticed(runs)
    yield claims(runs)


def _number(text: str) -> Any:
    """What a cell of a CSV file holds; None where it is empty."""
    for kind in (int, float):
        with suppress(ValueError):
            return kind(text)
    return text or None


def noticed(runs: Sequence[Mapping[str, Any]]) -> Table:
    """Robots in mode renet that noticed a fault, of those that used vision, by severity."""
    counts: dict[str, Counter[int]] = defaultdict(Counter)
    robots: dict[str, int] = Counter()
    for run in runs:
        if run["mode"] == "renet":
            counts[run["fault"]][run["severity"]] += run["detected"]
            robots[run["fault"]] += run["vision_active_at_onset"]
    severities = sorted({severity for count in counts.values() for severity in count})
    rows = [
        (fault, *(count[severity] for severity in severities), robots[fault] // len(count))
        for fault, count in counts.items()
    ]
    return "Robots that noticed, by severity", ("fault", *map(str, severities), "of each"), rows


def claims(runs: Sequence[Mapping[str, Any]]) -> Table:
    """The study's claims, and settings in which RENet falls more often than OP robot by robot."""
    twins = [
        {**run, "falls": run["falls"] - run["falls_by_fault"] + run["falls_spared"]}
        for run in runs
        if run["mode"] != "renet"
    ]
    summary = findings(list(map(dict, runs)), twins, {"robot_hours": 0})
    rows = [(claim["claim"], claim["measured"]) for claim in summary["claims"]]
    below = Counter(run["ground"] for run in runs if (run["over_op_ci95_high"] or 0) < 0)
    counts = ", ".join(f"{ground} {number}" for ground, number in below.items()) or "none"
    rows.append(("settings in which RENet falls more often than OP, interval below 0", counts))
    return "What is claimed, and what was measured", ("claim", "measured"), rows
