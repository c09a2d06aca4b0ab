from __future__ import annotations

import json
from pathlib import Path

import pytest

from renet.errors import RenetError
from renet.evaluation.studies.fault_findings import findings, harmful, missed
from renet.evaluation.studies.faults import FaultStudy

from ..fakes import FakeEvaluator

HEALTHY = ("false_switches", "robot_hours", "false_switches_per_hour", "upper_95_per_hour")
SMALL: dict = {"severities": (1, 5), "robots": 2, "onset": 0.4, "fault_end": 1.8, "seconds": 2.4}
SMALL |= {"healthy_minutes": 0.1}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("faults")
    FaultStudy(out=out, faults=("gaussian", "frozen"), **SMALL).run(FakeEvaluator())
    return out


def test_one_row_for_each_fault_severity_and_mode(folder: Path) -> None:
    summary = json.loads((folder / "summary.json").read_text())
    rows = [(run["fault"], run["severity"], run["mode"]) for run in summary["runs"]]
    assert rows == [
        (fault, severity, mode)
        for fault in ("gaussian", "frozen")
        for severity in (1, 5)
        for mode in ("vp", "renet", "op")
    ]
    assert {run["robots"] for run in summary["runs"]} == {2}
    assert len((folder / "summary.csv").read_text().splitlines()) == 13
    assert (folder / "survival.png").exists()
    assert (folder / "gallery.png").exists()


def test_survival_and_detection_are_those_of_the_robots(folder: Path) -> None:
    summary = json.loads((folder / "summary.json").read_text())
    found = {(r["fault"], r["severity"], r["mode"]): r for r in summary["runs"]}
    assert found["gaussian", 5, "vp"]["survival"] == 0
    assert found["gaussian", 5, "renet"]["survival"] == 1
    assert found["gaussian", 5, "renet"]["detection_delay_s"] == pytest.approx(0.035)
    # The fakes' image never changes, so that a frozen one is the right one.
    assert found["frozen", 5, "vp"]["survival"] == 1
    assert found["frozen", 5, "renet"]["detected"] == 0
    assert found["frozen", 5, "renet"]["detection_delay_s"] is None
    assert found["gaussian", 5, "vp"]["falls_by_fault"] == 2
    assert found["gaussian", 5, "renet"]["over_op"] == 0
    assert found["gaussian", 5, "vp"]["over_op"] is None
    assert summary["harmful"] == []
    assert summary["missed"] == []
    assert summary["healthy"]["false_switches"] == 0


def test_finished_faults_are_not_run_again(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ran = []
    real = FaultStudy._run_batch

    def spy(study, evaluator, env, name):
        ran.append(name)
        return real(study, evaluator, env, name)

    monkeypatch.setattr(FaultStudy, "_run_batch", spy)
    faults = ("gaussian", "frozen", "dropped")
    summary = FaultStudy(out=folder, faults=faults, **SMALL).run(FakeEvaluator())
    assert ran == ["dropped"]
    assert len(summary["runs"]) == 18
    FaultStudy(out=folder, faults=faults, **(SMALL | {"seed": 2})).run(FakeEvaluator())
    assert ran == ["dropped", *faults]


def test_a_damaged_part_is_reported(tmp_path: Path) -> None:
    cfg = FaultStudy(out=tmp_path, faults=("gaussian",), **SMALL)
    cfg.run(FakeEvaluator())
    next((tmp_path / "parts").glob("gaussian-*.json")).write_text('{"half')
    with pytest.raises(RenetError, match=r"gaussian-\w+\.json is not valid JSON"):
        cfg.run(FakeEvaluator())


def run(fault: str, mode: str, survival: float, detected: int = 10, **values) -> dict:
    falls = round(10 * (1 - survival))
    row = {"fault": fault, "severity": 3, "mode": mode, "survival": survival, "falls": falls}
    row |= {"terrain": "flat", "falls_by_fault": falls, "falls_spared": 0, "over_op": None}
    row |= {"only_op_upright": None, "only_renet_upright": None, "detection_delay_s": None}
    return row | {"robots": 10, "vision_active_at_onset": 10, "detected": detected} | values


def beside_op(more: int, fewer: int) -> dict:
    over = (fewer - more) / 10
    ends = {"over_op_ci95_low": over - 0.1, "over_op_ci95_high": over + 0.1}
    return {"over_op": over, "only_op_upright": more, "only_renet_upright": fewer} | ends


def usual(falls: int) -> list[dict]:
    return [{"terrain": "flat", "mode": mode, "falls": falls} for mode in ("vp", "renet")]


def test_harm_and_misses_are_published() -> None:
    vp, op = run("foam", "vp", 0.5), run("foam", "op", 0.9)
    renet = run("foam", "renet", 0.8, detected=7, **beside_op(1, 0))
    calm, restless = usual(0), usual(4)
    harm = harmful([vp, renet, op], calm)
    assert [(h["renet"], h["op"], h["beyond_chance"]) for h in harm] == [(0.8, 0.9, True)]
    # Where healthy robots fall as well, one robot is no more than chance.
    assert not harmful([vp, renet, op], restless)[0]["beyond_chance"]
    found = missed([vp, renet, op], calm)
    assert [(m["undetected"], m["vp_falls"], m["beyond_chance"]) for m in found] == [(3, 5, True)]
    # Five who fall only with the fault and none the other way round: 1 in 32.
    assert missed([vp, renet, op], restless)[0]["beyond_chance"]
    four = run("foam", "vp", 0.6)
    assert not missed([four, renet, op], restless)[0]["beyond_chance"]
    # As many fall with a healthy camera only: the fault is not why.
    assert missed([vp | {"falls_spared": 5}, renet, op], restless) == []
    assert harmful([run("foam", "renet", 0.9, **beside_op(0, 0)), op], calm) == []
    assert missed([run("foam", "vp", 1.0), renet, op], calm) == []


def test_severities_are_judged_together() -> None:
    three = run("foam", "vp", 0.7)
    renet = run("foam", "renet", 1.0, detected=0)
    rows = [three, renet, three | {"severity": 5}, renet | {"severity": 5}]
    assert not missed(rows[:2], usual(4))[0]["beyond_chance"]
    assert all(miss["beyond_chance"] for miss in missed(rows, usual(4)))
    claim = findings(rows, usual(4), {k: 0 for k in HEALTHY})["claims"][1]
    assert (claim["met"], claim["measured"]) == (
        False,
        "2 settings not noticed by every robot: foam 3, foam 5",
    )


def test_without_healthy_hours_nothing_is_promised_of_them() -> None:
    nothing = {name: 0 for name in HEALTHY}
    for hours, promised in ((0, False), (1.0, True)):
        claims = findings([], usual(0), nothing | {"robot_hours": hours})["claims"]
        assert any("false switch" in claim["claim"] for claim in claims) == promised


@pytest.mark.parametrize(
    "wrong",
    [
        {"faults": ("smoke",)},
        {"severities": (0,)},
        {"modes": ("blind",)},
        {"modes": ()},
        {"speed": 0.0},
        {"robots": 0},
        {"terrain": "lava"},
        {"terrain": "gap", "level": 11},
        {"fault_end": 2.0},
        {"faults": ("gaussian:9",)},
        {"faults": ("gaussian:x",)},
        {"faults": ("gaussian:1", "frozen")},
        {"faults": ()},
        {"healthy_minutes": -1.0},
        {"selector": "coin"},
    ],
)
def test_bad_settings_are_refused(wrong) -> None:
    with pytest.raises(RenetError):
        FaultStudy(**wrong)


def test_glass_is_studied_where_there_are_obstacles() -> None:
    flat, stairs = FaultStudy(), FaultStudy(terrain="stairs_up", level=2)
    assert (flat.terrain_of("glass"), flat.terrain_of("foam")) == ("obstacles", "flat")
    assert stairs.terrain_of("glass") == "stairs_up"


def test_quick_is_smaller() -> None:
    quick, full = FaultStudy(quick=True), FaultStudy()
    assert [s for _, s in quick.batches["frozen"]] == [1, 3, 5]
    assert quick.robots_each == 10
    assert [s for _, s in full.batches["frozen"]] == [1, 2, 3, 4, 5]
    assert full.robots_each == 20


def test_healthy_time_is_that_of_robots_whose_cameras_never_fail(folder: Path) -> None:
    summary = json.loads((folder / "summary.json").read_text())
    # One batch of 12 without a fault, and 0.1 minutes; not what faults are preceded by, again.
    seconds = 12 * 2.4 + 6.0
    assert summary["healthy"]["robot_hours"] == pytest.approx(seconds / 3600, rel=0.01)
    assert [run["mode"] for run in summary["baseline"]] == ["vp", "renet", "op"]
    assert {run["falls"] for run in summary["baseline"]} == {0}
    assert summary["healthy"]["alarms_by_monitor"]["reconstruction"] == 0
    assert {claim["met"] for claim in summary["claims"]} <= {True, False}
