"""Monitors by hand, and what the selector promises."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.selector.inputs import seen

from renet.selector import MONITORS, SelectorInput, SelectorSpec
from renet.selector.filter import filter_delay
from renet.selector.monitors import Scorer
from renet.selector.selector import MonitorSelector


def blank(value: float) -> np.ndarray:
    image = seen().image.copy()
    image[1] = value
    return image


@pytest.mark.parametrize(
    ("name", "threshold", "bad"),
    [
        ("reconstruction", 0.01, {"anomaly_score": np.array([0.001, 0.02])}),
        ("reconstruction", 0.01, {"anomaly_score": np.array([0.001, np.nan])}),
        ("variance", 4.0, {"variance_score": np.array([1.0, 5.0])}),
        ("frame_age", 0.2, {"age": np.array([np.nextafter(0.2, 0.0), 0.2])}),
        ("invalid_fraction", 0.1, {"invalid": np.array([0.05, 0.3])}),
        ("uniformity", -0.01, {"image": blank(0.0)}),
        ("uniformity", -0.01, {"image": blank(1.0)}),
        ("nearness", 1.0, {"image": blank(0.02)}),
        ("disagreement", 0.5, {"velocity_vp": np.array([[0.0, 0, 0], [0.4, 0.4, 0]])}),
    ],
)
def test_each_monitor_objects_to_its_fault_alone(name, threshold, bad):
    chosen = MonitorSelector({name: threshold}, SelectorSpec(beta=1.0, gamma=1.0), 2)
    assert chosen.update(seen(), 0.0).all()
    assert chosen.update(seen(**bad), 0.01).tolist() == [True, False]
    assert chosen.reason.tolist() == ["", MONITORS[name].reason]


def test_what_a_camera_has_not_given_yet_is_not_needed():
    every = Scorer(1).scores(seen(robots=1, map_error=np.zeros(1)))
    assert every.shape == (len(MONITORS), 1)
    scores = Scorer(1).scores(SelectorInput(np.array([0.3])), ["reconstruction", "uniformity"])
    np.testing.assert_array_equal(scores, [[0.3], [0.0]])


def test_equal_images_in_a_row_are_counted():
    scorer, live, frozen = Scorer(2), np.random.default_rng(1), seen().image[1]

    def repeats(*fresh: bool) -> list:
        image = np.stack((live.random((48, 64)), frozen))
        return scorer.scores(seen(image=image, fresh=np.array(fresh)), ["duplicate"]).tolist()

    for count in (1, 2, 3, 4):
        assert repeats(True, True) == [[1, count]]
        # Neither updates between frames count the held image, nor frames of another robot alone.
        for _ in range(5):
            assert repeats(False, False) == [[1, count]]
        assert repeats(True, False) == [[1, count]]
    scorer.reset(np.array([False, True]))
    assert repeats(True, True) == [[1, 1]]


def test_images_equal_in_part_are_counted():
    scorer = Scorer(2)
    live = np.random.default_rng(1)
    strip = live.random((4, 32))

    def partly_equal(strip: np.ndarray, column: int = 8) -> list:
        image = live.random((2, 48, 64))
        image[1, 20:24, column : column + strip.shape[1]] = strip
        given = seen(image=image, fresh=np.ones(2, bool))
        return scorer.scores(given, ["partly_frozen"]).tolist()

    for count in (1, 2, 3):
        assert partly_equal(strip) == [[1, count]]
    scorer.reset(np.array([False, True]))
    assert partly_equal(strip) == [[1, 1]]
    # Too few patches, another place, and ground out of range or in a filled hole.
    assert partly_equal(strip[:, :28]) == [[1, 1]]
    assert partly_equal(strip[:, :28]) == [[1, 1]]
    assert partly_equal(strip, column=9) == [[1, 1]]
    for _ in range(3):
        assert partly_equal(np.ones((4, 32))) == [[1, 1]]


def test_only_a_lens_that_stays_covered_counts_as_such():
    scorer, nose = Scorer(2), blank(0.02)
    nose[1, :28] = 0.5  # Over half of its pixels see past the platform.

    def near(image: np.ndarray, fresh: bool = True) -> list:
        given = seen(image=image.copy(), fresh=np.full(2, fresh))
        return scorer.scores(given, ["nearness"]).tolist()

    for count in range(1, 6):
        assert near(nose) == [[0, count]]
        for _ in range(5):
            assert near(nose, fresh=False) == [[0, count]]
    assert count < MONITORS["nearness"].fallback
    assert near(seen().image) == [[0, 0]], "it is up"
    nose[1, :29] = 0.5
    assert near(nose) == [[0, 0]], "less than two fifths"
    assert near(blank(0.02)) == [[0, 1]]
    scorer.reset(np.array([False, True]))
    assert near(blank(0.02)) == [[0, 1]]


STEP = 1 / 200


def selector(**filtered) -> MonitorSelector:
    spec = SelectorSpec(beta=1.0, **filtered)
    return MonitorSelector({"reconstruction": 0.01, "frame_age": 0.2}, spec, 2)


def run(chosen: MonitorSelector, given: SelectorInput, start: float, end: float, step=STEP):
    """Answers [updates, 2] at times `start`, `start + step`, ... before `end`."""
    times = start + step * np.arange(round((end - start) / step))
    return times, np.array([chosen.update(given, now).copy() for now in times])


HELD = np.zeros(2, bool)
"""No image is new: what is tested is time, not the counting of images."""
STALE = seen(age=np.array([0.0, 1.0]), fresh=HELD)
GOOD = seen(fresh=HELD)


def test_it_leaves_as_fast_as_the_papers_filter_and_says_why():
    chosen = selector()
    assert run(chosen, STALE, 0.0, 0.03)[1].all()
    # The other robot only begins to object.
    assert chosen.update(seen(age=np.ones(2)), 0.03).tolist() == [True, False]
    assert chosen.reason.tolist() == ["", "no new image"]
    for start, end, reason in ((0.035, 1.0, "no new image"), (1.0, 1.1, "")):
        run(chosen, seen(), start, end)
        assert chosen.reason.tolist() == ["", reason], "until vision returns"
    assert chosen.vision.all()


@settings(max_examples=60)
@given(
    rate=st.sampled_from([10.0, 37.0, 50.0, 75.0, 200.0, 500.0]),
    calls=st.sampled_from([10.0, 33.0, 50.0, 200.0, 1000.0]),
    start=st.sampled_from([0.0, 1e3, 1.7e9]),
)
def test_delay_dwell_and_rest_are_seconds_at_any_rate_of_filter_and_caller(rate, calls, start):
    """Within one period of the filter plus one of the caller, whoever is slower."""
    chosen, step = selector(rate_hz=rate), 1.0 / calls
    tolerance = 1.0 / rate + step + 1e-6
    run(chosen, GOOD, start, start + 1.0, step)
    fault = start + 1.0
    times, visions = run(chosen, STALE, fault, fault + 3.0, step)
    left = times[(~visions[:, 1]).argmax()] - fault
    assert not visions[:, 1].all()
    assert abs(left - filter_delay(0.1, rate)) <= tolerance
    times, visions = run(chosen, GOOD, fault + 3.0, fault + 6.0, step)
    # P must also come back above one half, which a slow filter takes longer for.
    back = times[visions[:, 1].argmax()] - (fault + 3.0)
    assert visions[:, 1].any()
    risen = math.log(0.5) / math.log(0.9) / rate
    assert 1.0 - 1e-6 <= back <= max(1.0, risen) + tolerance + 1.0 / rate
    # The second fault: vision must not return within five seconds of the first return.
    returned = fault + 3.0 + back
    run(chosen, STALE, returned + step, returned + 1.5, step)
    times, visions = run(chosen, GOOD, returned + 1.5, returned + 8.0, step)
    again = times[visions[:, 1].argmax()] - returned
    if not visions[0, 1]:
        assert 5.0 - 1e-6 <= again <= 5.0 + tolerance
    assert visions[:, 0].all(), "the other robot never had a fault"


def test_a_clock_that_stands_or_runs_backwards_takes_no_updates():
    chosen = selector()
    chosen.update(seen(), 1.0)
    for now in (1.0, 0.5, -3.0):
        for _ in range(50):
            assert chosen.update(STALE, now).all()
    assert not chosen.update(STALE, 1.04)[1]


def test_a_slow_filter_judges_at_its_own_times_but_sees_every_image():
    """Frames between two verdicts of a 2 Hz filter still count as equal."""
    chosen = MonitorSelector({"duplicate": 3.0}, SelectorSpec(1.0, gamma=0.6, rate_hz=2.0), 2)
    answers = [chosen.update(seen(), 0.1 * step).all() for step in range(6)]
    assert answers == [True] * 5 + [False]


@settings(max_examples=15)
@given(pattern=st.lists(st.integers(1, 400), min_size=4, max_size=30))
def test_a_flickering_camera_causes_at_most_one_return_in_five_seconds(pattern):
    chosen = selector()
    bad = np.concatenate([np.full(length, float(i % 2 == 0)) for i, length in enumerate(pattern)])
    used = []
    for i, age in enumerate(bad):
        given = replace(GOOD, age=np.full(2, age))
        used.append(chosen.update(given, i * STEP)[0])
    returns = np.flatnonzero(np.diff(used, prepend=True) & used) * STEP
    assert (np.diff(returns) >= 5.0 - 1e-6).all()


def test_reset_uses_vision_again():
    chosen = selector()
    run(chosen, seen(age=np.ones(2)), 0.0, 0.05)
    chosen.reset(np.array([True, False]))
    assert chosen.vision.tolist() == [True, False]
    assert chosen.reason.tolist() == ["", "no new image"]
    assert chosen.probability[0] == 1.0
    chosen.reset()
    assert chosen.vision.all()
    assert chosen.update(seen(), -100.0).all(), "another clock may follow"
    assert not run(chosen, STALE, -99.995, -99.95)[1][-1, 1]
