from itertools import product
from typing import Any, ClassVar

import numpy as np
import pytest

from renet.errors import RenetError
from renet.evaluation.studies import faults
from renet.evaluation.studies.faults import FaultStudy
from renet.interface import STEPS_PER_TICK

from ..fakes import FakeEvaluator, FakePolicy


def test_one_row_for_each_setting_and_mode(run_study):
    folder, summary = run_study("faults")
    # Flat ground has no edge to begin before.
    places = [("flat", 0.5), ("gap", 0.5), ("gap", 1.5)]
    rows = product(("gaussian", "frozen"), places, (1, 5), ("camera", "memory", "blind"))
    assert [
        (run["fault"], (run["ground"], run["onset"]), run["severity"], run["mode"])
        for run in summary["runs"]
    ] == [*rows]
    assert {run["robots"] for run in summary["runs"]} == {2}
    assert len((folder / "summary.csv").read_text().splitlines()) == 37
    for name in ("crossed", "survival", "detection"):
        assert (folder / f"{name}.png").stat().st_size > 10_000


@pytest.mark.parametrize("names", [("blackout", "glass"), ("glass", "blackout")])
def test_blind_robots_of_all_grounds_are_in_their_row(names):
    """Glass is on platforms alone, where all blind robots stay upright; at gaps none does."""
    runs = []
    for fault, mode in product(names, ("memory", "blind")):
        for ground in ("platform",) if fault == "glass" else ("platform", "gap"):
            run = {"fault": fault, "severity": 5, "ground": ground, "onset": 1.5, "mode": mode}
            run |= {"survival": float(ground == "platform"), "detected": 0, "detected_by_paper": 0}
            run |= {"vision_active_at_onset": 1, "measures": {"crossed": {"value": 1.0}}}
            runs.append(run)
    study = FaultStudy(faults=names, modes=("memory", "blind"), grounds=("platform", "gap"))
    axis = study.draw({"runs": runs}, {})["survival.png"].axes[0]
    rows = [label.get_text() for label in axis.get_yticklabels()]
    place = rows.index("blind, any fault")
    (cell,) = [text for text in axis.texts if text.get_position()[1] == place]
    assert cell.get_text() == "50"


def test_survival_and_detection_are_those_of_the_robots(run_study):
    _, summary = run_study("faults")
    rows = {(r["fault"], r["severity"], r["mode"]): r for r in summary["runs"]}
    vp, renet = (rows["gaussian", 5, mode] for mode in ("camera", "memory"))
    assert (vp["survival"], vp["falls_by_fault"], vp["over_op"]) == (0, 2, None)
    assert vp["measures"]["upright"]["change"]["value"] == -1
    assert (renet["survival"], renet["over_op"]) == (1, 0)
    assert renet["detection_delay_s"] == pytest.approx(0.035)
    assert renet["measures"]["switches"]["value"] == 2
    assert renet["measures"]["seconds_without_sight"]["value"] == 1.0
    # The fakes' image never changes, so that a frozen one is the right one.
    assert rows["frozen", 5, "camera"]["survival"] == 1
    missed = rows["frozen", 5, "memory"]
    assert (missed["detected"], missed["detection_delay_s"]) == (0, None)
    assert summary["harmful"] == summary["missed"] == []
    # Two falls are no more than chance; frozen images are not noticed.
    assert [claim["met"] for claim in summary["claims"]] == [True, True, True, False]
    healthy = summary["healthy"]
    # Cameras of RENet's twins on flat ground never fail, nor do those of 0.1 minutes.
    assert healthy["robot_hours"] == pytest.approx((2 * 2.6 + 6.0) / 3600, rel=0.01)
    assert healthy["false_switches"] == healthy["alarms_by_monitor"]["reconstruction"] == 0
    where = [(run["ground"], run["mode"], run["falls"]) for run in summary["baseline"]]
    assert where == [
        (g, mode, 0) for g in ("flat", "gap") for mode in ("camera", "memory", "blind")
    ]


class Surprised(FakePolicy):
    """One image contradicts what was seen before, and later two in a row do."""

    clock = 0

    def step(self, proprioception, depth, op_mask) -> np.ndarray:
        tick = self.clock // STEPS_PER_TICK
        self.clock += 1
        self.surprise = np.full(len(depth), float(tick in (10, 30, 31)))
        return super().step(proprioception, depth, op_mask)


class SurprisedEvaluator(FakeEvaluator):
    thresholds: ClassVar = {"surprise": 0.5}


def test_a_single_surprising_image_is_no_false_alarm(tmp_path):
    options = {"faults": ("blackout:5",), "grounds": ("flat",), "robots": 1}
    options |= {"lasts": 1.0, "seconds": 2.6, "healthy_minutes": 0.1}
    fake: Any = SurprisedEvaluator(policy=Surprised)
    healthy = FaultStudy(tmp_path, **options).run(fake)["healthy"]
    assert healthy["alarms_by_monitor"] == {"surprise": 1}


def test_quick_is_smaller_and_glass_is_studied_where_there_are_obstacles():
    mild = FaultStudy(quick=True, severities=(3, 2))
    assert {setting.severity for setting in mild.batches["foam"]} == {3}
    quick, full = FaultStudy(quick=True), FaultStudy()
    settings = {(s.onset, s.severity) for s in quick.batches["frozen"] if s.ground == "gap"}
    assert settings == {(1.5, 5)}
    assert (quick.robots_each, full.robots_each) == (5, 20)
    assert {s.severity for s in full.batches["frozen"]} == {1, 2, 3, 4, 5}
    assert {s.ground for s in full.batches["glass"]} == {"obstacles", "stairs_up", "platform"}
    # Less than a million robot steps: at 1,400 a second on two quiet cores twelve minutes.
    robots = sum(len(quick.trials(settings)) for settings in quick.batches.values())
    robots += len(quick.trials_on(quick.grounds))
    assert robots * quick.steps + quick.healthy_minutes / 4 * 60 * 50 < 1_000_000


def test_a_fault_begins_after_the_first_control_step():
    with pytest.raises(RenetError, match=r"0\.02 <= onsets"):
        FaultStudy(onsets=(0.005,))


def test_each_robots_shares_are_those_of_its_settings(run_study):
    summary = run_study("faults")[1]
    flat = [run for run in summary["runs"] if (run["mode"], run["ground"]) == ("camera", "flat")]
    mean = np.mean([run["measures"]["upright"]["value"] for run in flat])
    assert np.mean(summary["by_robot"]["camera"]["flat"]["upright"]) == pytest.approx(mean)
    assert len(summary["by_robot"]["blind"]["gap"]["crossed"]) == 2
    assert {run["ground_level"] for run in summary["runs"] if run["ground"] == "gap"} == {3}


def test_faults_of_few_robots_walk_side_by_side_as_they_do_alone(tmp_path, monkeypatch):
    options = {"grounds": ("flat", "obstacles"), "robots": 2, "seconds": 3.0, "lasts": 1.0}
    options |= {"faults": ("gaussian:5", "glass:1", "foam:2", "blackout:5"), "healthy_minutes": 0.0}
    joined, alone = (FaultStudy(tmp_path / name, **options) for name in ("joined", "alone"))
    names = ["gaussian_5", "glass_1", "foam_2", "blackout_5", "no_fault"]
    # Glass is on no flat ground.
    groups = [["gaussian_5"], ["glass_1"], ["foam_2", "blackout_5"], ["no_fault"]]
    assert joined.part_groups(names) == groups
    fake: Any = FakeEvaluator()
    rows = joined.run(fake)["runs"]
    monkeypatch.setattr(faults, "SIDE_BY_SIDE", 1)
    assert alone.part_groups(names) == [[name] for name in names]
    assert alone.run(fake)["runs"] == rows
    assert {run["survival"] for run in rows} == {0.0, 1.0}
    monkeypatch.setattr(faults, "SIDE_BY_SIDE", 23)
    robots = [len(joined.trials(settings)) for settings in joined.batches.values()]
    assert (robots, joined.part_groups(names)) == ([12, 8, 12, 12], [[name] for name in names])
