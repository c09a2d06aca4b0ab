import json
from pathlib import Path

import numpy as np
import pytest
from jsonschema import Draft202012Validator

from renet.errors import RenetError
from renet.evaluation.evaluator import Evaluator
from renet.evaluation.rollout import Trial
from renet.evaluation.studies.benchmark import GROUNDS, ONSETS
from renet.evaluation.studies.benchmark import SCHEMA as FILE
from renet.evaluation.studies.faults import FaultStudy
from renet.evaluation.studies.leaderboard import LeaderboardCfg, make_leaderboard, rank
from renet.evaluation.study import WalkingStudy
from renet.faults import Injection
from renet.version import commit

SCHEMA = json.loads(FILE.read_text())


@pytest.fixture
def folder(run_study) -> Path:
    return run_study("faults")[0]


def test_one_row_for_each_setting_and_mode(folder: Path, summary: dict) -> None:
    names = ("fault", "ground", "onset", "severity", "mode")
    # Flat ground has no edge to begin before.
    places = [("flat", 0.5), ("gap", 0.5), ("gap", 1.5)]
    assert [tuple(run[name] for name in names) for run in summary["runs"]] == [
        (fault, *place, severity, mode)
        for fault in ("gaussian", "frozen")
        for place in places
        for severity in (1, 5)
        for mode in ("vp", "renet", "op")
    ]
    assert {run["robots"] for run in summary["runs"]} == {2}
    assert len((folder / "summary.csv").read_text().splitlines()) == 37
    for name in ("crossed", "survival", "detection", "gallery"):
        assert (folder / f"{name}.png").stat().st_size > 10_000


def test_survival_and_detection_are_those_of_the_robots(summary: dict) -> None:
    found = {(r["fault"], r["severity"], r["mode"]): r for r in summary["runs"]}
    assert found["gaussian", 5, "vp"]["survival"] == 0
    assert found["gaussian", 5, "vp"]["falls_by_fault"] == 2
    assert found["gaussian", 5, "vp"]["measures"]["upright"]["change"]["value"] == -1
    assert found["gaussian", 5, "renet"]["survival"] == 1
    assert found["gaussian", 5, "renet"]["detection_delay_s"] == pytest.approx(0.035)
    assert found["gaussian", 5, "renet"]["measures"]["switches"]["value"] == 2
    assert found["gaussian", 5, "renet"]["measures"]["seconds_without_sight"]["value"] == 1.0
    # The fakes' image never changes, so that a frozen one is the right one.
    assert found["frozen", 5, "vp"]["survival"] == 1
    assert found["frozen", 5, "renet"]["detected"] == 0
    assert found["frozen", 5, "renet"]["detection_delay_s"] is None
    assert found["gaussian", 5, "renet"]["over_op"] == 0
    assert found["gaussian", 5, "vp"]["over_op"] is None
    assert summary["harmful"] == summary["missed"] == []
    # Two falls are no more than chance; frozen images are not noticed.
    assert [claim["met"] for claim in summary["claims"]] == [True, True, True, False]


def test_healthy_time_is_that_of_robots_whose_cameras_never_fail(summary: dict) -> None:
    # RENet's twins on flat ground, and 0.1 minutes.
    assert summary["healthy"]["robot_hours"] == pytest.approx((2 * 2.6 + 6.0) / 3600, rel=0.01)
    assert summary["healthy"]["false_switches"] == 0
    assert summary["healthy"]["alarms_by_monitor"]["reconstruction"] == 0
    where = [(run["ground"], run["mode"], run["falls"]) for run in summary["baseline"]]
    assert where == [(g, mode, 0) for g in ("flat", "gap") for mode in ("vp", "renet", "op")]


def test_what_op_does_no_fault_changes() -> None:
    """A real policy: the rows of OP need not be run again for each fault."""
    evaluator = Evaluator()
    env = evaluator.make_env("flat", [0, 0], 0.6, 1)
    trials = [Trial("op", (Injection.of("gaussian", 5, 10),)), Trial("op")]
    trace = evaluator.rollout(env, trials, 1).run(40)
    assert (trace.anomaly[20:, 0] > 2 * trace.anomaly[20:, 1]).all()
    np.testing.assert_allclose(trace.height[:, 0], trace.height[:, 1], atol=1e-5)


def test_quick_is_smaller_and_glass_is_studied_where_there_are_obstacles() -> None:
    quick, full = FaultStudy(quick=True), FaultStudy()
    assert {s.severity for s in quick.batches["frozen"]} == {5}
    assert {s.onset for s in quick.batches["frozen"] if s.ground == "gap"} == {1.5}
    assert (quick.robots_each, full.robots_each) == (5, 20)
    assert {s.severity for s in full.batches["frozen"]} == {1, 2, 3, 4, 5}
    assert {s.ground for s in full.batches["glass"]} == {"obstacles", "stairs_up", "platform"}
    # Less than a million robot steps: at 1,400 a second on two quiet cores twelve minutes.
    robots = sum(len(quick.trials(settings)) for settings in quick.batches.values())
    robots += len(quick.trials_on(quick.grounds))
    assert robots * quick.steps + quick.healthy_minutes / 4 * 60 * 50 < 1_000_000


# The result file and the leaderboard.


def test_the_result_file_is_valid(folder: Path) -> None:
    result = json.loads((folder / "result.json").read_text())
    Draft202012Validator(SCHEMA).validate(result)
    assert result["policy"]["modes"] == ["vp", "renet", "op"]
    assert result["provenance"]["commit"] == commit()
    assert {entry["onset"] for entry in result["settings"]} == set(ONSETS.values())
    flat = [e for e in result["settings"] if (e["mode"], e["ground"]) == ("vp", "flat")]
    mean = np.mean([entry["measures"]["upright"]["value"] for entry in flat])
    assert np.mean(result["by_robot"]["vp"]["flat"]["upright"]) == pytest.approx(mean)
    assert len(result["by_robot"]["op"]["gap"]["crossed"]) == 2
    assert {entry["level"] for entry in result["settings"] if entry["ground"] == "gap"} == {3}


def test_grounds_that_are_not_the_benchmarks_give_no_result_file(
    tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.setattr(WalkingStudy, "run", lambda self, evaluator: {})
    FaultStudy(out=tmp_path, grounds=("rough",)).run()
    assert not (tmp_path / "result.json").exists()


def complete(name: str, crossed: float) -> dict:
    """A result of every quick setting in which the same share crosses everywhere."""
    share = {"value": crossed, "ci95": None, "change": {"value": 0.0, "ci95": None}}
    measures = dict.fromkeys(("crossed", "upright", "speed_error", "energy_per_metre"), share)
    measures |= dict.fromkeys(("collisions", "seconds_without_sight", "switches"), share)
    settings = [
        {"ground": s.ground, "level": GROUNDS[s.ground], "fault": s.fault, "severity": s.severity}
        | {"onset": ONSETS[s.onset], "mode": "vp", "measures": measures}
        for settings in FaultStudy(quick=True).batches.values()
        for s in settings
    ]
    policy = {"name": name, "url": None, "sha256": "0" * 64, "modes": ["vp"]}
    protocol = {"robots": 5, "seed": 1, "speed": 0.6, "lasts": 4.0, "seconds": 10.0, "quick": True}
    origin = dict.fromkeys(("renet", "commit", "command", "date"), "x") | {"engine": "warp"}
    kind = {"benchmark": "renet-faults", "version": 1, "provenance": origin}
    one = {"crossed": [1.0, 0.0], "upright": [1.0, 1.0]}
    robots = {ground: one | {"crossed": [crossed, crossed]} for ground in GROUNDS}
    robots["gap"] = one
    by_robot = {"by_robot": {"vp": robots}}
    return kind | {"policy": policy, "protocol": protocol, "settings": settings} | by_robot


def test_the_better_policy_leads_and_an_incomplete_one_is_not_ranked() -> None:
    poor, good, cheat = complete("poor", 0.4), complete("good", 0.6), complete("cheat", 1.0)
    cheat["settings"] = cheat["settings"][1:]
    easy, lucky = complete("easy", 0.9), complete("lucky", 0.8)
    easy["settings"] = [entry | {"level": 1} for entry in easy["settings"]]
    lucky["protocol"]["seed"] = 77
    rows = rank([poor, cheat, good, lucky, easy])
    assert [row[:4] for row in rows] == [
        ("1", "good", "vp", "60.0 %"),
        ("2", "poor", "vp", "40.0 %"),
        ("incomplete", "cheat", "vp", "100.0 %"),
        ("incomplete", "easy", "vp", "90.0 %"),
        ("incomplete", "lucky", "vp", "80.0 %"),
    ]
    # Two robots that differ on gaps alone: the mean of both, or twice the one or the other.
    share = np.mean([s["ground"] == "gap" for s in good["settings"] if s["ground"] != "flat"])
    assert rows[0][4] == f"{60 * (1 - share):.1f} to {60 + 40 * share:.1f}"
    del good["by_robot"]
    assert rank([good])[0][4] == "-"
    with pytest.raises(RenetError, match="one protocol"):
        rank([poor, good | {"protocol": good["protocol"] | {"quick": False}}])


def test_the_leaderboard_is_made_from_files(tmp_path: Path, capsys) -> None:
    files = []
    for name, crossed in (("one", 0.5), ("two", 0.7)):
        files.append(tmp_path / f"{name}.json")
        files[-1].write_text(json.dumps(complete(name, crossed)))
    table = make_leaderboard(LeaderboardCfg(tuple(files), tmp_path / "new" / "board.md"))
    lines = table.read_text().splitlines()
    assert [line.split(" | ")[1] for line in lines[2:]] == ["two", "one"]
    assert "two" in capsys.readouterr().out
    files[0].write_text('{"benchmark": "renet-faults", "version": 2}')
    with pytest.raises(RenetError, match="no result of renet-faults, version 1"):
        make_leaderboard(LeaderboardCfg(tuple(files), table))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda r: r["settings"][3].pop("onset"), r"settings\[3\]: 'onset' is a required"),
        (lambda r: r["settings"][3].update(severity=6), "severity: 6 is greater than"),
        (lambda r: r["settings"][3]["measures"].pop("switches"), "'switches' is a required"),
        (lambda r: r["settings"][3]["measures"]["crossed"].update(value=1.2), "1.2 is greater"),
        (lambda r: r["settings"][3]["measures"]["crossed"].pop("ci95"), "'ci95' is a required"),
        (lambda r: r["settings"][3]["measures"]["upright"].update(ci95=[0.1]), "upright.ci95: "),
        (lambda r: r["policy"].update(sha256="unknown"), "'unknown' does not match"),
        (lambda r: r.update(settings=[]), "settings: "),
        (lambda r: r.update(settings={"many": "x" * 9000}), "settings: ….*is not of type 'array'"),
    ],
)
def test_a_file_against_the_schema_is_one_line(tmp_path: Path, spoil, message: str) -> None:
    broken, file = json.loads(json.dumps(complete("one", 0.5))), tmp_path / "one.json"
    spoil(broken)
    file.write_text(json.dumps(broken))
    with pytest.raises(RenetError, match=message) as error:
        make_leaderboard(LeaderboardCfg((file,), tmp_path / "board.md"))
    assert len(str(error.value)) < 400
    assert not (tmp_path / "board.md").exists()
