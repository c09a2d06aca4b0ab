"""Monitors by hand, and what the guarded selector promises."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from renet.selector.guard import GuardCfg, GuardedSelector
from renet.selector.monitors import (
    Disagreement,
    Duplicate,
    FrameAge,
    InvalidFraction,
    Monitor,
    Nearness,
    Reconstruction,
    Sight,
    Uniformity,
)


def sight(**changes) -> Sight:
    random = np.random.default_rng(0)
    plain = Sight(
        anomaly_score=np.array([0.001, 0.001]),
        image=0.2 + 0.5 * random.random((2, 48, 64)),
        fresh=np.array([True, True]),
        age=np.zeros(2),
        invalid=np.zeros(2),
        velocity_op=np.zeros((2, 3)),
        velocity_vp=np.zeros((2, 3)),
    )
    return replace(plain, **changes)


def blank(value: float) -> np.ndarray:
    image = sight().image.copy()
    image[1] = value
    return image


def healthy(monitor: Monitor, seen: Sight) -> np.ndarray:
    return monitor.score(seen) < monitor.threshold


@pytest.mark.parametrize(
    ("monitor", "bad"),
    [
        (Reconstruction(0.01), {"anomaly_score": np.array([0.001, 0.02])}),
        (Reconstruction(0.01), {"anomaly_score": np.array([0.001, np.nan])}),
        (FrameAge(0.2), {"age": np.array([0.195, 0.2])}),
        (InvalidFraction(0.1), {"invalid": np.array([0.05, 0.3])}),
        (Uniformity(-0.01), {"image": blank(0.0)}),
        (Uniformity(-0.01), {"image": blank(1.0)}),
        (Nearness(0.5), {"image": blank(0.02)}),
        (Disagreement(0.5), {"velocity_vp": np.array([[0.0, 0, 0], [0.4, 0.4, 0]])}),
    ],
)
def test_each_monitor_objects_to_its_fault_alone(monitor, bad):
    assert healthy(monitor, sight()).all()
    assert healthy(monitor, sight(**bad)).tolist() == [True, False]


def test_three_equal_images_in_a_row_are_a_frozen_camera():
    monitor = Duplicate(2, 3.0)
    live = np.random.default_rng(1)
    frozen = sight().image[1]
    verdicts = []
    for _ in range(4):
        images = np.stack((live.random((48, 64)), frozen))
        verdicts.append(healthy(monitor, sight(image=images)).tolist())
        # Updates between frames see the held image and must not count it.
        for _ in range(5):
            healthy(monitor, sight(image=images, fresh=np.zeros(2, bool)))
    assert verdicts == [[True, True], [True, True], [True, False], [True, False]]
    monitor.reset(np.array([False, True]))
    assert healthy(monitor, sight(image=np.stack((frozen, frozen)))).all()


def selector(**fields) -> GuardedSelector:
    return GuardedSelector([Reconstruction(0.01), FrameAge(0.2)], 2, GuardCfg(**fields))


def test_it_leaves_as_fast_as_the_papers_filter_and_says_why():
    guard = selector()
    stale = sight(age=np.array([0.0, 1.0]))
    visions = [guard.update(stale).tolist() for _ in range(7)]
    assert visions[5] == [True, True]
    assert visions[6] == [True, False]
    assert guard.reason.tolist() == ["", "no new image"]


def test_it_returns_after_the_dwell_and_not_before():
    guard = selector()
    for _ in range(10):
        guard.update(sight(age=np.array([0.0, 1.0])))
    updates = 0
    while not guard.update(sight())[1]:
        updates += 1
        assert updates < 1000
    assert updates / 200.0 == pytest.approx(1.0, abs=0.02)
    assert guard.reason[1] == ""


@settings(max_examples=15, deadline=None)
@given(pattern=st.lists(st.integers(1, 400), min_size=4, max_size=30))
def test_a_flickering_camera_causes_at_most_one_return_in_five_seconds(pattern):
    guard, bad, time, returns, before = selector(), False, 0.0, [], True
    for length in pattern:
        bad = not bad
        for _ in range(length):
            seen = guard.update(sight(age=np.full(2, 1.0 if bad else 0.0)))[0]
            time += 1 / 200.0
            if seen and not before:
                returns.append(time)
            before = bool(seen)
    assert all(b - a >= 5.0 - 1e-6 for a, b in pairwise(returns))


def test_reset_trusts_again():
    guard = selector()
    for _ in range(10):
        guard.update(sight(age=np.ones(2)))
    guard.reset(np.array([True, False]))
    assert guard.vision.tolist() == [True, False]
    assert guard.probability[0] == 1.0
