import numpy as np
import pytest

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
