"""Scores, by hand."""

import pytest

from renet.evaluation.benchmark import scores

from .rows import row

ROWS = [row(0, 2), row(1, 0, metres=0.2), row(2, 1), row(3, 3, obstacles=3)]


def test_a_score_is_the_mean_share_of_obstacles():
    found = scores.score_rows(ROWS)
    assert found["score"] == pytest.approx((1.0 + 0.0 + 0.5 + 1.0) / 4)
    assert found["loud"] == pytest.approx(0.75)
    assert found["lies"] == pytest.approx(0.5)
    assert found["falls"] == pytest.approx(0.5)
    assert found["ci95_low"] < found["score"] < found["ci95_high"]


@pytest.mark.parametrize(("crossed", "limits"), [(0, (0.0, 0.30850)), (2, (0.69150, 1.0))])
def test_ten_episodes_that_end_alike_leave_room_for_others(crossed, limits):
    # 0.025 is the probability of ten misses in a row at a share of 0.3085.
    found = scores.score_rows([row(episode, crossed) for episode in range(10)])
    assert (found["ci95_low"], found["ci95_high"]) == pytest.approx(limits, abs=1e-5)


def test_energy_is_of_those_that_walked():
    assert scores.score_rows(ROWS)["energy_per_metre"] == pytest.approx(200.0)
    assert scores.score_rows([ROWS[1]])["energy_per_metre"] is None


def test_leads_are_paired():
    gain, low, high = scores.lead([row(i, 2) for i in range(9)], [row(i, 1) for i in range(9)])
    assert (gain, low, high) == (0.5, 0.5, 0.5)


def test_trainings_have_students_interval():
    # t = 4.3027 with two degrees of freedom; the standard error is 0.1 / sqrt(3).
    low, high = scores.interval_over_trainings([0.5, 0.6, 0.7])
    assert low == pytest.approx(0.6 - 4.3027 * 0.1 / 3**0.5, abs=1e-4)
    assert high == pytest.approx(0.6 + 4.3027 * 0.1 / 3**0.5, abs=1e-4)


def test_families_are_counted():
    assert scores.by_family(ROWS)["mount"] == {"score": 0.5, "episodes": 2}
