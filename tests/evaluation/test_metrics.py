from math import comb

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


@pytest.mark.parametrize("n", [1, 8, 20])
def test_a_share_of_all_or_none_keeps_the_width_that_so_few_robots_have(n):
    """Clopper and Pearson (1934): n of n rules out what happens in less than 2.5 % of cases."""
    low, high = metrics.share_interval(np.ones(n))
    assert (low, high) == pytest.approx((0.025 ** (1 / n), 1.0))
    assert metrics.share_interval(np.zeros(n)) == pytest.approx((1.0 - high, 1.0 - low))


def test_share_intervals_leave_out_what_seldom_makes_such_a_share():
    """Both ends are the shares at which so many or more, so few or fewer, have 2.5 %."""
    low, high = metrics.share_interval(np.repeat([1, 0], (13, 7)))
    more = sum(comb(20, k) * low**k * (1 - low) ** (20 - k) for k in range(13, 21))
    fewer = sum(comb(20, k) * high**k * (1 - high) ** (20 - k) for k in range(14))
    assert (more, fewer) == pytest.approx((0.025, 0.025))
    row = metrics.share_columns("crossed", np.repeat([1, 0], (13, 7)))
    assert row == {"crossed_rate": 0.65, "crossed_ci95_low": low, "crossed_ci95_high": high}


def test_bootstrap_interval_of_a_mean_matches_the_normal_one():
    values = np.random.default_rng(0).normal(3, 2, 400)
    low, high = metrics.bootstrap_interval(values)
    half = 1.96 * values.std() / 20
    assert (low, high) == pytest.approx((values.mean() - half, values.mean() + half), abs=0.03)
    row = metrics.mean_columns("speed", values)
    assert row == {"speed": values.mean(), "speed_ci95_low": low, "speed_ci95_high": high}
    assert np.isnan(metrics.bootstrap_interval(np.array([np.nan]))).all()
    assert metrics.bootstrap_interval(np.zeros(1), lambda values: 7.0) == (7.0, 7.0)


@pytest.mark.parametrize(("failing", "switches"), [(1, 1), (2, 0), (3, 1)])
def test_a_switch_counts_as_false_by_the_camera_of_its_own_step(failing, switches):
    """Not by that of the step before or after."""
    vision, spoilt = np.ones((20, 1), bool), np.zeros((5, 1), bool)
    vision[8:] = False  # The first update of step 2.
    spoilt[failing] = True
    assert metrics.false_switches(vision.reshape(5, 4, 1), spoilt) == switches


def test_the_bootstrap_interval_is_of_percentiles():
    """Of skewed values it is longer above the mean; mirrored, it would be longer below."""
    values = np.random.default_rng(1).exponential(1.0, 12) ** 3
    draws = np.random.default_rng(2).choice(values, (20_000, 12)).mean(axis=1)
    expected = np.percentile(draws, (2.5, 97.5))
    np.testing.assert_allclose(metrics.bootstrap_interval(values), expected, rtol=0.15)
    low, high = expected
    assert high - values.mean() > 1.5 * (values.mean() - low)
