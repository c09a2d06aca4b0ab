from renet.evaluation.studies.fault_findings import beyond_chance, findings, harmful, missed


def run(fault: str, mode: str, falls: int = 0, severity: int = 3, **values) -> dict:
    """Ten robots of which some fall, by the fault unless said otherwise."""
    row = {"fault": fault, "severity": severity, "ground": "flat", "onset": 0.5, "mode": mode}
    row |= {"survival": 1 - falls / 10, "falls": falls, "robots": 10, "over_op": None}
    row |= {"falls_by_fault": falls, "falls_spared": 0, "only_op_upright": None}
    row |= {"vision_active_at_onset": 10, "detected": 10, "detected_by_paper": 10}
    row |= {"detection_delay_s": 0.1, "detection_delay_p95_s": 0.15, "only_renet_upright": None}
    return row | values


def beside_op(more: int, fewer: int) -> dict:
    over = (fewer - more) / 10
    ends = {"over_op_ci95_low": over - 0.1, "over_op_ci95_high": over + 0.1}
    return {"over_op": over, "only_op_upright": more, "only_renet_upright": fewer} | ends


def usual(falls: int) -> list[dict]:
    return [{"ground": "flat", "mode": mode, "falls": falls} for mode in ("vp", "renet")]


def healthy(switches: int, hours: float) -> dict:
    rate = switches / hours if hours else 0
    rates = {"false_switches_per_hour": rate, "upper_95_per_hour": 9.0}
    return {"false_switches": switches, "robot_hours": hours} | rates


def test_harm_and_misses_are_published() -> None:
    vp, op = run("foam", "vp", 5), run("foam", "op", 1)
    renet = run("foam", "renet", 2, detected=7, **beside_op(1, 0))
    calm, restless = usual(0), usual(4)
    harm = harmful([vp, renet, op], calm)
    assert [(h["renet"], h["op"], h["beyond_chance"]) for h in harm] == [(0.8, 0.9, True)]
    # Where healthy robots fall as well, one robot is no more than chance.
    assert not harmful([vp, renet, op], restless)[0]["beyond_chance"]
    found = missed([vp, renet, op], calm)
    assert [(m["undetected"], m["vp_falls"], m["beyond_chance"]) for m in found] == [(3, 5, True)]
    # Five who fall only with the fault and none the other way round: 1 in 32.
    assert missed([vp, renet, op], restless)[0]["beyond_chance"]
    assert not missed([run("foam", "vp", 4), renet, op], restless)[0]["beyond_chance"]
    # As many fall with a healthy camera only: the fault is not why.
    assert missed([vp | {"falls_spared": 5}, renet, op], restless) == []
    assert harmful([run("foam", "renet", 1, **beside_op(0, 0)), op], calm) == []
    assert missed([run("foam", "vp"), renet, op], calm) == []


def test_severities_and_onsets_are_judged_together_and_grounds_apart() -> None:
    three, renet = run("foam", "vp", 3), run("foam", "renet", detected=0)
    severe = [three | {"severity": 5}, renet | {"severity": 5, "onset": 1.5}]
    severe[0]["onset"] = 1.5
    rows = [three, renet, *severe]
    assert not missed(rows[:2], usual(4))[0]["beyond_chance"]
    assert all(miss["beyond_chance"] for miss in missed(rows, usual(4)))
    claim = findings(rows, usual(4), healthy(0, 0))["claims"][1]
    text = "2 settings not noticed by every robot: foam 3 on flat, foam 5 on flat"
    assert (claim["met"], claim["measured"]) == (False, text)
    elsewhere = [row | {"ground": "gap"} for row in severe]
    calm = usual(4) + [row | {"ground": "gap"} for row in usual(4)]
    assert not any(miss["beyond_chance"] for miss in missed(rows[:2] + elsewhere, calm))


def test_without_healthy_hours_nothing_is_promised_of_them() -> None:
    for hours, promised in ((0, False), (1.0, True)):
        claims = findings([], usual(0), healthy(0, hours))["claims"]
        assert any("false switch" in claim["claim"] for claim in claims) == promised


def test_claims_are_judged_by_what_was_measured() -> None:
    blind = {"severity": 5, "detected_by_paper": 0}
    runs = [
        run("frozen", "renet", **blind),
        run("blackout", "vp", 9, severity=5),
        run("blackout", "renet", detected=9, detection_delay_s=0.3, **blind),
        run("blackout", "op", severity=5),
    ]
    claims = {
        c["claim"]: (c["met"], c["measured"]) for c in findings(runs, [], healthy(1, 2.5))["claims"]
    }
    assert [met for met, _ in claims.values()] == [True, False, False, True, True, False]
    assert claims["frozen images are noticed"][1] == "10 of 10 robots; by the paper's rule alone 0"
    # Where nothing makes VP fall, there is no delay to judge.
    harmless = findings(runs[:1], [], healthy(3, 2.0))["claims"]
    assert [c["met"] for c in harmless] == [True, True, False, True]


def test_chance_is_judged_by_the_sign_test_and_where_nothing_happens_once_is_enough() -> None:
    # Heads in all of five tosses: 1 in 32, of four: 1 in 16, 12 of 15: 1.8 %, 11 of 15: 5.9 %.
    for more, fewer, beyond in ((5, 0, True), (4, 0, False), (12, 3, True), (11, 4, False)):
        assert beyond_chance(more, fewer, calm=False) == beyond
    for more, fewer, beyond in ((1, 0, True), (1, 1, False), (0, 0, False)):
        assert beyond_chance(more, fewer, calm=True) == beyond
