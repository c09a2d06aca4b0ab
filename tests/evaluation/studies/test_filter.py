from dataclasses import replace
from pathlib import Path

import pytest

from renet.evaluation.studies.filter import FilterStudy

from ..fakes import FakeEvaluator


def test_measured_delay_is_the_formulas_at_every_rate(run_study) -> None:
    folder, summary = run_study("filter")
    runs = summary["runs"]
    assert len(runs) == 21
    for run in runs:
        if run["formula_s"] <= 3:
            assert run["delay_s"] == pytest.approx(run["formula_s"], abs=1e-6), run
        else:
            assert run["detected"] == 0
    assert (folder / "filter.png").exists()
    switches = {(r["gamma"], r["rate_hz"]): r["switches_per_minute"] for r in runs}
    # A flicker of 0.1 s in 0.4 s: a light filter follows it, a heavy one does not.
    assert switches[1.0, 200.0] == pytest.approx(300, rel=0.05)
    assert switches[0.02, 10.0] == 0


def test_quick_is_fewer_robots_and_new_gammas_need_no_new_walk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Busy(FakeEvaluator):
        def make_env(self, *args):
            raise AssertionError("walked again")

    monkeypatch.setattr(FilterStudy, "draw", lambda *args: {})
    quick = FilterStudy(out=tmp_path, quick=True, onset=0.2, seconds=0.8, gammas=(0.1,))
    summary = quick.run(FakeEvaluator())
    runs = summary["runs"]
    assert summary["settings"]["quick"]
    assert [run["robots"] for run in runs] == [4, 4, 4]
    assert replace(quick, gammas=(0.1, 1.0)).run(Busy())["runs"][::2] == runs
