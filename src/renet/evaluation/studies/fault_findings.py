"""Findings of the study of single faults: claims, harmful settings, faults that go unnoticed.

A walk over obstacles is chaotic: twins diverge by chance, in both directions. Falls under a fault
are therefore compared with those of the same robots without it by Fisher's exact test (1922).
"""

from typing import Any

import numpy as np
import scipy

from renet.evaluation.figures import setting_label
from renet.evaluation.results import grouped
from renet.evaluation.studies.fault_settings import Setting
from renet.terrain.tiles import DIFFICULT

Runs = list[dict[str, Any]]
CHANCE = 0.05
"""Probability below which a difference is not put down to chance."""
MARGIN = 0.02
"""Survival in mode memory may be this much below blind's before a setting is listed as harmful."""
SEVERE = 3
"""Severity from which a fault that makes robots in mode camera fall must be noticed."""
BLIND = {"frozen": ("frozen",), "uniform": ("blackout", "saturated", "occlusion")}
"""Faults whose severity 5 repeats one image, or leaves one value in the whole image."""


def setting_of(run: dict[str, Any]) -> Setting:
    """The setting of a row."""
    return Setting(*(run[name] for name in Setting._fields))


def findings(runs: Runs, baseline: Runs, healthy: dict[str, Any]) -> dict[str, Any]:
    """`harmful`, `missed` and `claims` of a summary, from `runs`, `baseline` and `healthy`.

    A claim is a row: `claim`, whether it is `met`, and what was `measured`.

    Args:
        runs: with their pairs, see `fault_metrics`. baseline: the same grounds without faults.
        healthy: false switches and robot hours.
    """
    harm, misses = harmful(runs, baseline), missed(runs, baseline)
    simple = [h for h in harm if h["ground"] not in DIFFICULT]
    severe = [miss for miss in misses if miss["severity"] >= SEVERE]
    claims = [
        _chance_claim(
            "on simple ground no fault makes memory fall more often than blind, beyond chance",
            simple,
            "settings below",
        ),
        _chance_claim(
            f"no fault of severity >= {SEVERE} that makes camera fall goes unnoticed",
            severe,
            "settings not noticed by every robot",
        ),
        *_delay_claim(runs, baseline),
        *_false_switch_claim(healthy),
        *_blind_claims(runs),
    ]
    return {"harmful": harm, "missed": misses, "claims": claims}


def harmful(runs: Runs, baseline: Runs) -> Runs:
    """Settings in which robots survive less often in mode memory than blind, beyond the margin.

    Chance is judged fault by fault on each ground, all severities and onsets together.
    """
    survival = {setting_of(r): r["survival"] for r in runs if r["mode"] == "blind"}
    worse = _beyond_chance(runs, baseline, "memory", "blind")
    return [
        setting_of(r)._asdict()
        | {
            "memory": r["survival"],
            "blind": survival[setting_of(r)],
            "over_op_ci95": [r["over_op_ci95_low"], r["over_op_ci95_high"]],
            "beyond_chance": (r["ground"], r["fault"]) in worse,
        }
        for r in runs
        if r["mode"] == "memory" and r["over_op"] is not None and r["over_op"] < -MARGIN
    ]


def settings_vp_falls_in(runs: Runs, baseline: Runs) -> dict[Setting, dict[str, Any]]:
    """Rows of mode camera, by setting, of the settings with more falls than its healthy twins have.

    `beyond_chance` is judged from all of a fault's severe settings on the ground together (of its
    mild ones where it has no severe ones).
    """
    severe = [r for r in runs if r["severity"] >= SEVERE]
    mild = {r["fault"] for r in runs} - {r["fault"] for r in severe}
    judged = severe + [r for r in runs if r["fault"] in mild]
    worse = _beyond_chance(judged, baseline, "camera", "camera")
    return {
        setting_of(r): r | {"beyond_chance": (r["ground"], r["fault"]) in worse}
        for r in runs
        if r["mode"] == "camera" and r["falls_by_fault"] > r["falls_spared"]
    }


def missed(runs: Runs, baseline: Runs) -> Runs:
    """Faults that make mode camera fall and that not every robot in mode memory notices."""
    vp_rows = settings_vp_falls_in(runs, baseline)
    return [
        setting_of(r)._asdict()
        | {
            "undetected": r["vision_active_at_onset"] - r["detected"],
            "vp_falls": vp["falls_by_fault"],
            "vp_spared": vp["falls_spared"],
            "beyond_chance": vp["beyond_chance"],
        }
        for r in runs
        if r["mode"] == "memory" and r["detected"] < r["vision_active_at_onset"]
        if (vp := vp_rows.get(setting_of(r)))
    ]


def _beyond_chance(runs: Runs, baseline: Runs, mode: str, reference: str) -> set[tuple[Any, ...]]:
    """Grounds and faults under which `mode` falls more, beyond chance, than `reference` without."""

    def count(rows: Runs) -> tuple[int, int]:
        falls = sum(row["falls"] for row in rows)
        return falls, sum(row["robots"] for row in rows) - falls

    usual = {r["ground"]: [r] for r in baseline if r["mode"] == reference}
    groups = grouped([r for r in runs if r["mode"] == mode], "ground", "fault")
    tables = {
        place: [count(rows), count(usual[place[0]])]
        for place, rows in groups.items()
        if place[0] in usual
    }
    return {p for p, t in tables.items() if scipy.stats.fisher_exact(t, "greater").pvalue < CHANCE}


def _chance_claim(claim: str, settings: Runs, what: str) -> dict[str, Any]:
    """The claim that chance explains all settings: how many it cannot, and which it can."""
    clear = [setting_label(s) for s in settings if s["beyond_chance"]]
    unclear = [setting_label(s) for s in settings if not s["beyond_chance"]]
    named = ": " + ", ".join(clear) if clear else ""
    aside = f" ({', '.join(unclear)} within chance)" if unclear else ""
    measured = f"{len(clear)} {what}{named}{aside}"
    return {"claim": claim, "met": not clear, "measured": measured}


def _false_switch_claim(healthy: dict[str, Any]) -> Runs:
    """Nothing is said of healthy hours where there are none."""
    if not healthy["robot_hours"]:
        return []
    rate, limit = healthy["false_switches_per_hour"], healthy["upper_95_per_hour"]
    measured = (
        f"{rate:.2f} ({healthy['false_switches']} in {healthy['robot_hours']:.2f} robot hours;"
        f" 95 % limit {limit:.2f})"
    )
    claim = "at most 1 false switch per healthy hour"
    return [{"claim": claim, "met": rate <= 1.0, "measured": measured}]


def _delay_claim(runs: Runs, baseline: Runs) -> Runs:
    """Median of severe settings' median delays where mode camera falls; empty if it never does."""
    vp = settings_vp_falls_in(runs, baseline)
    where = [
        r
        for r in runs
        if r["mode"] == "memory" and r["detection_delay_s"] is not None and r["severity"] >= SEVERE
        if setting_of(r) in vp and vp[setting_of(r)]["beyond_chance"]
    ]
    if not where:
        return []
    delay = float(np.median([r["detection_delay_s"] for r in where]))
    worst = max(where, key=lambda r: r["detection_delay_p95_s"])
    claim = f"median detection within 0.2 s of faults of severity >= {SEVERE} that make camera fall"
    measured = (
        f"{delay:.3f} s; worst 95th percentile {worst['detection_delay_p95_s']:.2f} s"
        f" ({setting_label(worst)})"
    )
    return [{"claim": claim, "met": delay <= 0.2, "measured": measured}]


def _blind_claims(runs: Runs) -> Runs:
    """Frozen and uniform images: noticed by the monitors, and by the rule of mode switch."""
    worst = [run for run in runs if run["mode"] == "memory" and run["severity"] == 5]
    claims = []
    for what, faults in BLIND.items():
        names = ("vision_active_at_onset", "detected", "detected_by_paper")
        robots, detected, paper = (
            sum(run[name] for run in worst if run["fault"] in faults) for name in names
        )
        if robots:
            measured = f"{detected} of {robots} robots; by the rule of mode switch {paper}"
            claim = f"{what} images are noticed"
            claims.append({"claim": claim, "met": detected == robots, "measured": measured})
    return claims
