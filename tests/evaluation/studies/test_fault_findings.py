from itertools import product

import numpy as np
import pytest
from scipy.stats import binom

from renet.evaluation.studies.fault_findings import findings, harmful, missed


def run(fault: str, mode: str, falls: int = 0, severity: int = 3, **values) -> dict:
    """Ten robots of which some fall, by the fault unless said otherwise."""
    row = {"fault": fault, "severity": severity, "ground": "flat", "onset": 0.5, "mode": mode}
    row |= {"survival": 1 - falls / 10, "falls": falls, "robots": 10, "over_op": None}
    row |= {"falls_by_fault": falls, "falls_spared": 0}
    row |= {"vision_active_at_onset": 10, "detected": 10, "detected_by_paper": 10}
    row |= {"detection_delay_s": 0.1, "detection_delay_p95_s": 0.15}
    return row | values


def beside_op(over: float) -> dict:
    return {"over_op": over, "over_op_ci95_low": over - 0.1, "over_op_ci95_high": over + 0.1}


def usual(falls: int, ground: str = "flat") -> list[dict]:
    """The same robots without a fault, in every mode."""
    row = {"ground": ground, "falls": falls, "robots": 10}
    return [row | {"mode": mode} for mode in ("camera", "memory", "blind")]


def healthy(switches: int, hours: float) -> dict:
    rate = switches / hours if hours else 0
    rates = {"false_switches_per_hour": rate, "upper_95_per_hour": 9.0}
    return {"false_switches": switches, "robot_hours": hours} | rates


def test_harm_and_misses_are_published():
    vp, op = run("foam", "camera", 5), run("foam", "blind")
    renet = run("foam", "memory", 5, detected=7, **beside_op(-0.5))
    # Five of ten against none of ten: C(10, 5) / C(20, 5) = 1.6 %.
    (harm,) = harmful([vp, renet, op], usual(0))
    assert (harm["memory"], harm["blind"], harm["beyond_chance"]) == (0.5, 1.0, True)
    (miss,) = missed([vp, renet, op], usual(0))
    assert (miss["undetected"], miss["vp_falls"], miss["beyond_chance"]) == (3, 5, True)
    # Where healthy robots and OP's fall as well, that is no more than chance.
    assert not harmful([vp, renet, op], usual(1))[0]["beyond_chance"]
    assert not missed([vp, renet, op], usual(1))[0]["beyond_chance"]
    # As many fall with a healthy camera only: the fault is not why.
    assert missed([vp | {"falls_spared": 5}, renet, op], usual(5)) == []
    assert harmful([run("foam", "memory", 1, **beside_op(0.0)), op], usual(0)) == []
    assert missed([run("foam", "camera"), renet, op], usual(0)) == []


def test_severities_and_onsets_are_judged_together_and_grounds_apart():
    rows = [run("foam", "camera", 3), run("foam", "memory", detected=0)]
    later = ({"severity": 5, "onset": onset, "falls": 6} for onset in (1.5, 2.5, 3.5))
    worse = [row | change for change in later for row in rows]
    # 3 of 10 against none of 10: 10.5 %; 5, the mean of 3, 6, 6 and 6: 1.6 %.
    assert not missed(rows, usual(0))[0]["beyond_chance"]
    assert [miss["beyond_chance"] for miss in missed(rows + worse, usual(0))] == [True] * 4
    claim, *_ = findings(rows + worse[:2], usual(0), healthy(0, 0))["claims"]
    text = "2 settings not noticed by every robot: foam 3 on flat, foam 5 on flat"
    assert (claim["met"], claim["measured"]) == (False, text)
    elsewhere = rows + [row | {"ground": "gap"} for row in worse]
    misses = missed(elsewhere, usual(0) + usual(5, "gap"))
    assert not any(miss["beyond_chance"] for miss in misses)


@pytest.mark.parametrize("rate", [0.02, 0.2, 0.5])
def test_robots_that_fall_as_often_as_the_others_seldom_look_worse(rate):
    # One run without faults stands beside ten with them: its luck must count once.
    draw, looked_worse = np.random.default_rng(0), 0
    for _ in range(200):
        healthy_falls, *falls = draw.binomial(10, rate, 11)
        rows = [run("foam", "camera", int(n), onset=k) for k, n in enumerate(falls)]
        rows += [run("foam", "memory", onset=k, detected=0) for k in range(10)]
        looked_worse += any(m["beyond_chance"] for m in missed(rows, usual(int(healthy_falls))))
    assert looked_worse <= 200 * 0.05


@pytest.mark.parametrize("rate", [0.2, 0.5])
def test_robots_that_fall_alike_in_all_settings_count_once(rate):
    # As under a dead camera, whose severity changes nothing.
    looked_worse = 0.0
    for falls, healthy_falls in product(range(11), repeat=2):
        rows = [run("foam", "camera", falls, onset=k) for k in range(15)]
        rows.append(run("foam", "memory", onset=0, detected=0))
        if any(m["beyond_chance"] for m in missed(rows, usual(healthy_falls))):
            looked_worse += binom.pmf([falls, healthy_falls], 10, rate).prod()
    assert looked_worse <= 0.05


def test_claims_are_judged_by_what_was_measured():
    blind = {"severity": 5, "detected_by_paper": 0}
    runs = [
        run("frozen", "memory", **blind, **beside_op(0.0)),
        run("blackout", "camera", 9, severity=5),
        run("blackout", "memory", detected=9, detection_delay_s=0.3, **blind, **beside_op(0.0)),
        run("blackout", "blind", severity=5),
    ]
    claims = findings(runs, usual(0), healthy(1, 2.5))["claims"]
    assert [claim["met"] for claim in claims] == [True, False, False, True, True, False]
    measured = {claim["claim"]: claim["measured"] for claim in claims}
    text = "10 of 10 robots; by the rule of mode switch 0"
    assert measured["frozen images are noticed"] == text
    # Where nothing makes VP fall, there is no delay to judge; without healthy hours no switches.
    camera = run("frozen", "camera", severity=5)
    harmless = findings([runs[0], camera], [], healthy(3, 2.0))["claims"]
    assert [claim["met"] for claim in harmless] == [True, True, False, True]
    unknown = findings(runs[:1], [], healthy(0, 0))["claims"]
    assert not any("false switch" in claim["claim"] for claim in unknown)


@pytest.mark.parametrize(
    ("runs", "words"),
    [
        ([run("foam", "switch", 5), run("foam", "oracle", 5)], []),
        ([run("foam", "memory", 9), run("foam", "camera")], ["goes unnoticed"]),
        ([run("foam", "memory", severity=2), run("foam", "camera", severity=2)], []),
        ([run("foam", "memory", **beside_op(0.0)), run("foam", "blind")], ["than blind"]),
        ([run("foam", "memory", ground="gap", **beside_op(0.0))], []),
    ],
)
def test_nothing_is_claimed_of_modes_and_grounds_that_were_not_walked(runs, words):
    claims = findings(runs, usual(0), healthy(0, 0))["claims"]
    assert len(claims) == len(words)
    assert all(word in claim["claim"] for word, claim in zip(words, claims, strict=True))
