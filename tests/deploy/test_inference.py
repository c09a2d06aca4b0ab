"""Ticks on a second thread: the same commands, and a thread that dies, hangs or is late."""

import threading
from collections.abc import Callable
from queue import Empty, SimpleQueue

import numpy as np
import pytest

from renet.deploy.controller import LATE
from renet.deploy.inference import Sessions, ThreadedInference
from renet.deploy.safety.machine import Mode
from renet.interface import CONTROL_DT

from .fakes import Run, frame, time_of


class Sabotage:
    """A session that fails or hangs off the main thread, on demand."""

    def __init__(self, session) -> None:
        self.session, self.mood = session, "well"
        self.released = threading.Event()
        self.get_inputs, self.get_outputs = session.get_inputs, session.get_outputs

    def run(self, *arguments):
        if threading.current_thread() is not threading.main_thread():
            if self.mood == "dies":
                raise MemoryError
            if self.mood == "hangs":
                self.released.wait(30)
        return self.session.run(*arguments)


@pytest.fixture
def sabotage(bundle) -> Sabotage:
    return Sabotage(bundle.sessions["estimator"])


def threaded(sabotage: Sabotage) -> Callable[[Sessions], ThreadedInference]:
    """Makes a thread that runs a spoilt estimator."""
    return lambda sessions: ThreadedInference({**sessions, "estimator": sabotage}, patience=5.0)  # type: ignore[dict-item]


def troubled(bundle, sabotage, mood: str, patience: float) -> Run:
    """A robot that walks, and whose vision thread is in that mood from now on."""
    run = Run(bundle, inference=threaded(sabotage))
    run.ticks(60)
    run.controller._perception._patience = patience  # type: ignore[attr-defined]
    sabotage.mood = mood
    return run


def test_the_second_thread_gives_the_same_commands(bundle, sabotage):
    inline = Run(bundle)
    thread = Run(bundle, inference=threaded(sabotage))
    for _ in range(60):
        picture = frame(inline.step, time_of(inline.step)) if inline.step % 5 == 0 else None
        a, b = inline.tick(picture), thread.tick(picture)
        np.testing.assert_array_equal(a.position, b.position)
    thread.controller.close()


def test_a_dead_vision_thread_is_replaced_and_costs_one_tick_of_vision(bundle, sabotage):
    run = troubled(bundle, sabotage, "dies", patience=0.05)
    run.ticks(6)
    sabotage.mood = "well"
    run.ticks(20)
    assert run.whats()[:4] == ["standing_up", "walking", "inference", "op"]
    assert run.events[3].why == LATE
    assert run.events[3].time - run.events[2].time <= 0.2
    run.controller._perception._patience = 5.0  # type: ignore[attr-defined]
    assert all(run.ticks(150)[-50:]), "vision comes back"
    assert run.controller.decision.mode is Mode.WALKING
    run.controller.close()


def test_a_result_that_is_late_by_a_whole_tick_costs_vision(bundle, sabotage):
    """It is there when the next tick begins, but nobody has acted on it."""
    run = Run(bundle, inference=threaded(sabotage))
    run.ticks(60)
    inference = run.controller._perception
    inference.take = lambda: None  # type: ignore[method-assign]
    assert not any(run.ticks(40)[10:])
    assert run.controller.decision.mode is Mode.WALKING
    run.controller.close()


def test_a_stuck_vision_thread_leaves_the_robot_walking_on_op(bundle, sabotage):
    run = troubled(bundle, sabotage, "hangs", patience=0.001)
    before = run.controller.policy.latent_op.copy()
    assert not any(run.ticks(40)[20:])
    assert run.controller.decision.mode is Mode.WALKING
    assert not np.array_equal(before, run.controller.policy.latent_op), "OP's estimator goes on"
    sabotage.released.set()
    run.controller._perception._patience = 5.0  # type: ignore[attr-defined]
    assert all(run.ticks(200)[-50:]), "vision comes back"
    run.controller.close()


def test_the_loop_waits_for_less_than_half_a_period(bundle):
    """With a thread that hangs, `take` gives up while there is time for the rest of the step."""
    waits = []

    class Results:
        def get(self, timeout: float):
            waits.append(timeout)
            raise Empty

        get_nowait = None

    inference = ThreadedInference(bundle.sessions)
    inference._jobs = SimpleQueue()  # Nobody reads it: the thread hangs.
    inference.begin(None)  # type: ignore[arg-type]
    inference._results = Results()  # type: ignore[assignment]
    assert inference.take() is None
    assert len(waits) == 1
    assert 0.0 < waits[0] <= CONTROL_DT / 2
