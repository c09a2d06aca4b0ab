"""When a robot reaches an edge, and where it starts."""

import pytest

from renet.evaluation.studies.grounds import onset_before_edge


def test_faults_begin_half_a_second_before_the_nearest_edge():
    # docs/measure.md: 1.5 s after the start, at 0.6 m/s.
    assert onset_before_edge(0.6) == pytest.approx(1.5)
    # A gap begins 1.2 m from the start.
    assert onset_before_edge(1.2, lead=0.25) == pytest.approx(0.75)


def test_no_fault_begins_before_the_start():
    assert onset_before_edge(1.0, lead=5.0) == 0.0
