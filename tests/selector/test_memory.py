"""The selector's three states: a robot sees, remembers or is blind."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from tests.selector.inputs import seen

from renet.errors import RenetError
from renet.selector import MONITORS, SelectorSpec, make_selector
from renet.selector.selector import BLIND, DWELL, REMEMBERS, SEES, STEADY, check_selector

SPEC = SelectorSpec(
    beta=0.2,
    thresholds={"variance": 3.0, "surprise": 1.5, "disagreement": 1.0, "map_error": 0.3},
    longest_memory=2,
)
TICK = 0.1
HEALTHY = seen(robots=1)


class Walk:
    """One robot under a memory's selector, tick by tick, as the controller runs it."""

    def __init__(self, healthy: int = 3) -> None:
        """Begin with some healthy ticks."""
        self.selector, self.ticks = make_selector("memory", SPEC), itertools.count()
        self.random, self.image = np.random.default_rng(0), np.ones((1, 48, 64))
        self.run(healthy)

    def tick(
        self,
        variance=1.0,
        fresh=True,
        age=0.0,
        map_error=0.1,
        apart=0.0,
        image=None,
        surprise=0.3,
        late=False,
    ):
        """One tick and its twenty updates; returns the state after it.

        Where it is late, its surprise is there from the next control step on.
        """
        if fresh:
            self.image = self.random.random((1, 48, 64)) if image is None else image.copy()
        given = replace(
            HEALTHY,
            image=self.image,
            fresh=np.array([fresh]),
            age=np.array([age]),
            velocity_vp=np.array([[apart, 0.0, 0.0]]),
            variance_score=np.array([variance]),
            surprise=np.array([surprise]),
            map_error=np.array([map_error]),
        )
        not_yet = {name: np.full(1, np.inf) for name in ("variance_score", "surprise", "map_error")}
        gate = self.selector.look(replace(given, **not_yet))  # The models have not run.
        assert gate is not None
        has_image = gate.judge({name: getattr(given, name) for name in gate.limits})
        now = TICK * next(self.ticks)
        for update in range(20):
            new = replace(given, fresh=given.fresh & (update == 0), has_image=has_image)
            if late and update < 4:
                new = replace(new, surprise=self.surprise, scored=False)
            self.selector.update(new, now + update / 200)
        self.surprise = given.surprise
        return str(self.selector.state[0])

    def run(self, ticks: int, **given) -> list[str]:
        return [self.tick(**given) for _ in range(ticks)]


@pytest.mark.parametrize(
    ("spoilt", "reason", "again"),
    [
        ({"variance": 5.0}, "images unlike those of training", 1),
        ({"image": np.zeros((1, 48, 64))}, "the image is blank", 1),
        ({"surprise": 2.0}, "the image contradicts what was seen before", STEADY),
        ({"age": 0.5, "fresh": False}, "no new image", STEADY),
    ],
)
def test_a_spoilt_image_is_withheld_at_once_and_a_good_one_used_again(spoilt, reason, again):
    walk = Walk(healthy=0)
    assert walk.run(5) == [SEES] * 5
    assert walk.run(8, **spoilt) == [REMEMBERS] * 8
    assert walk.selector.reason[0] == reason
    assert walk.selector.without_image[0] == pytest.approx(0.8, abs=0.02)
    assert walk.selector.vision.all(), "VP drives all the while"
    assert walk.run(again) == [REMEMBERS] * (again - 1) + [SEES]
    assert walk.selector.reason[0] == ""
    assert walk.selector.without_image[0] == 0


@pytest.mark.parametrize("late", [False, True])
def test_a_lie_that_surprises_now_and_then_is_never_believed(late):
    walk = Walk()
    lies = [walk.tick(surprise=2.0 if tick % 6 < 2 else 1.0, late=late) for tick in range(12)]
    assert lies == [REMEMBERS] * 12
    assert walk.run(STEADY)[-2:] == [REMEMBERS, SEES]


def test_a_lie_that_surprises_less_and_less_is_believed_only_if_it_surprises_little():
    walk = Walk()
    assert walk.run(2, surprise=2.0) == [REMEMBERS] * 2
    assert walk.run(8, surprise=1.0) == [REMEMBERS] * 8
    assert walk.run(STEADY, surprise=0.7) == [REMEMBERS] * (STEADY - 1) + [SEES]
    assert walk.run(3, surprise=1.0) == [SEES] * 3, "who sees again is no longer lied to"


def test_one_surprising_image_is_withheld_alone():
    walk = Walk()
    assert walk.run(1, surprise=2.0) == [REMEMBERS]
    assert walk.run(2) == [SEES] * 2
    assert walk.run(1, surprise=2.0) == [REMEMBERS]


def test_an_old_image_is_no_lie_although_it_contradicts_what_was_expected():
    walk = Walk()
    assert walk.run(3, fresh=False, age=0.1, surprise=2.0) == [REMEMBERS] * 3
    assert walk.run(3) == [SEES] * 3


def test_late_images_that_come_now_and_then_are_not_used():
    walk = Walk()
    states = [
        walk.tick(fresh=fresh, age=0.0 if fresh else 0.3)
        for fresh in (False, True, True, False) * 3
    ]
    assert states == [REMEMBERS] * 12
    assert walk.run(3 * STEADY)[STEADY:] == [SEES] * 2 * STEADY
    # A camera that misses single images is no late one.
    assert [walk.tick(fresh=fresh, age=0.1) for fresh in (False, True) * 5][1::2] == [SEES] * 5


def test_the_reason_of_a_wait_is_told_though_the_models_answer_after_the_next_image_came():
    selector = make_selector("memory", SPEC)
    selector.look(seen(1, age=np.full(1, 0.5)))
    for step, has_image in enumerate((True, False)):
        given = seen(1, has_image=np.array([has_image]), map_error=np.zeros(1))
        selector.update(given, 0.02 * step)
    assert selector.reason[0] == "no new image"


def test_each_robot_waits_for_its_own_camera_and_no_longer_once_it_is_reset():
    selector = make_selector("memory", SPEC, 3)
    late = seen(3, age=np.array([0.0, 0.5, 0.5]))
    assert selector.look(late).acceptable.tolist() == [True, False, False]
    selector.reset(np.array([False, False, True]))
    # An image that is missed is none of the five.
    assert not selector.look(seen(3, fresh=np.zeros(3, bool))).acceptable.any()
    random = np.random.default_rng(0)
    for used in ([0, 2],) * 4 + ([0, 1, 2],):
        given = seen(3, image=random.random((3, 48, 64)))
        assert np.flatnonzero(selector.look(given).acceptable).tolist() == used


def test_a_late_image_is_withheld_before_its_age_counts_and_a_frozen_one_counts_once_a_tick():
    walk = Walk()
    assert [walk.tick(fresh=False, age=0.1), walk.tick()] == [REMEMBERS, SEES]
    walk = Walk(healthy=2)
    # Three equal images in a row are the threshold: the first of them came with the last tick.
    assert walk.run(4, image=walk.image) == [SEES, REMEMBERS, REMEMBERS, REMEMBERS]
    assert walk.selector.reason[0] == "the image is frozen"


def test_op_takes_over_when_memory_is_too_old_and_hands_back_after_the_dwell():
    walk = Walk()
    states = walk.run(30, variance=9.0)
    blind_at = states.index(BLIND)
    # 2 s, and the filter's 35 ms.
    assert blind_at == pytest.approx(20, abs=1)
    assert states == [REMEMBERS] * blind_at + [BLIND] * (30 - blind_at)
    cause = "images unlike those of training"
    assert walk.selector.reason[0] == f"{cause} for 2 s, as long as it remembers"
    back = walk.run(15)
    assert back.index(SEES) == pytest.approx(DWELL / TICK, abs=1)
    # An image now and then does not bring VP back to the wheel.
    walk.run(60)
    walk.run(30, variance=9.0)
    assert set(walk.run(5) + walk.run(3, variance=9.0) + walk.run(5)) == {BLIND}


def test_the_reason_stays_that_of_the_first_image_withheld_when_op_takes_over():
    walk = Walk()
    # Images that stay black are soon frozen too.
    assert walk.run(30, image=np.zeros((1, 48, 64)))[-1] == BLIND
    assert walk.selector.reason[0] == "the image is blank for 2 s, as long as it remembers"


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ({"map_error": 0.4}, "the memory of the ground is stale"),
        ({"apart": 1.5}, "the estimators disagree on velocity"),
    ],
)
def test_op_takes_over_within_a_tick_when_the_estimators_are_objected_to(given, reason):
    walk = Walk()
    assert walk.run(2, **given) == [BLIND, BLIND]
    assert walk.selector.reason[0] == reason
    walk = Walk()
    walk.run(5, variance=9.0)
    assert walk.tick(variance=9.0, **given) == BLIND


def test_without_a_memory_every_image_is_used_and_a_spoilt_one_costs_vision():
    for kind, spec in (("memory", SelectorSpec(beta=0.2)), ("switch", SPEC)):
        selector = make_selector(kind, spec)
        given = replace(HEALTHY, anomaly_score=np.full(1, 0.9), has_image=np.ones(1, bool))
        assert selector.look(given).judge({}).all()
        for update in range(7):
            selector.update(given, update / 200)
        assert selector.state.tolist() == [BLIND]
        assert selector.without_image.tolist() == [0]


def test_who_has_seen_nothing_remembers_nothing():
    walk = Walk(healthy=0)
    assert walk.run(2, variance=9.0) == [BLIND, BLIND]
    assert walk.selector.reason[0] == "images unlike those of training"
    walk = Walk()
    walk.selector.reset(np.ones(1, bool))
    assert walk.run(30, variance=9.0) == [BLIND] * 30
    walk.selector.reset(np.ones(1, bool))
    assert walk.tick() == SEES


def test_a_memory_without_end_is_refused():
    for longest, problem in (
        (-1, "finite"),
        (np.inf, "finite"),
        (np.nan, "finite"),
        (61, "61 s is"),
    ):
        with pytest.raises(RenetError, match=f"selector.longest_memory .*{problem}"):
            check_selector(SelectorSpec(beta=0.1, longest_memory=longest))
    assert MONITORS["map_error"].limit == 1.0


def test_a_robot_that_begins_anew_sees_and_remembers_nothing():
    walk = Walk()
    assert walk.run(5, variance=9.0)[-1] == REMEMBERS
    assert walk.selector.without_image[0] > 0.0
    walk.selector.reset(np.array([True]))
    assert walk.selector.without_image[0] == 0.0
    assert walk.selector.state[0] == SEES


def test_a_robot_whose_vp_is_distrusted_is_blind_at_once_and_sees_again_after_the_dwell():
    """Whatever the monitors say."""
    walk = Walk(healthy=60)
    walk.selector.distrust(np.array([True]), "VP found no numbers")
    assert walk.selector.state[0] == BLIND
    assert walk.selector.reason[0] == "VP found no numbers"
    states = walk.run(30)
    assert set(states[: round(DWELL / TICK) - 1]) == {BLIND}
    assert states[-1] == SEES
