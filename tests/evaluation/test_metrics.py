import numpy as np
import pytest

from renet.evaluation import metrics


def test_switch_delay_counts_updates_from_the_onset():
    vision = np.ones((80, 3), bool)
    vision[46:, 0] = vision[10:, 2] = False
    delay = metrics.switch_delay(vision.reshape(20, 4, 3), start=10)
    np.testing.assert_allclose(delay, [0.035, np.nan, 0.0])


def test_false_switches():
    vision, healthy = np.ones((80, 2), bool), np.zeros((20, 2), bool)
    vision[10:50, 0] = False
    vision = vision.reshape(20, 4, 2)
    assert metrics.false_switches(vision, healthy) == 1
    assert metrics.false_switches(vision, ~healthy) == 0
    assert metrics.healthy_hours(healthy) == pytest.approx(40 * 0.02 / 3600)


def test_bootstrap_interval_of_a_mean_matches_the_normal_one():
    values = np.random.default_rng(0).normal(3, 2, 400)
    low, high = metrics.bootstrap_interval(values)
    half = 1.96 * values.std() / 20
    assert (low, high) == pytest.approx((values.mean() - half, values.mean() + half), abs=0.03)
    assert np.isnan(metrics.bootstrap_interval(np.array([np.nan]))).all()
    assert metrics.bootstrap_interval(np.zeros(1), lambda values: 7.0) == (7.0, 7.0)
