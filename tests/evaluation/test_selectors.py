"""Selectors in rollouts: rates, names, and what each of them is blind to."""

import numpy as np
import pytest

from renet.evaluation.evaluator import Evaluator
from renet.evaluation.monitor_log import MonitorLog, replay, successful_runs
from renet.evaluation.rollout import Rollout, Trial
from renet.evaluation.trace import Trace
from renet.faults import Injection
from renet.selector import SelectorSpec, make_selector

from .fakes import FakeEnv, FakePolicy

SPEC = SelectorSpec(beta=1.0, thresholds={"disagreement": 0.3, "uniformity": -0.001})


class LiveEnv(FakeEnv):
    """Its camera has the grain of a live one."""

    def __init__(self, num_robots):
        super().__init__(num_robots)
        self.noise = np.random.default_rng(0)

    def result(self, speed, fell):
        result = super().result(speed, fell)
        result.depth[:] += self.noise.normal(0, 0.02, result.depth.shape).astype(np.float16)
        return result


def roll(kind: str, fault: str, level: float, duration: float = 2.0) -> tuple[Trace, MonitorLog]:
    log = MonitorLog(2)
    rows = [Trial("renet", (Injection(fault, level, 50, duration),)), Trial("renet")]
    rollout = Rollout(LiveEnv(2), FakePolicy(2), make_selector(kind, SPEC, 2), rows, 0)
    rollout.on_update = log
    return rollout.run(300), log


@pytest.mark.parametrize(
    ("fault", "level", "delay"),
    # Two frames after the first held one; an age of 0.2 s; at once.
    [("frozen", np.inf, 0.135), ("unplugged", np.inf, 0.135), ("blackout", 0.0, 0.035)],
)
def test_monitors_notice_what_the_papers_rule_cannot(fault, level, delay):
    trace, _ = roll("monitors", fault, level)
    flat = trace.trusted.reshape(-1, 2)
    assert (~flat[:, 0]).argmax() == pytest.approx((1.0 + delay) * 200 - 1, abs=1.01)
    assert flat[:, 1].all()
    assert replay(make_selector("paper", SPEC, 2), trace.anomaly).all()
    # Back a second after the fault is over, not before.
    back = flat[600:, 0].argmax() / 200
    assert 0.95 <= back <= 1.25


def test_disagreeing_estimators_are_noticed():
    controller = FakePolicy(2)
    controller.velocity_op = np.zeros((2, 3))
    controller.velocity_vp = np.array([[0.4, 0.0, 0.0], [0.2, 0.0, 0.0]])
    selector, trials = make_selector("monitors", SPEC, 2), [Trial("renet")] * 2
    trace = Rollout(LiveEnv(2), controller, selector, trials, 0).run(10)
    assert trace.trusted[-1, -1].tolist() == [False, True]


def test_the_log_keeps_the_highest_score_of_a_tick():
    _, log = roll("paper", "unplugged", 0.5, duration=0.5)
    age = log.scores["frame_age"]
    assert age.shape == (60, 2)
    np.testing.assert_allclose(age[:, 1], 0.095)
    late = [0.095, 0.195, 0.295, 0.395, 0.495, 0.595, 0.095, 0.095]
    np.testing.assert_allclose(age[9:17, 0], late)
    assert log.scores["uniformity"].max() < -0.01


def test_calibration_learns_from_robots_that_get_somewhere():
    trace = Trace.empty(100, 6)
    walk = np.arange(100) * 0.012
    trace.travelled[:, [0, 3]] = walk[:, None]
    trace.travelled[:, 1] = 0.1
    trace.travelled[:, 2] = np.concatenate([walk[:50], walk[:50]])
    trace.ended[[49, 99], 2] = trace.fell[99, 2] = trace.ended[99, 3] = trace.fell[99, 3] = True
    # Robot 4 falls at step 7 and stands at the end; robot 5 leaves its tile at 12 and falls later.
    trace.ended[7, 4] = trace.fell[7, 4] = True
    trace.ended[[12, 99], 5] = trace.fell[99, 5] = True
    walked = [(0, slice(0, 20)), (2, slice(0, 10))]
    assert successful_runs(trace, 0.6) == walked
    stood = [(1, slice(0, 20)), (4, slice(2, 20)), (5, slice(0, 3))]
    assert successful_runs(trace) == sorted(walked + stood)


def test_the_shipped_selector_walks_on_vision_through_sparse_grass_alone():
    evaluator, severities = Evaluator(), (1, 2, 4, 5)
    grass = {s: (Injection.of("tall_grass", s, onset=20),) for s in severities}
    trials = [Trial("renet", grass[s], robot) for s in severities for robot in range(5)]
    env = evaluator.make_env("flat", [trial.robot for trial in trials], 0.6, 1)
    sees = evaluator.rollout(env, trials, 1).run(120).sees.all(axis=(0, 1)).reshape(4, 5)
    assert sees[:2].sum() >= 9
    assert not sees[2:].any()
