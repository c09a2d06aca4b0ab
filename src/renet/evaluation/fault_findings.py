"""What the rows of the fault benchmark add up to: promises kept and broken, harm and misses."""

from __future__ import annotations

from typing import Any

import numpy as np

MARGIN = 0.02
"""RENet's survival may be this much below OP's before a fault is listed as harmful."""
SEVERE = 3
"""Severity from which a fault that makes VP fall must be noticed."""
FROZEN = ("frozen",)
UNIFORM = ("blackout", "saturated", "occlusion")
"""Faults whose severity 5 leaves one value in the whole image."""

Runs = list[dict[str, Any]]


def findings(runs: Runs, baseline: Runs, healthy: dict[str, Any]) -> dict[str, Any]:
    """`harmful`, `missed` and `claims` of a summary, from `runs`, `baseline` and `healthy`."""
    harm, misses = harmful(runs), missed(runs, baseline)
    claims = [
        _claim(
            "survival at least OP alone's minus 2 points, every setting",
            not harm,
            f"{len(harm)} settings below",
        ),
        _claim(
            f"no fault of severity >= {SEVERE} that makes VP fall goes unnoticed",
            not [miss for miss in misses if miss["severity"] >= SEVERE],
            f"{sum(miss['undetected'] for miss in misses if miss['severity'] >= SEVERE)} robots did"
            " not notice",
        ),
        *_delay_claim(runs, baseline),
        _claim(
            "at most 1 false switch per healthy hour",
            healthy["false_switches_per_hour"] <= 1.0,
            f"{healthy['false_switches_per_hour']:.2f} ({healthy['false_switches']} in"
            f" {healthy['robot_hours']:.2f} robot hours; 95 % limit"
            f" {healthy['upper_95_per_hour']:.2f})",
        ),
        *_blind_claims(runs),
    ]
    return {"harmful": harm, "missed": misses, "claims": claims}


def harmful(runs: Runs) -> Runs:
    """Faults under which RENet survives less often than OP alone would, beyond the margin."""
    op = {(r["fault"], r["severity"]): r["survival"] for r in runs if r["mode"] == "op"}
    return [
        {"fault": r["fault"], "severity": r["severity"], "renet": r["survival"], "op": other}
        for r in runs
        if r["mode"] == "renet"
        and (other := op.get((r["fault"], r["severity"]))) is not None
        and r["survival"] < other - MARGIN
    ]


def caused(runs: Runs, baseline: Runs) -> dict[tuple[str, int], int]:
    """How many more robots fall under VP alone than with healthy cameras, by fault and severity."""
    usual = {run["terrain"]: run["falls"] for run in baseline if run["mode"] == "vp"}
    return {
        (run["fault"], run["severity"]): run["falls"] - usual.get(run["terrain"], 0)
        for run in runs
        if run["mode"] == "vp"
    }


def missed(runs: Runs, baseline: Runs) -> Runs:
    """Faults that make VP fall and that the selector did not notice on every robot."""
    falls = caused(runs, baseline)
    return [
        {
            "fault": r["fault"],
            "severity": r["severity"],
            "undetected": r["watching"] - r["detected"],
            "vp_falls": falls[r["fault"], r["severity"]],
        }
        for r in runs
        if r["mode"] == "renet"
        and falls.get((r["fault"], r["severity"]), 0) > 0
        and r["detected"] < r["watching"]
    ]


def _claim(claim: str, met: bool, measured: str) -> dict[str, Any]:
    return {"claim": claim, "met": bool(met), "measured": measured}


def _delay_claim(runs: Runs, baseline: Runs) -> Runs:
    """The median of the settings' median delays, where VP falls; of all if it never does."""
    falls = {setting for setting, more in caused(runs, baseline).items() if more > 0}
    noticed = [r for r in runs if r["mode"] == "renet" and r["detection_delay_s"] is not None]
    where = [r for r in noticed if (r["fault"], r["severity"]) in falls] or noticed
    if not where:
        return []
    delay = float(np.median([r["detection_delay_s"] for r in where]))
    worst = max(where, key=lambda r: r["detection_delay_p95_s"])
    return [
        _claim(
            "median detection within 0.2 s of faults that make VP fall",
            delay <= 0.2,
            f"{delay:.3f} s; worst 95th percentile {worst['detection_delay_p95_s']:.2f} s"
            f" ({worst['fault']} {worst['severity']})",
        )
    ]


def _blind_claims(runs: Runs) -> Runs:
    """Frozen and uniform images: noticed by the monitors, and what the paper's rule alone does."""
    claims = []
    for what, faults in (("frozen", FROZEN), ("uniform", UNIFORM)):
        rows = [r for r in runs if r["mode"] == "renet" and r["fault"] in faults]
        rows = [r for r in rows if r["severity"] == 5]
        robots = sum(r["watching"] for r in rows)
        if robots:
            detected = sum(r["detected"] for r in rows)
            paper = sum(r["detected_by_paper"] for r in rows)
            claims.append(
                _claim(
                    f"{what} images are noticed",
                    detected == robots,
                    f"{detected} of {robots} robots; by the paper's rule alone {paper}",
                )
            )
    return claims
