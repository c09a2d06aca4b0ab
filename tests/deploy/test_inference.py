"""Ticks on a second thread: the same commands, and ticks that fail, hang or are late."""

import threading
from collections.abc import Iterator
from concurrent.futures import Future
from unittest.mock import DEFAULT, Mock

import numpy as np
import pytest

from renet.deploy.controller import LATE
from renet.deploy.safety.machine import Mode
from renet.deploy.teleop.base import TeleopCommand
from renet.interface import CONTROL_DT, STEPS_PER_TICK
from renet.pilot.inference import ThreadedInference

from .fakes import ARM, WALKS_AT, Run, frame, time_of, until


@pytest.fixture
def estimator(bundle) -> Mock:
    """A session that can be spoilt, of the thread alone."""
    return Mock(wraps=bundle.sessions["estimator"])


@pytest.fixture
def run(bundle, estimator) -> Iterator[Run]:
    """A controller with a second thread, for which its loop waits."""
    run = Run(bundle, inference=lambda s: ThreadedInference({**s, "estimator": estimator}))
    run.controller.policy.inference.patience = 5.0
    yield run
    run.controller.close()


def test_the_second_thread_gives_the_same_commands(bundle, run):
    inline = Run(bundle)
    for _ in range(60):
        picture = frame(inline.step, time_of(inline.step)) if inline.step % 5 == 0 else None
        a, b = inline.tick(picture), run.tick(picture)
        # No sensor says the same twice: readings differ by nanoradians.
        np.testing.assert_allclose(a.position, b.position, atol=1e-7)


def test_a_tick_that_fails_costs_one_tick_of_vision(estimator, walk):
    estimator.run.side_effect = SystemExit  # The worst: it would end a thread silently.
    decisions = []
    for step in range(10):
        walk.ticks(1)
        decisions.append(walk.controller.decision)
        if step == 5:
            estimator.run.side_effect = None
    assert [decision.inferred for decision in decisions if decision.fallback] == [True]
    walk.ticks(16)
    assert walk.whats()[:4] == ["standing_up", "walking", "inference", "blind"]
    assert walk.whats().count("inference") == 1, "the thread lives"
    inference, op = walk.events[2:4]
    assert (inference.why, op.why) == (f"{LATE}: this tick runs blind", LATE)
    assert op.time - inference.time <= 0.2
    assert all(walk.ticks(150)[-50:]), "vision comes back"
    assert walk.controller.decision.mode is Mode.WALKING


def test_a_result_that_is_late_by_a_whole_tick_costs_vision(walk):
    """It is there when the next tick begins, but nobody has acted on it."""
    walk.controller.policy.inference.take = lambda: None
    assert not any(walk.ticks(40)[10:])
    assert walk.controller.decision.mode is Mode.WALKING
    assert walk.whats().count("inference") == 1


def test_a_stuck_vision_thread_leaves_the_robot_walking_on_op(estimator, walk):
    controller, released = walk.controller, threading.Event()
    inference, before = controller.policy.inference, controller.policy.latent_op.copy()
    inference.patience = 0.001
    estimator.run.side_effect = lambda *arguments: released.wait(30) and DEFAULT
    assert not any(walk.ticks(40)[20:])
    assert controller.decision.anomaly == np.inf
    assert controller.decision.mode is Mode.WALKING
    assert walk.whats().count("inference") == 1
    assert not np.array_equal(before, controller.policy.latent_op), "OP's estimator goes on"
    released.set()
    until(inference._tick.done)
    walk.ticks(1)
    assert not controller.decision.inferred, "its tick was made up for"
    inference.patience = 5.0
    assert all(walk.ticks(200)[-50:]), "vision comes back"
    released.clear()
    inference.patience = 0.001
    walk.ticks(40)
    assert walk.whats().count("inference") == 2, "told again"
    released.set()


def test_a_tick_that_a_brake_cut_off_does_not_blind_the_next_walk(estimator, walk):
    """It is done long before the robot walks again, and of a walk that is over."""
    controller, released = walk.controller, threading.Event()
    inference = controller.policy.inference
    inference.patience = 0.0
    estimator.run.side_effect = lambda *arguments: released.wait(30) and DEFAULT
    # A walk's ticks are its first step and every fifth one after it.
    while (walk.step - WALKS_AT) % STEPS_PER_TICK:
        walk.ticks(1)
    walk.ticks(1)
    assert not inference._tick.done()
    walk.tick(teleop=TeleopCommand(stop=True))
    released.set()
    until(inference._tick.done)
    inference.patience = 5.0
    walk.events.clear()
    walk.tick(teleop=ARM)
    seen = walk.ticks(50)
    assert walk.whats() == ["standing_up", "walking"], walk.events
    assert seen[WALKS_AT:] == [True] * len(seen[WALKS_AT:])


def test_the_loop_waits_for_less_than_half_a_period(bundle, monkeypatch):
    """With a thread that hangs, `take` gives up while there is time for the rest of the step."""
    result = Mock(side_effect=TimeoutError)
    monkeypatch.setattr(Future, "result", result)
    inference = ThreadedInference(bundle.sessions)
    inference.begin(None)  # type: ignore[arg-type]
    assert inference.take() is None
    result.assert_called_once()
    assert 0.0 < result.call_args.args[0] <= CONTROL_DT / 2
    inference.close()
