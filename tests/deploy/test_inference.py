"""Ticks on a second thread: the same commands, and ticks that fail, hang or are late."""

import threading
from collections.abc import Iterator
from concurrent.futures import Future

import numpy as np
import pytest

from renet.deploy.controller import LATE
from renet.deploy.inference import ThreadedInference
from renet.deploy.safety.machine import Mode
from renet.interface import CONTROL_DT

from .fakes import Run, frame, time_of
from .waiting import until


class Sabotage:
    """A session that fails or hangs off the main thread, on demand."""

    def __init__(self, session) -> None:
        self.session, self.mood = session, "well"
        self.released = threading.Event()
        self.get_inputs, self.get_outputs = session.get_inputs, session.get_outputs

    def run(self, *arguments):
        if threading.current_thread() is not threading.main_thread():
            if self.mood == "fails":
                raise SystemExit  # The worst: it would end a thread silently.
            if self.mood == "hangs":
                self.released.wait(30)
        return self.session.run(*arguments)


@pytest.fixture
def sabotage(bundle) -> Sabotage:
    return Sabotage(bundle.sessions["estimator"])


@pytest.fixture
def run(bundle, sabotage) -> Iterator[Run]:
    """A controller whose thread runs a spoilt estimator, and whose loop waits for it."""

    run = Run(bundle, inference=lambda s: ThreadedInference({**s, "estimator": sabotage}))
    run.controller._perception.patience = 5.0
    yield run
    run.controller.close()


def test_the_second_thread_gives_the_same_commands(bundle, run):
    inline = Run(bundle)
    for _ in range(60):
        picture = frame(inline.step, time_of(inline.step)) if inline.step % 5 == 0 else None
        a, b = inline.tick(picture), run.tick(picture)
        np.testing.assert_array_equal(a.position, b.position)


def test_a_tick_that_fails_costs_one_tick_of_vision(sabotage, run):
    run.ticks(60)
    sabotage.mood, decisions = "fails", []
    for _ in range(10):
        run.ticks(1)
        decisions.append(run.controller.decision)
        sabotage.mood = "well" if len(decisions) == 6 else sabotage.mood
    fallback = [decision for decision in decisions if decision.fallback]
    assert [decision.inferred for decision in fallback] == [True]
    run.ticks(16)
    assert run.whats()[:4] == ["standing_up", "walking", "inference", "op"]
    assert run.whats().count("inference") == 1, "the thread lives"
    assert run.events[2].why == f"{LATE}: this tick runs blind"
    assert run.events[3].why == LATE
    assert run.events[3].time - run.events[2].time <= 0.2
    assert all(run.ticks(150)[-50:]), "vision comes back"
    assert run.controller.decision.mode is Mode.WALKING


def test_a_result_that_is_late_by_a_whole_tick_costs_vision(run):
    """It is there when the next tick begins, but nobody has acted on it."""
    run.ticks(60)
    run.controller._perception.take = lambda: None
    assert not any(run.ticks(40)[10:])
    assert run.controller.decision.mode is Mode.WALKING


def test_a_stuck_vision_thread_leaves_the_robot_walking_on_op(sabotage, run):
    run.ticks(60)
    inference, before = run.controller._perception, run.controller.policy.latent_op.copy()
    inference.patience, sabotage.mood = 0.001, "hangs"
    assert not any(run.ticks(40)[20:])
    assert run.controller.decision.anomaly == np.inf
    assert run.controller.decision.mode is Mode.WALKING
    assert not np.array_equal(before, run.controller.policy.latent_op), "OP's estimator goes on"
    sabotage.released.set()
    until(inference._tick.done)
    run.ticks(1)
    assert not run.controller.decision.inferred, "its tick was made up for"
    inference.patience = 5.0
    assert all(run.ticks(200)[-50:]), "vision comes back"


def test_the_loop_waits_for_less_than_half_a_period(bundle, monkeypatch):
    """With a thread that hangs, `take` gives up while there is time for the rest of the step."""
    waits = []

    def result(tick: Future, timeout: float) -> None:
        waits.append(timeout)
        raise TimeoutError

    monkeypatch.setattr(Future, "result", result)
    inference = ThreadedInference(bundle.sessions)
    inference.begin(None)  # type: ignore[arg-type]
    assert inference.take() is None
    assert len(waits) == 1
    assert 0.0 < waits[0] <= CONTROL_DT / 2
    inference.close()
