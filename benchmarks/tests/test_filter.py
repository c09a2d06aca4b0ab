"""The filter study, on cameras whose scores are made up."""

from dataclasses import replace
from math import inf, nan
from pathlib import Path

import pytest
from tests.evaluation.fakes import FakeEvaluator

from filter import FilterStudy
from renet.errors import RenetError


def test_measured_delay_is_the_formulas_at_every_rate(tmp_path: Path) -> None:
    summary = FilterStudy(tmp_path, robots=2, onset=1.0, seconds=4.2).run(FakeEvaluator())
    runs = summary["runs"]
    assert len(runs) == 21
    for run in runs:
        if run["formula_s"] <= 3:
            assert run["delay_s"] == pytest.approx(run["formula_s"], abs=1e-6), run
        else:
            assert run["detected"] == 0
    assert (tmp_path / "filter.png").exists()
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


@pytest.mark.parametrize(
    "wrong",
    [
        {"robots": 0},
        {"gammas": ()},
        {"gammas": (0.1, 2.0)},
        {"rates": (200.0, 30.0)},
        {"rates": (0.0,)},
        {"onset": 14.0},
        {"onset": nan},
        {"seconds": inf},
        {"speed": 0.0},
    ],
)
def test_settings_without_a_filter_or_a_run_are_refused(wrong) -> None:
    with pytest.raises(RenetError):
        FilterStudy(**wrong)
