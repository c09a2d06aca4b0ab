"""The top of the report: the large numbers, and everything that went wrong."""

from collections import Counter
from collections.abc import Mapping
from typing import Any

from renet.evaluation.figures import setting_label
from renet.evaluation.report.page import Section, render

Summaries = Mapping[str, dict[str, Any]]
"""Contents of summary.json, by study."""
Row = tuple[str, str, str, str]
"""Study, setting, RENet's number, and that of OP alone."""


def overview_section(summaries: Summaries) -> Section:
    """Large numbers of every study there is, and a warning where bundles differ."""
    bundles = sorted({summary["provenance"]["bundle_hash"][:10] for summary in summaries.values()})
    groups = [make(summaries[name]) for name, make in FACTS.items() if name in summaries]
    return render("overview", bundles=bundles, facts=[fact for group in groups for fact in group])


def worse_section(summaries: Summaries) -> Section:
    """Settings in which RENet does worse than OP alone, and faults it does not notice."""
    groups = [make(summaries[name]) for name, make in WORSE.items() if name in summaries]
    rows = [row for group in groups for row in group]
    faults = summaries.get("faults")
    chance = _worse_faults(faults, beyond_chance=False) if faults else []
    return render("worse", rows=rows, chance=chance)


def gap_headline(summary: dict[str, Any]) -> str:
    """One sentence that says who crossed the demo's gap."""
    crossed = {run["mode"]: run["crossed"] for run in summary["runs"]}
    others = {
        "camera": "that trust the last image",
        "switch": "with the paper's switch",
        "oracle": "that go blind at once",
    }
    counts = ", ".join(f"{crossed[mode]} {how}" for mode, how in others.items() if mode in crossed)
    remembers = "which remembers it" if summary["remembers"] else "which has no memory here"
    ours = f"{crossed['memory']} cross with RENet, {remembers};" if "memory" in crossed else "cross"
    return (
        f"The camera dies {summary['before_s']} s before a gap of {100 * summary['gap_m']:.0f} cm:"
        f" of {summary['runs'][0]['robots']} robots {ours} {counts}."
    )


def noise_headline(summary: dict[str, Any]) -> str:
    """One sentence that says what the noise study measured."""
    runs = summary["runs"]
    falls, trials = Counter[str](), Counter[str]()
    for run in runs:
        falls[run["mode"]] += run["falls"]
        trials[run["mode"]] += 1
    kinds = max(trials.values())
    counts = ", ".join(f"{falls[mode]} with {mode}" for mode in trials)
    return (
        f"{kinds} kinds of camera noise, {kinds * runs[0]['robots']} robots each; falls: {counts}."
    )


def noise_facts(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """Large numbers of the noise study; none where RENet was not run."""
    renet = [run for run in summary["runs"] if run["mode"] == "memory"]
    if not renet:
        return []
    speeds = [v for run in renet if (v := run["mean_forward_velocity"]) is not None]
    delays = [r["detection_delay_s"] for r in renet if r["detection_delay_s"] is not None]
    robots = sum(run["robots"] for run in renet)
    upright = robots - sum(run["falls"] for run in renet)
    return [
        (f"{upright} of {robots}", "RENet robots on their feet"),
        (
            f"{min(speeds):.2f}–{max(speeds):.2f} m/s" if speeds else "–",
            "RENet's mean speed under noise",
        ),
        (f"{1000 * max(delays):.0f} ms" if delays else "none", "slowest median switch to OP"),
        (str(summary["healthy"]["false_switches"]), "false switches while the camera was healthy"),
    ]


def _faults(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """What was not measured is left out."""
    renet = [run for run in summary["runs"] if run["mode"] == "memory"]
    robots, falls, watching, noticed = (
        sum(run[name] for run in renet)
        for name in ("robots", "falls", "vision_active_at_onset", "detected")
    )
    rate = summary["healthy"]["false_switches_per_hour"]
    facts = []
    if robots:
        facts.append((_percent(1 - falls / robots), "of RENet's robots survive a camera fault"))
    if watching:
        facts.append((_percent(noticed / watching), "of failing cameras are noticed"))
    if rate is not None:
        facts.append((f"{rate:.1f}", "false switches per healthy robot hour"))
    return facts


def _terrain(summary: dict[str, Any]) -> list[tuple[str, str]]:
    text = " / ".join(f"{level:.1f}" for level in summary["levels"].values())
    policy = summary["settings"]["modes"][0]
    return [(text, f"{policy}'s levels of 10 on {', '.join(summary['levels'])}")] if text else []


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def _worse_faults(summary: dict[str, Any], *, beyond_chance: bool = True) -> list[Row]:
    harmful = [
        ("faults", setting_label(f), _percent(f["memory"]), _percent(f["blind"]))
        for f in summary["harmful"]
        if f["beyond_chance"] == beyond_chance
    ]
    return harmful + [
        (
            "faults",
            f"{setting_label(m)} goes unnoticed; {m['vp_falls']} fall with VP only"
            f" then, {m['vp_spared']} only without it",
            f"{m['undetected']} robots",
            "",
        )
        for m in summary["missed"]
        if m["beyond_chance"] == beyond_chance
    ]


def _worse_success(summary: dict[str, Any]) -> list[Row]:
    tiles = [f"{w['kind'].replace('_', ' ')} {100 * w['size_m']:.0f} cm" for w in summary["worse"]]
    shares = [(_percent(w["memory"]), _percent(w["blind"])) for w in summary["worse"]]
    return [("obstacles", tile, *pair) for tile, pair in zip(tiles, shares, strict=True)]


FACTS = {"noise": noise_facts, "faults": _faults, "terrain": _terrain}
WORSE = {"faults": _worse_faults, "success": _worse_success}
