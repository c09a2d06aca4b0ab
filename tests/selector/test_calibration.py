"""Thresholds with a stated rate of false alarms, against tails whose answer is known."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from renet.errors import RenetError
from renet.selector import MONITORS, calibration
from renet.selector.calibration import (
    APART,
    calibrate_monitors,
    decluster,
    return_level,
    stale_above,
)


def hours(n: float, seed: int = 0, runs: int = 40) -> list[np.ndarray]:
    """Exponential scores at 10 Hz, in several runs."""
    draw = np.random.default_rng(seed)
    return list(draw.exponential(1.0, (runs, round(n * 36000 / runs))))


@pytest.mark.parametrize("shape", [-0.2, -0.1, 0.0])
def test_the_level_of_a_pareto_tail_far_beyond_all_scores_is_its_quantile(shape: float) -> None:
    """A generalised Pareto tail by its exact quantiles, one burst in 50 scores."""

    def excess(exceeded: np.ndarray) -> np.ndarray:
        return (exceeded**-shape - 1.0) / shape if shape else -np.log(exceeded)

    run = np.full(50_000, 5.0)
    run[::50] += excess((np.arange(1000) + 0.5) / 1000)
    assert return_level([run], 1e-6) - 5.0 == pytest.approx(excess(np.array(1e-9)), rel=0.06)


def test_a_monitor_that_needs_two_in_a_row_is_calibrated_by_the_lower_of_two() -> None:
    """One of these scores exceeds x with probability exp(-x), two in a row with exp(-2 x)."""
    runs = hours(20)
    thresholds = calibrate_monitors({"variance": runs, "surprise": runs}, 1.0).thresholds
    assert thresholds["surprise"] == pytest.approx(0.5 * thresholds["variance"], rel=0.15)


def test_bursts_that_all_peak_alike_have_a_level_and_a_bounded_tail_stays_near_its_bound() -> None:
    equal = np.ones(2000)
    equal[::50] = 2.0
    assert 2.0 < return_level([equal], 0.1) < 4.5
    runs = 1.0 - np.random.default_rng(0).random((30, 2000)) ** 0.5  # Dense towards 0, below 1.
    assert runs.max() < return_level([*runs], 0.1) < 1.2


def test_a_blank_image_is_never_healthy() -> None:
    noses = [-0.04 * run.clip(max=1.0) for run in hours(0.5)]
    covered = [run.clip(max=1.0) for run in hours(0.5)]
    thresholds = calibrate_monitors({"uniformity": noses, "nearness": covered}).thresholds
    assert thresholds == {name: MONITORS[name].ceiling for name in ("uniformity", "nearness")}


def test_calibrated_monitors_keep_the_stated_rate_on_new_robots() -> None:
    runs = {"reconstruction": hours(3.0), "disagreement": hours(3.0, 1)}
    thresholds, robot_hours, _ = calibrate_monitors(runs, 1.0)
    assert robot_hours == pytest.approx(3.0)
    new = {"reconstruction": hours(40.0, 2), "disagreement": hours(40.0, 3)}
    alarms = [decluster(run, thresholds[name]) for name, runs in new.items() for run in runs]
    assert sum(map(len, alarms)) / 40.0 <= 1.0


def with_bursts(runs: list[np.ndarray], height: float, count: int = 1) -> list[np.ndarray]:
    """The same runs, and one with bursts far above them, 3 s apart."""
    odd = np.zeros(50 + 30 * count)
    for burst in range(count):
        odd[20 + 30 * burst : 25 + 30 * burst] = height
    return [*runs, odd]


def test_one_walk_of_many_hours_sets_no_threshold() -> None:
    runs = {"variance": hours(4.0), "disagreement": hours(4.0, 1)}
    usual = calibrate_monitors(runs).thresholds
    odd = {name: with_bursts(of, 100.0) for name, of in runs.items()}
    thresholds, robot_hours, left_out = calibrate_monitors(odd)
    assert left_out == 1
    for name, threshold in thresholds.items():
        assert usual[name] < threshold < 1.1 * usual[name], "what remains of the rate is less"
    new = {"variance": hours(40.0, 2), "disagreement": hours(40.0, 3)}
    alarms = [decluster(run, thresholds[name]) for name, runs in new.items() for run in runs]
    assert 1 / robot_hours + sum(map(len, alarms)) / 40.0 <= 0.5


@pytest.mark.parametrize(
    ("healthy", "odd_runs", "bursts"),
    [(3.0, 1, 1), (4.0, 2, 1), (4.0, 1, 2), (20.0, 1, 12)],
    ids=["too short", "two walks", "two alarms in a walk", "twelve in a long calibration"],
)
def test_walks_with_more_alarms_than_are_allowed_are_not_left_out(
    healthy: float, odd_runs: int, bursts: int
) -> None:
    runs = hours(healthy)
    for _ in range(odd_runs):
        runs = with_bursts(runs, 100.0, bursts)
    calibration = calibrate_monitors({"variance": runs})
    assert calibration.thresholds["variance"] > 100.0


def test_a_single_long_run_is_not_left_out() -> None:
    runs = hours(5.0, runs=1)
    calibration = calibrate_monitors({"variance": runs})
    assert calibration.left_out == 0
    assert calibration.thresholds["variance"] > np.max(runs)


def test_no_walk_is_left_out_without_need() -> None:
    """Forty walks that are all alike: without one of them the highest score is the same."""
    runs = hours(0.1, runs=1) * 40
    thresholds, robot_hours, left_out = calibrate_monitors({"variance": runs})
    assert left_out == 0
    assert thresholds["variance"] == return_level(runs, 0.5 * robot_hours)


def test_what_never_varies_gets_its_floor_or_nothing() -> None:
    still = [np.full(100, 0.1), np.full(50, 0.1)]
    thresholds = calibrate_monitors(
        {"reconstruction": hours(0.1), "invalid_fraction": still, "disagreement": still}
    ).thresholds
    assert thresholds["invalid_fraction"] == MONITORS["invalid_fraction"].floor
    assert "disagreement" not in thresholds
    holes = calibrate_monitors({"invalid_fraction": [np.full(100, 0.4)]}).thresholds
    assert 0.4 < holes["invalid_fraction"] < 0.401, "what was healthy must not object"
    real = [0.3 + 0.01 * run for run in hours(0.1)]
    raised = calibrate_monitors({"invalid_fraction": real}).thresholds
    assert raised["invalid_fraction"] > np.max(real)


def test_a_burst_is_counted_once() -> None:
    run = np.zeros(100)
    run[[5, 7, 14, 60]] = [2.0, 3.0, 2.5, 4.0]
    assert decluster(run, 1.0) == [3.0, 4.0]
    assert decluster(run, 4.0) == [], "above, not at the level"


@given(
    scores=st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=60),
    expected=st.floats(0.01, 10.0),
)
def test_a_calibrated_level_is_above_all_it_was_learnt_from(scores, expected) -> None:
    run = np.array(scores)
    assert return_level([run], expected) > run.max() or np.ptp(run) < 1e-9


@given(lower=st.floats(0.05, 1.0), factor=st.floats(1.0, 50.0))
@settings(max_examples=25)
def test_fewer_false_alarms_never_lower_a_threshold(lower, factor) -> None:
    runs = {"reconstruction": hours(0.2)}
    strict = calibrate_monitors(runs, lower).thresholds
    loose = calibrate_monitors(runs, lower * factor).thresholds
    assert strict["reconstruction"] >= loose["reconstruction"]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: calibrate_monitors({"age": [np.array([np.nan])]}), "one score, all of them fin"),
        (lambda: calibrate_monitors({"age": []}), "needs at least one score"),
        (
            lambda: calibration.calibrate(np.array([])),
            "needs at least one score, all of them finite",
        ),
        (lambda: calibration.calibrate(np.array([1.0, math.nan])), "one score, all of them finite"),
        (
            lambda: calibration.calibrate(np.arange(50.0), 0.01),
            "0.01 needs at least 99 .* got 50",
        ),
    ],
)
def test_bad_input_is_refused(wrong, message: str) -> None:
    with pytest.raises(RenetError, match=message):
        wrong()


def test_memory_is_stale_from_where_its_falls_exceed_ops():
    random = np.random.default_rng(0)
    error = random.uniform(0, 1, 50_000)
    blind = np.full(50_000, 0.004)
    fell = random.random(50_000) < np.where(error > 0.7, 0.02, 0.001)
    assert stale_above(error, fell, blind) == pytest.approx(0.7, abs=0.02)


def test_the_order_of_robots_that_are_as_stale_as_each_other_makes_no_difference():
    """Two seconds after its last image every robot falls as often as with OP, 40 in 100."""
    age = np.full(100, 2.0)
    fell = np.arange(100) < 40
    blind = np.full(100, 0.4)
    assert math.isinf(stale_above(age, fell, blind))
    assert math.isinf(stale_above(age, fell[::-1], blind))
    always = np.ones(100, bool)
    assert stale_above(age, always, blind) == 2.0


def test_chance_makes_no_memory_stale():
    random = np.random.default_rng(1)
    error, blind = random.uniform(0, 1, 20_000), np.full(20_000, 0.004)
    limits = [stale_above(error, random.random(20_000) < 0.003, blind) for _ in range(50)]
    assert np.isinf(limits).mean() > 0.9
    assert math.isinf(stale_above(np.zeros(0), np.zeros(0, bool), np.zeros(0)))


def test_a_tail_heavier_than_an_exponential_one_is_taken_as_exponential() -> None:
    """Its shape would be fitted badly; the level's margin is the mean exceedance."""
    peaks = (np.random.default_rng(0).random(1000) ** -0.3 - 1.0) / 0.3
    run = np.full(50_000, 5.0)
    run[::50] += peaks
    level = return_level([run], 1e-12)
    assert level == pytest.approx(5.0 + peaks.mean() * math.log(1e15), rel=0.02)


def test_the_rate_of_false_alarms_is_shared_between_monitors() -> None:
    first, second = hours(0.3), hours(0.3, 1)
    both = calibrate_monitors({"reconstruction": first, "disagreement": second}, 1.0).thresholds
    alone = calibrate_monitors({"reconstruction": first}, 0.5).thresholds
    assert both["reconstruction"] == alone["reconstruction"]


def test_a_false_alarm_every_two_hours_is_the_default() -> None:
    runs = {"reconstruction": hours(0.3)}
    by_default = calibrate_monitors(runs)
    assert by_default == calibrate_monitors(runs, false_alarms_per_hour=0.5, rate_hz=10.0)
    assert by_default != calibrate_monitors(runs, false_alarms_per_hour=0.6, rate_hz=10.0)


@pytest.mark.parametrize(("apart", "bursts"), [(APART - 1, 1), (APART, 2)])
def test_bursts_are_apart_from_ten_scores_on(apart: int, bursts: int) -> None:
    run = np.zeros(100)
    run[[5, 5 + apart]] = 2.0
    assert len(decluster(run, 1.0)) == bursts
