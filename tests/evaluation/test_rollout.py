import numpy as np
import pytest

from renet.errors import RenetError
from renet.evaluation.monitor_log import MonitorLog, replay_selector, successful_runs
from renet.evaluation.rollout import Rollout, Trial
from renet.evaluation.trace import Trace
from renet.faults import Injection
from renet.selector import SelectorSpec, make_selector
from renet.selector.selector import MonitorSelector

from .fakes import SPEED, FakeEnv, FakePolicy, fake_rollout

NOISE = (Injection("gaussian", 1.0, onset=20),)
SPEC = SelectorSpec(beta=1.0, thresholds={"disagreement": 0.3, "uniformity": -0.001})


def prepare(rows: list[Trial], env: type[FakeEnv] = FakeEnv) -> Rollout:
    selector = make_selector("switch", SelectorSpec(beta=0.01), len(rows))
    return fake_rollout(env(len(rows)), FakePolicy(len(rows)), rows, memory=selector)


def test_each_mode_uses_the_estimator_it_is_named_after():
    modes, steps = ("camera", "memory", "blind", "oracle"), np.arange(60)
    rollout = prepare([Trial(mode, NOISE) for mode in modes])
    # Seven updates of 5 ms (P_t = 0.9^7 < 0.5): two control steps still run on vision.
    expected = [steps >= 0, steps < 22, steps < 0, steps < 20]
    for run in ("first", "second"):
        np.testing.assert_array_equal(rollout.run(60).vision.T, expected, run)


def test_a_fall_is_latched_and_stops_the_count():
    rollout = prepare([Trial("camera", NOISE), Trial("blind", NOISE)])
    trace = rollout.run(60)
    assert trace.fallen[:, 1].sum() == 0
    first = int(trace.fallen[:, 0].argmax())
    assert first > 20
    assert trace.fallen[first:, 0].all()
    assert (trace.speed[first:, 0] == 0).all()
    np.testing.assert_allclose(trace.speed[:, 1], SPEED)
    # The simulator puts the robot back: the policy must forget its past, only that robot's.
    np.testing.assert_array_equal(rollout.policy.resets[0], [True, False])


def test_a_robot_that_starts_anew_trusts_vision_at_once():
    class Stumbling(FakeEnv):
        def result(self, speed, fell):
            return super().result(speed, fell | (self.clock == 10))

    noise = (Injection("gaussian", 1.0, onset=0),)
    trace = prepare([Trial("memory", noise)], Stumbling).run(15)
    # Two steps until the filter doubts again.
    assert np.flatnonzero(trace.vision[:, 0]).tolist() == [0, 1, 10, 11]


def test_only_renets_images_are_withheld_and_the_papers_mode_obeys_the_papers_rule():
    class Remembering(FakePolicy):
        has_image, map_error = np.ones(3, bool), np.zeros(3)

        def step(self, proprioception, depth, op_mask, gate=None):
            action = super().step(proprioception, depth, op_mask)
            if gate is not None:
                self.has_image = gate.judge({"anomaly_score": self.anomaly_score})
            return np.where(self.has_image[:, None], action, 0.0)  # It remembers.

    rows = [Trial(mode, NOISE) for mode in ("camera", "memory", "switch")]
    spec = SelectorSpec(beta=0.01)
    selector = MonitorSelector({"reconstruction": 0.01}, spec, 3, longest_memory=0.3)
    paper = make_selector("switch", spec, 3)
    rollout = fake_rollout(FakeEnv(3), Remembering(3), rows, memory=selector, switch=paper)
    trace = rollout.run(60)
    steps = np.arange(60)
    np.testing.assert_array_equal(trace.has_image.T, [steps >= 0, steps < 20, steps >= 0])
    # Its image is withheld from step 20 on. After 0.3 s and the filter's 35 ms OP takes over.
    vp, renet, paper = trace.vision.T
    assert vp.all()
    assert np.flatnonzero(~renet)[0] == pytest.approx(20 + (0.3 + 0.035) / 0.02, abs=2)
    np.testing.assert_array_equal(paper, steps < 22)


def test_faults_act_at_ticks_and_hold_between_them_alike_in_every_mode():
    rows = [Trial("blind", NOISE, 0), Trial("oracle", NOISE, 0), Trial("blind", NOISE, 1)]
    fresh, rollout = [], prepare(rows)
    rollout.on_update = lambda seen: fresh.append(seen.fresh.all())
    trace = rollout.run(60, film=[0])
    assert (trace.film.images.shape, trace.film.poses.shape) == ((12, 1, 48, 64), (60, 1, 7))
    assert sum(fresh) == 12
    changed = np.flatnonzero(np.diff(trace.anomaly[:, 0])) + 1
    assert (changed % 5 == 0).all()
    assert changed[0] == 20
    np.testing.assert_array_equal(trace.anomaly[:, 0], trace.anomaly[:, 1])
    assert (trace.anomaly[20:, 0] != trace.anomaly[20:, 2]).any()


def test_wrong_input_is_refused():
    with pytest.raises(RenetError, match="modes op: choose"):
        Trial("op")
    with pytest.raises(RenetError, match="2 trials"):
        fake_rollout(FakeEnv(1), FakePolicy(1), [Trial("camera")] * 2)


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
    rows = [Trial("memory", (Injection(fault, level, 50, duration),)), Trial("memory")]
    selector = make_selector(kind, SPEC, 2)
    rollout = fake_rollout(LiveEnv(2), FakePolicy(2), rows, memory=selector)
    rollout.on_update = log
    return rollout.run(300), log


@pytest.mark.parametrize(
    ("fault", "level", "delay"),
    # Two frames after the first held one; an age of 0.2 s; at once.
    [("frozen", np.inf, 0.135), ("unplugged", np.inf, 0.135), ("blackout", 0.0, 0.035)],
)
def test_monitors_notice_what_the_papers_rule_cannot(fault, level, delay):
    trace, _ = roll("memory", fault, level)
    flat = trace.trusted.reshape(-1, 2)
    assert (~flat[:, 0]).argmax() == pytest.approx((1.0 + delay) * 200 - 1, abs=1.01)
    assert flat[:, 1].all()
    assert replay_selector(make_selector("switch", SPEC, 2), trace.anomaly).all()
    # Back a second after the fault is over, not before.
    back = flat[600:, 0].argmax() / 200
    assert 0.95 <= back <= 1.25


def test_disagreeing_estimators_are_noticed():
    controller = FakePolicy(2)
    controller.velocity_op = np.zeros((2, 3))
    controller.velocity_vp = np.array([[0.4, 0.0, 0.0], [0.2, 0.0, 0.0]])
    selector, trials = make_selector("memory", SPEC, 2), [Trial("memory")] * 2
    trace = fake_rollout(LiveEnv(2), controller, trials, memory=selector).run(10)
    assert trace.trusted[-1, -1].tolist() == [False, True]


def test_the_log_keeps_the_highest_score_of_a_tick():
    _, log = roll("switch", "unplugged", 0.5, duration=0.5)
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


class Retiring(FakeEnv):
    """Remembers who retires; these do not move."""

    def reset(self):
        self.retired = np.zeros(self.num_robots, bool)
        return super().reset()

    def retire(self, mask):
        self.retired = mask.copy()

    def step(self, action):
        before = self.x.copy()
        super().step(action)
        self.x[self.retired] = before[self.retired]
        fell = self.fall(action)
        return self.result(np.full(self.num_robots, SPEED), fell)

    def fall(self, action):
        return (self.clock == np.array([10, 30, 1000, 20])[: self.num_robots]) & ~self.retired


@pytest.mark.parametrize(("until", "length"), [(5, 60), (None, 60)])
def test_robots_retire_when_their_first_try_is_over_and_the_others_walk_on(until, length):
    trials = [Trial("camera", (), robot) for robot in range(4)]
    rollout = prepare(trials, Retiring)
    whole, left = (rollout.run(60, until_ended=until, retire=retire) for retire in (False, True))
    np.testing.assert_array_equal(rollout.env.retired, [True, True, False, True])
    assert len(left.over) == len(whole.over) == length
    np.testing.assert_array_equal(left.over, whole.over)
    for name in ("travelled", "anomaly", "vision"):
        walks = ~whole.over
        np.testing.assert_array_equal(getattr(left, name)[walks], getattr(whole, name)[walks])
    assert left.travelled[-1, 0] < whole.travelled[-1, 0]


@pytest.mark.parametrize(("until", "length"), [(0, 30), (40, 41), (None, 60)])
def test_a_run_is_as_long_as_if_none_had_retired(until, length):
    for retire in (False, True):
        rollout, steps = prepare([Trial("camera"), Trial("camera")], Retiring), []
        trace = rollout.run(60, until_ended=until, retire=retire, on_step=steps.append)
        assert (len(trace.over), len(steps)) == (length, 30 if retire else length)
