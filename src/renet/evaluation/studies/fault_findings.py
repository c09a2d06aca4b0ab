"""Findings of the study of single faults: claims, harmful settings and missed faults.

A walk over obstacles is chaotic: twins diverge by chance, in both directions. Falls under a fault
are therefore compared with falls of the same robots without it, by Fisher's exact test (1922). A
robot counts once, however many settings it walks in, for it often falls alike in several of them.
"""

from typing import Any

import numpy as np
import scipy

from renet.evaluation.figures import setting_label
from renet.evaluation.results import column, group_by, select
from renet.evaluation.studies.fault_settings import Setting
from renet.terrain.tiles import DIFFICULT

Runs = list[dict[str, Any]]
"""Rows of a summary."""
_SIGNIFICANCE = 0.05
"""Probability below which a difference is called significant."""
_SURVIVAL_MARGIN = 0.02
"""Difference in survival from mode blind to mode memory from which on a setting is harmful."""
_SEVERE = 3
"""Severity from which a fault that makes robots in mode camera fall must be noticed."""
BLINDING_FAULTS = {"frozen": ("frozen",), "uniform": ("blackout", "saturated", "occlusion")}
"""Faults that at severity 5 repeat one image, or leave one value in the whole image."""


def setting_of(run: dict[str, Any]) -> Setting:
    """Return the setting of a row."""
    return Setting(run["ground"], run["onset"], run["fault"], run["severity"])


def findings(runs: Runs, baseline: Runs, healthy: dict[str, Any]) -> dict[str, Any]:
    """Find `harmful` and `missed` settings in a summary's rows, and judge its `claims`.

    A claim is a row with its text in `claim`, `met`, a bool, and the numbers in `measured`. Claims
    about modes, grounds or faults that are not among the rows are left out.

    Args:
        runs: Rows with their pairs, see `fault_metrics`.
        baseline: Rows of the same grounds without faults.
        healthy: False switches and robot hours.
    """
    harm = harmful(runs, baseline)
    misses = missed(runs, baseline)
    claims = [
        *_harm_claim(runs, harm),
        *_missed_claim(runs, misses),
        *_delay_claim(runs, baseline),
        *_false_switch_claim(healthy),
        *_blind_claims(runs),
    ]
    return {"harmful": harm, "missed": misses, "claims": claims}


def harmful(runs: Runs, baseline: Runs) -> Runs:
    """List settings in which robots survive less often in mode memory than in mode blind.

    Significance is judged for each fault on each ground, over all severities and onsets.
    """
    survival = {setting_of(run): run["survival"] for run in select(runs, mode="blind")}
    worse = _beyond_chance(runs, baseline, "memory", "blind")
    rows = []
    for run in select(runs, mode="memory"):
        if run["over_op"] is None or run["over_op"] >= -_SURVIVAL_MARGIN:
            continue
        setting = setting_of(run)
        row = {
            "memory": run["survival"],
            "blind": survival[setting],
            "over_op_ci95": [run["over_op_ci95_low"], run["over_op_ci95_high"]],
            "beyond_chance": (run["ground"], run["fault"]) in worse,
        }
        rows.append(setting._asdict() | row)
    return rows


def settings_vp_falls_in(runs: Runs, baseline: Runs) -> dict[Setting, dict[str, Any]]:
    """Return mode camera's rows, by setting, in which more robots fall than of their healthy twins.

    `beyond_chance` is judged over all severe settings of the fault on the ground, or over its mild
    ones if it has no severe ones.
    """
    severe = [run for run in runs if run["severity"] >= _SEVERE]
    mild = set(column(runs, "fault")) - set(column(severe, "fault"))
    judged = severe + [run for run in runs if run["fault"] in mild]
    worse = _beyond_chance(judged, baseline, "camera", "camera")
    rows = {}
    for run in select(runs, mode="camera"):
        if run["falls_by_fault"] > run["falls_spared"]:
            beyond_chance = (run["ground"], run["fault"]) in worse
            rows[setting_of(run)] = run | {"beyond_chance": beyond_chance}
    return rows


def missed(runs: Runs, baseline: Runs) -> Runs:
    """List settings that make mode camera fall and that not every robot in mode memory notices."""
    camera_rows = settings_vp_falls_in(runs, baseline)
    rows = []
    for run in select(runs, mode="memory"):
        if run["detected"] >= run["vision_active_at_onset"]:
            continue
        setting = setting_of(run)
        camera = camera_rows.get(setting)
        if camera is None:
            continue
        row = {
            "undetected": run["vision_active_at_onset"] - run["detected"],
            "vp_falls": camera["falls_by_fault"],
            "vp_spared": camera["falls_spared"],
            "beyond_chance": camera["beyond_chance"],
        }
        rows.append(setting._asdict() | row)
    return rows


def _beyond_chance(runs: Runs, baseline: Runs, mode: str, reference: str) -> set[tuple[Any, ...]]:
    """List grounds and faults under which a mode falls significantly more than one without faults.

    Args:
        runs: Rows under faults.
        baseline: Rows without faults.
        mode: Mode under faults.
        reference: Mode without faults.
    """
    usual = group_by(select(baseline, mode=reference), "ground")
    groups = group_by(select(runs, mode=mode), "ground", "fault")
    worse = set()
    for place, rows in groups.items():
        ground = place[:1]
        if ground not in usual:
            continue
        # Fallen and upright robots with the fault, and without.
        table = [_fall_counts(rows), _fall_counts(usual[ground])]
        if scipy.stats.fisher_exact(table, "greater").pvalue < _SIGNIFICANCE:
            worse.add(place)
    return worse


def _fall_counts(rows: Runs) -> tuple[int, int]:
    """Count robots that fell, and that did not; means over rows of the same robots."""
    # Rounded down, so that chance is not called a fault.
    falls = sum(column(rows, "falls")) // len(rows)
    return falls, rows[0]["robots"] - falls


def _harm_claim(runs: Runs, harm: Runs) -> Runs:
    """Make the claim on harm by memory on simple ground; none unless blind walks there, too."""
    compared = [run for run in select(runs, mode="memory") if run["over_op"] is not None]
    if all(run["ground"] in DIFFICULT for run in compared):
        return []
    simple = [row for row in harm if row["ground"] not in DIFFICULT]
    claim = "on simple ground no fault makes memory fall more often than blind, beyond chance"
    return [_chance_claim(claim, simple, "settings below")]


def _missed_claim(runs: Runs, misses: Runs) -> Runs:
    """Make the claim on missed severe faults; none unless memory and camera walk with one."""
    severe = [run for run in runs if run["severity"] >= _SEVERE]
    if not (select(severe, mode="memory") and select(severe, mode="camera")):
        return []
    severe_misses = [miss for miss in misses if miss["severity"] >= _SEVERE]
    claim = f"no fault of severity >= {_SEVERE} that makes camera fall goes unnoticed"
    return [_chance_claim(claim, severe_misses, "settings not noticed by every robot")]


def _chance_claim(claim: str, settings: Runs, what: str) -> dict[str, Any]:
    """Make the claim that chance explains all settings; it names them, those beyond it first."""
    clear = list(map(setting_label, select(settings, beyond_chance=True)))
    unclear = list(map(setting_label, select(settings, beyond_chance=False)))
    beyond = ": " + ", ".join(clear) if clear else ""
    within = f" ({', '.join(unclear)} within chance)" if unclear else ""
    measured = f"{len(clear)} {what}{beyond}{within}"
    return {"claim": claim, "met": not clear, "measured": measured}


def _false_switch_claim(healthy: dict[str, Any]) -> Runs:
    """Make the claim on false switches in healthy hours; none if there are no such hours."""
    if not healthy["robot_hours"]:
        return []
    rate = healthy["false_switches_per_hour"]
    limit = healthy["upper_95_per_hour"]
    measured = (
        f"{rate:.2f} ({healthy['false_switches']} in {healthy['robot_hours']:.2f} robot hours;"
        f" 95 % limit {limit:.2f})"
    )
    claim = "at most 1 false switch per healthy hour"
    return [{"claim": claim, "met": rate <= 1.0, "measured": measured}]


def _delay_claim(runs: Runs, baseline: Runs) -> Runs:
    """Make the claim on the median delay of severe faults that make mode camera fall, if any do."""
    camera_rows = settings_vp_falls_in(runs, baseline)
    harmful_runs = []
    for run in select(runs, mode="memory"):
        if run["detection_delay_s"] is None or run["severity"] < _SEVERE:
            continue
        camera = camera_rows.get(setting_of(run))
        if camera is not None and camera["beyond_chance"]:
            harmful_runs.append(run)
    if not harmful_runs:
        return []
    delay = float(np.median(column(harmful_runs, "detection_delay_s")))
    worst = max(harmful_runs, key=lambda run: run["detection_delay_p95_s"])
    claim = (
        f"median detection within 0.2 s of faults of severity >= {_SEVERE} that make camera fall"
    )
    measured = (
        f"{delay:.3f} s; worst 95th percentile {worst['detection_delay_p95_s']:.2f} s"
        f" ({setting_label(worst)})"
    )
    return [{"claim": claim, "met": delay <= 0.2, "measured": measured}]


def _blind_claims(runs: Runs) -> Runs:
    """Make the claims that monitors notice frozen and uniform images, beside mode switch's rule."""
    # Severity 5 repeats one image, or leaves one value in it.
    worst = select(runs, mode="memory", severity=5)
    claims = []
    for what, faults in BLINDING_FAULTS.items():
        rows = [run for run in worst if run["fault"] in faults]
        robots = sum(column(rows, "vision_active_at_onset"))
        detected = sum(column(rows, "detected"))
        paper = sum(column(rows, "detected_by_paper"))
        if robots:
            measured = f"{detected} of {robots} robots; by the rule of mode switch {paper}"
            claim = f"{what} images are noticed"
            claims.append({"claim": claim, "met": detected == robots, "measured": measured})
    return claims
