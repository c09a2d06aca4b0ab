from dataclasses import replace
from itertools import product
from typing import ClassVar

import numpy as np
import pytest

from renet.errors import RenetError
from renet.evaluation.studies.faults import Setting
from renet.evaluation.studies.noise import NoiseStudy, noise_label
from renet.faults import FAULTS

from ..fakes import SPEED, FakeEvaluator

SHORT: dict = {"onsets": (0.2,), "lasts": 0.6, "seconds": 0.8}


def test_the_preset_is_the_papers_comparison(run_study):
    folder, summary = run_study("noise")
    levels = {"gaussian": (0.3, 0.7, 1.0), "salt_and_pepper": (0.1, 0.3, 0.7)}
    rows = [
        (noise, *row) for noise in levels for row in product(levels[noise], ("camera", "memory"))
    ]
    assert [(run["fault"], run["level"], run["mode"]) for run in summary["runs"]] == rows
    assert [row["mode"] for row in summary["baseline"]] == ["camera", "memory"]
    assert {row["robots"] for row in [*summary["runs"], *summary["baseline"]]} == {2}
    assert summary["provenance"].keys() >= {"bundle_hash", "engine", "seed", "command", "date"}
    assert summary["healthy"]["false_switches"] == 0
    assert summary["healthy"]["robot_hours"] == pytest.approx(2 * 5.0 / 3600, abs=1e-6)
    for name in ("noise.png", "timeline.png"):
        assert (folder / name).read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert len((folder / "summary.csv").read_text().splitlines()) == 1 + 12


def test_measured_values_are_those_of_the_robots_and_only_renet_has_a_delay(run_study):
    _, summary = run_study("noise")
    names = ("falls", "detected", "mean_forward_velocity", "velocity_ci95_low", "detection_delay_s")
    for run in (run for run in summary["runs"] if run["mode"] == "memory"):
        assert [run[n] for n in names] == pytest.approx([0, 2, SPEED, SPEED, 0.035], abs=1e-6)
    strongest = next(r for r in summary["runs"] if (r["mode"], r["level"]) == ("camera", 1.0))
    assert (strongest["falls"], strongest["mean_forward_velocity"]) == (2, 0)
    ((_, _, rows),) = NoiseStudy().tables(summary)
    names = [("camera", "no noise"), ("memory", "no noise"), ("camera", "GA 30 %")]
    assert [row[:2] for row in rows[:3]] == names
    assert {row[5] for row in rows if row[0] == "camera"} == {"-"}
    assert {row[5] for row in rows[8:]} == {"35"}
    assert {row[3] for row in rows} == {"-"}, "flat ground has no end"


def test_on_tiles_the_table_says_who_crossed(tmp_path):
    study = NoiseStudy(tmp_path, robots=2, faults=("gaussian:5",), grounds=("stairs_up",), **SHORT)
    ((title, _, rows),) = study.tables(study.run(FakeEvaluator()))
    assert title == "Camera noise: stairs up"
    # Nobody leaves the tile in the fake environment.
    assert [row[3] for row in rows] == ["0 of 2"] * 4


def test_the_timelines_camera_recovers():
    last = NoiseStudy().trials([Setting("flat", 3.0, "gaussian", 5)])[-1]
    assert last.mode == "memory"
    at_work = np.array([last.schedule[0].elapsed(k) >= 0 for k in range(450)])
    np.testing.assert_array_equal(at_work, (np.arange(450) >= 150) & (np.arange(450) < 300))


@pytest.mark.parametrize(
    ("monitor", "name"),
    [("reconstruction", "threshold β"), ("variance", "threshold β of mode switch")],
)
def test_the_timelines_threshold_is_named_after_who_obeys_it(tmp_path, monkeypatch, monitor, name):
    class Judged(FakeEvaluator):
        thresholds: ClassVar = {monitor: 0.01}

    drawings = {}
    draw = NoiseStudy.draw
    monkeypatch.setattr(NoiseStudy, "draw", lambda *args: drawings.update(draw(*args)) or {})
    NoiseStudy(tmp_path, robots=2, faults=("gaussian:5",), **SHORT).run(Judged())
    axis = drawings["timeline.png"].axes[0]
    line = next(line for line in axis.lines if "β" in line.get_label())
    assert (line.get_label(), line.get_ydata()[0]) == (name, Judged.beta)
    # Formulae would be drawn as they are written.
    assert not any("$" in label.get_text() for label in axis.get_yticklabels(which="both"))


def test_faults_may_be_added_to_a_study(tmp_path, monkeypatch):
    monkeypatch.setattr(NoiseStudy, "draw", lambda *args: {})
    study = NoiseStudy(tmp_path, robots=2, faults=("gaussian:2",), **SHORT)
    study.run(FakeEvaluator())
    earlier = {*(tmp_path / "parts").iterdir()}
    more = replace(study, faults=("gaussian:2", "gaussian:5"))
    assert len(more.run(FakeEvaluator())["runs"]) == 4
    (added,) = {*(tmp_path / "parts").iterdir()} - earlier
    assert added.name.startswith("gaussian_5"), "finished faults are not run again"


def test_a_folder_that_cannot_be_written_to_is_reported(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr("os.access", lambda path, mode: False)
    for out, message in ((tmp_path / "file", "cannot write"), (tmp_path, "permission denied")):
        with pytest.raises(RenetError, match=message):
            NoiseStudy(out=out).run(FakeEvaluator())


def test_other_faults_have_their_own_units_and_who_has_crossed_has_no_speed(run_study):
    assert noise_label("frozen", "inf") == f"frozen, {FAULTS['frozen'].describe(float('inf'))}"
    assert noise_label("latency", 0.3) == f"latency, {FAULTS['latency'].describe(0.3)}"
    _, summary = run_study("noise")
    gone = dict.fromkeys(("mean_forward_velocity", "velocity_ci95_low", "velocity_ci95_high"))
    summary = summary | {"runs": [run | gone for run in summary["runs"]]}
    ((_, _, rows),) = NoiseStudy().tables(summary)
    assert {row[4] for row in rows[2:]} == {"-"}
