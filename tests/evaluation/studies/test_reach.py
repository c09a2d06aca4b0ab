"""Robots whose cameras die before a gap, in a built scene."""

import pytest

from renet.evaluation.studies.reach import ReachStudy, single_gap
from renet.evaluation.trace import Trace
from renet.terrain.tiles import TILE


def test_a_robot_that_stops_does_not_fall_into_a_gap_it_never_saw(tmp_path):
    study = ReachStudy(
        tmp_path,
        robots=4,
        metres=(1.35,),
        unseen=("walk", "stop"),
        seconds=7.0,
        conditions="nominal",
    )
    runs = {run["unseen"]: run for run in study.run()["runs"] if run["scene"] == "gap"}
    assert runs["healthy"]["crossed"] == 4
    assert runs["walk"]["fell"] >= 3
    assert runs["stop"]["fell"] <= 1
    for run in runs.values():
        assert run["crossed"] + run["fell"] + run["stood_before"] + run["stood_behind"] == 4
        assert run["measured_m"] == pytest.approx(1.35, abs=0.1)
    assert (tmp_path / "reach.png").stat().st_size > 10_000


def test_falls_at_the_second_gap_are_told_from_those_at_the_first():
    study = ReachStudy()
    gap = study.two_gaps
    # Edges of the gaps, from the start: 1.3 to 1.87 m, and 3.07 m.
    distances = (1.6, 2.4, 2.6, 3.2)
    trace = Trace.empty(200, len(distances) + 1)
    trace.travelled[:150, : len(distances)] = distances
    trace.fell[150, : len(distances)] = True
    trace.ended[150] = True
    row = study._row(trace, gap)
    assert (row["crossed"], row["fell"], row["fell_at_second"]) == (1, 4, 2)
    assert study._row(trace, single_gap(0.37, 0.8))["fell_at_second"] == 0


def test_robots_that_stand_behind_a_gap_are_told_from_those_before_it():
    gap = single_gap(0.37, 0.8)
    # The gap is from 1.3 to 1.67 m from the start. The last robot falls at 2 m.
    distances = (1.0, 1.5, 1.7, 2.2, 2.0)
    trace = Trace.empty(200, len(distances))
    trace.travelled[:] = distances
    trace.fell[150, 4] = True
    trace.ended[150, 4] = True
    row = ReachStudy()._row(trace, gap)
    assert (row["fell"], row["stood_before"], row["stood_behind"]) == (1, 2, 2)
    assert row["over_rate"] == 2 / 5


def test_both_gaps_fit_on_the_tile():
    gap = ReachStudy().two_gaps
    assert gap.ground is not None
    outer = gap.island + 2 * gap.high + gap.ground
    assert outer + gap.landing <= TILE / 2
