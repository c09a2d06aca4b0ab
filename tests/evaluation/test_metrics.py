import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from renet.evaluation import metrics


def trusted(*switch_off: int | None, steps: int = 20, on_again: int | None = None) -> np.ndarray:
    """[T, 4, N] with vision left at update `switch_off` of each robot."""
    flat = np.ones((steps * 4, len(switch_off)), bool)
    for robot, update in enumerate(switch_off):
        if update is not None:
            flat[update:on_again, robot] = False
    return flat.reshape(steps, 4, -1)


def test_switch_delay_counts_updates_from_the_onset() -> None:
    delay = metrics.switch_delay(trusted(46, None, 10), start=10)
    assert delay[0] == pytest.approx(0.035)
    assert np.isnan(delay[1])
    assert delay[2] == 0


def test_switches_and_false_switches() -> None:
    vision = trusted(10, None, on_again=50)
    assert metrics.switches(vision).tolist() == [2, 0]
    healthy = np.zeros((20, 2), bool)
    assert metrics.false_switches(vision, healthy) == 1
    assert metrics.false_switches(vision, ~healthy) == 0
    assert metrics.healthy_hours(healthy) == pytest.approx(40 * 0.02 / 3600)


def test_bootstrap_interval_of_a_mean_matches_the_normal_one() -> None:
    values = np.random.default_rng(0).normal(3, 2, 400)
    low, high = metrics.bootstrap_interval(values)
    half = 1.96 * values.std() / 20
    assert low == pytest.approx(values.mean() - half, abs=0.03)
    assert high == pytest.approx(values.mean() + half, abs=0.03)
    assert np.isnan(metrics.bootstrap_interval(np.array([np.nan]))).all()


@given(st.lists(st.floats(0, 1), min_size=2, max_size=30), st.integers(1, 29))
@settings(deadline=None)
def test_roc_area_is_the_probability_of_ranking_right(scores, split) -> None:
    split = min(split, len(scores) - 1)
    healthy, faulty = np.array(scores[:split]), np.array(scores[split:])
    pairs = (faulty[:, None] > healthy) + 0.5 * (faulty[:, None] == healthy)
    assert metrics.roc(healthy, faulty)[2] == pytest.approx(pairs.mean())
