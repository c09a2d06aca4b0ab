from __future__ import annotations

import math

import numpy as np
import pytest

from renet.evaluation import metrics
from renet.evaluation.studies.fault_findings import findings
from renet.evaluation.studies.fault_metrics import (
    Batch,
    detection,
    end_of,
    measure,
    recovery,
    separability,
)
from renet.evaluation.trace import Trace

ONSET, OVER, STEPS = 20, 60, 100


def batch(count: int = 4) -> Batch:
    """Robot 0 notices at once, 1 late, 2 never, 3 after it fell; vision is back after the end."""
    trace = Trace.empty(STEPS, count)
    trace.forward_velocity[:] = 0.6
    trace.trusted[ONSET + 2 : OVER + 50, :, 0] = False
    trace.trusted[ONSET + 20 : OVER + 15, :, 1] = False
    trace.fell[ONSET + 5, 3] = True
    trace.trusted[ONSET + 10 : OVER, :, 3] = False
    if count > 4:  # A fifth robot had left vision before.
        trace.trusted[ONSET - 3 : OVER, :, 4] = False
    rng = np.random.default_rng(0)
    scores = rng.normal(0, 1, (STEPS // 5, count))
    scores[ONSET // 5 : OVER // 5] += 1.5
    paper = np.ones_like(trace.trusted)
    return Batch(trace, paper, scores, 3 * scores, ONSET, OVER)


def test_detection_return_and_survival_by_hand() -> None:
    row = measure(batch(), slice(0, 4), "gaussian", 5)
    assert row["detected"] == 2
    assert row["detection_delay_s"] == pytest.approx((0.045 + 0.405) / 2)
    assert row["detected_by_paper"] == 0
    assert row["paper_detection_delay_s"] is None
    assert row["falls"] == 1
    assert row["survival"] == 0.75
    # Robot 0 is not back before the run ends, 1 after 15 steps and one update.
    assert (row["recovered"], row["away_at_end"]) == (1, 2)
    assert row["recovery_delay_s"] == pytest.approx(0.305)
    assert row["distance"] == pytest.approx((3 * 100 + 25) / 4 * 0.6 * 0.02)


def test_a_robot_without_vision_neither_notices_nor_misses() -> None:
    four, five = (measure(batch(n), slice(0, n), "gaussian", 5) for n in (4, 5))
    assert (four["vision_active_at_onset"], five["vision_active_at_onset"]) == (4, 4)
    assert five["robots"] == 5
    for name in ("detected", "detection_delay_s", "detected_by_paper"):
        assert five[name] == four[name]


def test_a_fault_ends_by_itself_or_with_the_study() -> None:
    assert end_of("frozen", 1, 20, 60) == 30
    assert end_of("frozen", 4, 20, 60) == 60
    assert end_of("gaussian", 1, 20, 60) == 60
    assert end_of("mount_knocked", 1, 20, 60) == 60


def test_noticing_after_the_fall_is_a_miss() -> None:
    trusted = np.ones((50, 4, 2), bool)
    trusted[30:] = False
    fallen = np.zeros((50, 2), bool)
    fallen[25:, 0] = True
    delay = detection(trusted, fallen, 20, 50)
    assert np.isnan(delay[0])
    assert delay[1] == pytest.approx(0.205)


def test_starting_anew_is_no_return_to_vision() -> None:
    trusted = np.ones((50, 4, 2), bool)
    trusted[10:31] = False
    fallen = np.zeros((50, 2), bool)
    fallen[30:, 0] = True
    delay = recovery(trusted, fallen, 20)
    assert np.isnan(delay[0])
    assert delay[1] == pytest.approx(0.225)


def test_areas_match_counting_pairs() -> None:
    found = separability(batch(), slice(0, 3), "gaussian", 5)
    scores = batch().reconstruction[:, :3]
    before, after = scores[:4].ravel(), scores[4:12].ravel()
    pairs = (after[:, None] > before).mean()
    assert found["auc_reconstruction"] == pytest.approx(pairs)
    assert found["auc_monitors"] == pytest.approx(pairs)
    false, true = found["monitors"]
    assert false[0] == true[0] == 0
    assert false[-1] == true[-1] == 1


@pytest.mark.parametrize(("count", "limit"), [(0, 2.996), (1, 4.744), (5, 10.513)])
def test_the_poisson_limit_is_the_textbooks(count: int, limit: float) -> None:
    found = metrics.poisson_upper(count)
    assert found == pytest.approx(limit, abs=1e-3)
    chance = sum(math.exp(-found) * found**i / math.factorial(i) for i in range(count + 1))
    assert chance == pytest.approx(0.05)


def run(fault: str, severity: int, mode: str, **values) -> dict:
    plain = {
        "survival": 1.0,
        "falls": 0,
        "robots": 10,
        "vision_active_at_onset": 10,
        "detected": 10,
        "detected_by_paper": 10,
    }
    delays = {"detection_delay_s": 0.1, "detection_delay_p95_s": 0.15}
    plain |= {"terrain": "flat", "falls_spared": 0, "over_op": None}
    plain |= {"only_op_upright": None, "falls_by_fault": values.get("falls", 0)}
    return {"fault": fault, "severity": severity, "mode": mode} | plain | delays | values


def healthy(switches: int, hours: float) -> dict:
    rates = {"false_switches_per_hour": switches / hours, "upper_95_per_hour": 9.0}
    return {"false_switches": switches, "robot_hours": hours} | rates


def test_claims_are_judged_by_what_was_measured() -> None:
    runs = [
        run("frozen", 5, "renet", detected_by_paper=0),
        run("blackout", 5, "vp", falls=9, survival=0.1),
        run("blackout", 5, "renet", detected=9, detected_by_paper=0, detection_delay_s=0.3),
        run("blackout", 5, "op"),
    ]
    claims = {
        c["claim"]: (c["met"], c["measured"]) for c in findings(runs, [], healthy(1, 2.5))["claims"]
    }
    met = [met for met, _ in claims.values()]
    assert met == [True, False, False, True, True, False]
    assert claims["frozen images are noticed"][1] == "10 of 10 robots; by the paper's rule alone 0"
    # Where nothing makes VP fall, there is no delay to judge.
    harmless = findings(runs[:1], [], healthy(3, 2.0))["claims"]
    assert [c["met"] for c in harmless] == [True, True, False, True]
