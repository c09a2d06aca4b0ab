"""The paper's filter and selector, and thresholds from healthy scores."""

import math
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from renet.errors import RenetError
from renet.selector import MONITORS, SelectorInput, SelectorSpec, make_selector
from renet.selector.calibration import calibrate
from renet.selector.filter import filter_delay, low_pass
from renet.selector.selector import BETWEEN_RETURNS, DWELL, check_selector

GAMMAS = st.floats(0.005, 1.0)
FALLBACKS = {name: m.fallback for name, m in MONITORS.items() if m.fallback is not None}


@given(gamma=GAMMAS, rate=st.sampled_from([10.0, 50.0, 200.0]))
def test_the_delay_formula_equals_what_the_filter_does(gamma, rate):
    probability, updates = np.ones(1), 0
    while probability > 0.5:
        probability = low_pass(probability, np.array([False]), gamma)
        updates += 1
    assert filter_delay(gamma, rate) * rate == pytest.approx(updates)
    assert filter_delay(0.1, rate) == pytest.approx(7 / rate), "the paper's 35 ms at 200 Hz"


@given(
    gamma=GAMMAS,
    verdicts=st.lists(st.tuples(st.booleans(), st.integers(0, 60)), min_size=1, max_size=30),
)
def test_probability_follows_the_equation_and_stays_a_probability(gamma, verdicts):
    """Each verdict is taken as often as its number says."""
    probability, expected = np.ones(1), 1.0
    for verdict, count in verdicts:
        probability = low_pass(probability, np.array([verdict]), gamma, count)
        for _ in range(count):
            expected = (1.0 - gamma) * expected + gamma * float(verdict)
        assert probability[0] == pytest.approx(expected, abs=1e-12)


def test_the_papers_selector_leaves_and_returns_by_the_filter_alone():
    selector = make_selector("switch", SelectorSpec(beta=0.5), 4)
    scores = np.array([0.4, 0.6, np.nan, np.inf])
    for update in range(7):
        vision = selector.update(SelectorInput(scores), 0.005 * update)
    assert vision.tolist() == [True, False, False, False]
    assert selector.reason[1] == "images unlike those of training"
    selector.reset(np.array([False, True, False, False]))
    assert selector.probability[1] == 1.0
    assert selector.probability[2] < 0.5
    for update in range(7, 35):
        scores = np.full(4, 0.6 if 15 <= update < 25 else 0.4)
        vision = selector.update(SelectorInput(scores), 0.005 * update)
        assert vision.all() or update not in (14, 34), "neither a dwell, nor a rest between returns"


@pytest.mark.parametrize(
    ("thresholds", "used"),
    [
        ({}, FALLBACKS | {"reconstruction": 0.02}),
        ({"variance": 4.0, "nearness": 0.4}, FALLBACKS | {"variance": 4.0, "nearness": 0.4}),
        (dict.fromkeys(MONITORS, 0.3), dict.fromkeys(MONITORS, 0.3)),
    ],
)
def test_a_bundles_selector_takes_all_its_settings(thresholds, used):
    selector = make_selector("memory", SelectorSpec(0.02, 0.6, 50.0, thresholds), 3)
    assert (selector.spec.gamma, selector.spec.rate_hz) == (0.6, 50.0)
    assert (selector.dwell, selector.between_returns) == (DWELL, BETWEEN_RETURNS)
    assert selector.vision.tolist() == [True] * 3
    assert selector.spec.used_thresholds == used
    assert [*selector.thresholds.items()] == [(n, used[n]) for n in MONITORS if n in used]


def test_an_unknown_selector_is_refused():
    with pytest.raises(RenetError, match="unknown selector 'coin': choose one of memory, switch"):
        make_selector("coin", SelectorSpec(beta=0.5))


def test_calibration_is_the_maximum_or_a_guaranteed_quantile():
    scores = np.arange(1.0, 100.0)
    assert calibrate(scores) == 99.0
    assert calibrate(scores, 0.01) == 99.0
    assert calibrate(scores, 0.10) == 90.0
    random = np.random.default_rng(0)
    exceeded = [random.random() > calibrate(random.random(199), 0.05) for _ in range(4000)]
    assert np.mean(exceeded) < 0.06


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("gamma", (-0.1, 0.0, 1.001, math.nan)),
        ("beta", (0.0, -1.0, math.inf, math.nan)),
        ("rate_hz", (0.0, -1.0, math.inf, math.nan)),
    ],
)
def test_a_selector_without_a_filter_a_threshold_or_a_rate_is_refused(name, values):
    for value in values:
        with pytest.raises(RenetError, match=f"selector.{name} must be .* got {value}"):
            replace(SelectorSpec(beta=0.1, gamma=1.0), **{name: value})


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({}, ""),
        ({"rate_hz": 10.0}, ""),
        ({"rate_hz": 1000.0}, ""),
        ({"rate_hz": 1000.1}, "rate_hz must be from 10 to 1000 Hz, got 1000.1"),
        ({"rate_hz": 9.9}, "rate_hz must be from 10 to 1000 Hz, got 9.9"),
        ({"gamma": 0.06, "rate_hz": 10.0}, "gamma 0.06 at 10 Hz delays a switch by 1.2 s, at most"),
        ({"beta": 0.26}, "threshold beta 0.26 would never object, at most 0.25"),
        ({"thresholds": {name: monitor.limit for name, monitor in MONITORS.items()}}, ""),
        ({"thresholds": {"frame_age": 1.5}}, "frame_age 1.5 would never object, at most 1"),
        ({"thresholds": {"variance": math.nan}}, "variance nan would never object"),
        ({"thresholds": {"luck": 1.0}}, "unknown monitor 'luck': choose one of frame_age, dup"),
    ],
)
def test_what_no_bundle_may_hold(changes, problem):
    with pytest.raises(RenetError, match=problem) if problem else nullcontext():
        check_selector(replace(SelectorSpec(beta=0.1), **changes))
