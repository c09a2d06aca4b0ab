"""The top of the report: the large numbers, and everything that went wrong, in plain sight."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from renet.evaluation.figures import MODE_NAMES
from renet.evaluation.noise_page import facts as noise_facts
from renet.evaluation.page import Page

Found = Mapping[str, dict[str, Any]]
"""Summaries by study."""


def glance_section(page: Page, found: Found) -> None:
    """Large numbers of every study there is."""
    bundles = {summary["provenance"]["bundle_hash"][:10] for summary in found.values()}
    if len(bundles) > 1:
        page.text(
            f"Careful: these studies were made with {len(bundles)} different bundles,"
            f" {', '.join(sorted(bundles))}. Run `renet evaluate report --run` to compare like with"
            " like."
        )
    made = [make(found[name]) for name, make in FACTS.items() if name in found]
    page.facts([fact for facts in made for fact in facts])


def worse_section(page: Page, found: Found) -> None:
    """Where RENet does worse than never looking, and what it does not notice."""
    page.heading("Where RENet does worse than never looking")
    page.text(
        "Settings in which fewer robots survive or get across with RENet than with the OP"
        " estimator alone, by more than 2 points, and faults that make VP fall and that not every"
        " robot noticed. Robots fall over obstacles by themselves, too: “within chance” is a"
        " difference that the same robots show as easily without the fault (sign test, 5 %)."
    )
    rows = [row for name, make in WORSE.items() if name in found for row in make(found[name])]
    page.table(
        ["study", "setting", "RENet", "OP alone"],
        rows or [("none of what was run", "", "", "")],
        text=2,
    )


def _faults(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """What was not measured is left out."""
    renet = [run for run in summary["runs"] if run["mode"] == "renet"]
    total = {name: sum(run[name] for run in renet) for name in ("robots", "falls", "watching")}
    rate = summary["healthy"]["false_switches_per_hour"]
    facts = []
    if total["robots"]:
        share = 1 - total["falls"] / total["robots"]
        facts.append((_percent(share), "of RENet's robots survive a camera fault"))
    if total["watching"]:
        share = sum(run["detected"] for run in renet) / total["watching"]
        facts.append((_percent(share), "of failing cameras are noticed"))
    if rate is not None:
        facts.append((f"{rate:.1f}", "false switches per healthy robot hour"))
    return facts


def _terrain(summary: dict[str, Any]) -> list[tuple[str, str]]:
    text = " / ".join(f"{level:.1f}" for level in summary["levels"].values())
    policy = MODE_NAMES[summary["settings"]["mode"]]
    return [(text, f"{policy}'s levels of 10 on {', '.join(summary['levels'])}")] if text else []


def _course(summary: dict[str, Any]) -> list[tuple[str, str]]:
    return [
        (
            f"{total['distance_m'] / 1000:.2f} km",
            f"walked by RENet's robots on the course; {total['falls']} falls,"
            f" {total['stuck']} times stuck",
        )
        for total in summary["totals"]
        if total["mode"] == "renet"
    ]


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def _worse_faults(summary: dict[str, Any]) -> list[tuple[str, str, str, str]]:
    harmful = [
        (
            "faults",
            f"{f['fault']} {f['severity']}" + _doubt(f),
            _percent(f["renet"]),
            _percent(f["op"]),
        )
        for f in summary["harmful"]
    ]
    missed = [
        (
            "faults",
            f"{m['fault']} {m['severity']} goes unnoticed; {m['vp_falls']} fall with VP only"
            f" then, {m['vp_spared']} only without it" + _doubt(m),
            f"{m['undetected']} robots",
            "",
        )
        for m in summary["missed"]
    ]
    return harmful + missed


def _doubt(finding: dict[str, Any]) -> str:
    return "" if finding["beyond_chance"] else " (within chance)"


def _worse_success(summary: dict[str, Any]) -> list[tuple[str, str, str, str]]:
    return [
        (
            "obstacles",
            f"{w['kind'].replace('_', ' ')} {100 * w['size_m']:.0f} cm",
            _percent(w["renet"]),
            _percent(w["op"]),
        )
        for w in summary["worse"]
    ]


def _worse_course(summary: dict[str, Any]) -> list[tuple[str, str, str, str]]:
    blind = {row["kind"]: row for row in summary["passages"] if row["mode"] == "op"}
    return [
        (
            "course",
            row["kind"],
            f"{row['crossed']} of {row['tries']}",
            f"{blind[row['kind']]['crossed']} of {blind[row['kind']]['tries']}",
        )
        for row in summary["passages"]
        if row["mode"] == "renet"
        and row["kind"] in blind
        and row["crossed"] / row["tries"]
        < blind[row["kind"]]["crossed"] / blind[row["kind"]]["tries"] - 0.02
    ]


FACTS = {"noise": noise_facts, "faults": _faults, "course": _course, "terrain": _terrain}
WORSE = {"faults": _worse_faults, "success": _worse_success, "course": _worse_course}
