"""The controller against the training side, lost cameras, and inputs nobody should give it."""

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import groupby
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import torch

from renet.bundle import Bundle, pretrained, write_bundle
from renet.deploy.cameras.base import DepthFrame
from renet.deploy.cameras.buffer import FrameBuffer
from renet.deploy.cameras.faulty import FaultyCamera
from renet.deploy.cameras.sim import SimCamera
from renet.deploy.controller import A_WHILE, Controller, Event
from renet.deploy.observation import observe
from renet.deploy.robots.base import heading
from renet.deploy.safety.limits import SafetyCfg, rate_after
from renet.deploy.safety.machine import Mode, stand_up_target
from renet.deploy.steering import FORWARD_ONLY
from renet.deploy.teleop.base import TeleopCommand
from renet.faults import parse_fault
from renet.interface import (
    CONTROL_DT,
    HEADING_PROPRIOCEPTION,
    PROPRIOCEPTION,
    proprioception_slices,
)
from renet.models.adaptation import fuse
from renet.models.config import ModelCfg
from renet.models.memory import EstimatorMemory
from renet.models.renet import RENet
from renet.training import checkpoint as checkpoints
from renet.training.export import ExportCfg, export, export_models, load_networks

from .fakes import (
    ARM,
    GO,
    STANDING,
    WALKS_AT,
    Broken,
    Run,
    frame,
    live,
    robot_on,
    state,
    time_of,
    turned,
)

CHECKPOINT = pretrained("checkpoint")
SECONDS = 20.0
FAULTS = ("blackout@2s+2s", "frozen:3@9s", "salt_and_pepper:2@14s+1s")


@pytest.fixture(scope="module")
def judging(tmp_path_factory, bundle) -> Bundle:
    """Untrained networks that also predict what their errors are."""
    torch.manual_seed(0)
    networks = RENet(ModelCfg(detector="variance", predict_map_error=True), critic_size=10).eval()
    path = tmp_path_factory.mktemp("judging") / "bundle"
    return Bundle.load(write_bundle(path, export_models(networks), bundle.manifest))


def with_selector(bundle: Bundle, **changes) -> Bundle:
    spec = replace(bundle.manifest.selector, **changes)
    return replace(bundle, manifest=replace(bundle.manifest, selector=spec))


def test_all_models_have_run_before_it_walks(bundle):
    """The first run of a model is many times slower than all others."""
    sessions = {name: Mock(wraps=session) for name, session in bundle.sessions.items()}
    Controller(replace(bundle, sessions=sessions))
    assert {session.run.call_count for session in sessions.values()} == {1}


def test_it_rises_and_then_walks(run):
    assert not run.controller.decision.command.stiffness.any()
    crouched = STANDING + 0.3
    run.ticks(WALKS_AT // 2, lambda frame: None, joint_position=crouched)
    share = (time_of(run.step - 1) - time_of(1)) / run.controller.cfg.stand_up_seconds
    target = stand_up_target(crouched, run.controller.robot, share)
    np.testing.assert_allclose(run.controller.decision.command.position, target, atol=1e-6)
    run.ticks(WALKS_AT - run.step, lambda frame: None, joint_position=crouched)
    decision = run.controller.decision
    assert decision.mode is Mode.STANDING_UP
    assert not decision.action.any()
    assert not any((decision.vision, decision.inferred, decision.fallback))
    run.tick(frame(run.step, time_of(run.step)), joint_position=crouched)
    begun = [(time_of(1), "standing_up", "armed"), (time_of(WALKS_AT), "walking", "stood up")]
    assert run.events == [Event(*words) for words in begun]
    assert run.controller.decision.mode is Mode.WALKING
    assert run.controller.decision.action.any()


def test_it_rises_from_where_it_lies_and_not_from_where_it_shall_stand(run):
    """Its first target is its own pose, however far that is from the default one."""
    folded = STANDING + np.tile([0.0, 0.5, -0.9], 4)
    run.ticks(2, lambda frame: None, joint_position=folded)
    decision = run.controller.decision
    assert decision.mode is Mode.STANDING_UP
    np.testing.assert_allclose(decision.command.position, folded, atol=1e-3)


def test_a_walk_begins_with_targets_that_move_slowly(run):
    """However far away the policy wants its legs at once."""
    run.ticks(WALKS_AT)
    run.controller.policy.joint_target = lambda action: np.full((1, 12), 9.0)
    steps = [run.tick().position for _ in range(60)]
    change = np.abs(np.diff(steps, axis=0)).max(axis=1) / CONTROL_DT
    cfg = run.controller.cfg
    assert (change <= [rate_after(time_of(n + 1), cfg) + 1e-6 for n in range(59)]).all()
    assert change.max() > 12.0


def test_motors_that_obey_nobody_and_a_robot_that_falls_as_it_stands_do_not_walk(bundle):
    limp, falls = Run(bundle), Run(bundle)
    lying = STANDING + np.tile([0.0, 0.8, -0.6], 4)
    limp.ticks(WALKS_AT + 1, lambda frame: None, joint_position=lying)
    falls.ticks(WALKS_AT - 2)
    falls.ticks(3, quaternion=turned("x", 90))
    for run, why in ((limp, "did not follow"), (falls, "tilted")):
        assert run.whats() == ["standing_up", "damping"]
        assert why in run.events[1].why
        assert not run.controller.decision.command.stiffness.any()


def test_a_refused_wish_to_rise_says_why(run):
    run.controller.tick(None, None, ARM, time_of(-1))
    run.ticks(5, lambda frame: None, quaternion=turned("x", 180))
    reasons = {-1: "no state from the robot", 1: "tilted by more than 80 degrees"}
    assert run.events == [Event(time_of(step), "refused", why) for step, why in reasons.items()]


def test_an_action_that_is_no_number_and_a_listener_that_fails(bundle, walk):
    """The first brakes, and is told; the second changes nothing."""
    walk.controller.policy._act = lambda *inputs: np.full((1, 12), np.nan)
    assert not walk.tick().stiffness.any()
    why = "RenetError: the policy's action is not finite"
    assert walk.events[-1] == Event(time_of(60), "damping", why)
    deaf = Run(bundle)
    deaf.controller._on_event = None
    assert all(deaf.ticks(30)[WALKS_AT:])


class Overflowing:
    """An estimator's session, one of whose outputs is no number while it is told so."""

    def __init__(self, session: Any, output: str) -> None:
        self._session, self._output, self.value = session, output, None

    def get_inputs(self):
        return self._session.get_inputs()

    def get_outputs(self):
        return self._session.get_outputs()

    def run(self, names, feed):
        found = self._session.run(names, feed)
        if self.value is not None:
            place = list(names).index(self._output)
            found[place] = np.full_like(found[place], self.value)
        return found


def overflowing(bundle: Bundle, output: str) -> tuple[Run, Overflowing]:
    """A robot that walks and sees, and its estimator."""
    estimator = Overflowing(bundle.sessions["estimator"], output)
    run = Run(replace(bundle, sessions={**bundle.sessions, "estimator": estimator}))
    assert all(run.ticks(60)[WALKS_AT:])
    return run, estimator


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e30])
def test_a_tick_in_which_vp_finds_no_numbers_leaves_op_driving(bundle, value):
    run, estimator = overflowing(bundle, "next_latent_vp")
    estimator.value = value
    assert not run.ticks(5)[-1]
    estimator.value = None
    assert not any(run.ticks(40)), "it is not trusted again at once"
    assert all(run.ticks(250)[-10:])
    assert run.controller.decision.mode is Mode.WALKING
    assert np.isfinite(run.controller.decision.latent).all()
    whys = [event.why for event in run.events[2:]]
    assert whys == ["what the VP estimator found is not finite", "vision is healthy"]


def test_a_tick_in_which_op_finds_none_brakes(bundle):
    """Even while VP drives: nothing would be left to fall back to."""
    run, estimator = overflowing(bundle, "next_latent_op")
    estimator.value = np.nan
    run.ticks(5)
    assert run.controller.decision.mode is Mode.DAMPING
    assert "what the OP estimator found is not finite" in run.events[-1].why


def test_the_shipped_checkpoint_acts_alike_in_torch_and_on_the_robot(tmp_path):
    """20 s of closed loop with faults: the robot obeys the bundle, torch shadows it."""
    path = export(ExportCfg(checkpoint=CHECKPOINT, out=tmp_path / "bundle"))
    bundle = with_selector(Bundle.load(path), longest_memory=1.0)
    networks = load_networks(checkpoints.find(CHECKPOINT))
    memory = EstimatorMemory(networks.cfg, 1, "cpu")
    robot = robot_on()
    source = SimCamera(robot, bundle.manifest.camera, seed=2)
    camera = FaultyCamera(source, [parse_fault(text) for text in FAULTS], robot.now, seed=2)
    controller = Controller(bundle, SafetyCfg(stand_up_seconds=0.5))
    camera.start()
    last, yaw, states, walked = np.zeros(12), None, [], 0
    for step in range(round((SECONDS + 1.0) / CONTROL_DT)):
        state, now = robot.read(), robot.now()
        shown = camera.latest()
        robot.write(controller.tick(state, shown, TeleopCommand(forward=0.6, arm=step == 1), now))
        robot.wait(now + CONTROL_DT)
        decision = controller.decision
        if decision.mode is not Mode.WALKING:
            assert walked == 0, controller.machine.reason
            continue
        yaw = heading(state.quaternion) if yaw is None else yaw
        error = yaw - heading(state.quaternion)
        told = 0.6, math.sin(error), math.cos(error)
        observation = observe(state, controller.robot, told, last)[None]
        memory.push(torch.tensor(observation))
        if walked % 5 == 0:
            image = torch.tensor(shown.image[None]).half()
            memory.see(image, torch.tensor([decision.has_image]))
            memory.tick(networks.advance)
        with torch.no_grad():
            latent = fuse(memory.latent_op, memory.latent_vp, torch.tensor([not decision.vision]))
            action = networks.actor(torch.tensor(observation), latent)[0].numpy()
        clip = controller.robot.action_clip
        drove = memory.latent_vp if decision.vision else memory.latent_op
        np.testing.assert_allclose(decision.latent, drove[0], atol=1e-4)
        assert decision.inferred == (walked % 5 == 0)
        assert not decision.fallback
        assert decision.frame_age == pytest.approx(now - shown.time)
        np.testing.assert_allclose(decision.action, action.clip(-clip, clip), atol=1e-4)
        last, walked = decision.action, walked + 1
        states.append((decision.vision, decision.vision and decision.has_image))
    assert walked >= SECONDS / CONTROL_DT
    sees, remembers, blind = (True, True), (True, False), (False, False)
    phases = [state for state, _ in groupby(states)]
    assert phases[:4] == [sees, remembers, blind, sees]
    assert len(phases) >= 6


def test_a_lost_camera_costs_vision_within_its_age_limit_and_returns_after_the_dwell(run):
    assert all(run.ticks(60)[WALKS_AT:])
    last = frame(run.step, time_of(run.step))
    gone = run.ticks(30, lambda frame: last)
    assert not any(gone[13:]), "0.2 s of age, 35 ms of filter"
    assert run.events[-1].why == "no new image"
    back = run.ticks(150)
    assert not any(back[:45])
    assert all(back[-50:])
    assert (run.events[-1].what, run.events[-1].why) == ("sees", "vision is healthy")


@pytest.mark.parametrize(("unseen", "told"), [("walk", 0.6), ("stop", 0.0)])
def test_the_end_of_seen_ground_is_told_once(judging, unseen, told):
    run = Run(with_selector(judging, longest_memory=10.0), unseen=unseen)
    asked = []
    step = run.controller.policy.step

    def walks(observation, *args):
        asked.append(float(observation[0, 6]))
        action = step(observation, *args)
        run.controller.policy.velocity_vp = np.array([[0.6, 0.0, 0.0]], np.float32)
        run.controller.policy.height_map = np.zeros_like(run.controller.policy.height_map)
        return action

    run.controller.policy.step = walks
    run.ticks(60)
    assert asked[-1] == pytest.approx(0.6)
    last = frame(run.step, time_of(run.step))
    run.ticks(120, lambda frame: last)
    events = [event.why for event in run.events if event.what == "unseen"]
    conduct = {"walk": "it walks on", "stop": "it stops"}[unseen]
    assert events == [f"the ground that it saw ends half a metre ahead: {conduct}"]
    assert asked[-1] == pytest.approx(told)
    decision = run.controller.decision
    assert decision.told[0] == pytest.approx(told)
    assert decision.followed.forward == pytest.approx(told)
    assert decision.asked.forward == 0.6, "the operator's wish stays"


def test_a_robot_that_has_seen_nothing_says_so(judging):
    run = Run(with_selector(judging, longest_memory=10.0), unseen="stop")
    run.ticks(60, lambda frame: replace(frame, image=np.zeros_like(frame.image)))
    events = [event.why for event in run.events if event.what == "unseen"]
    assert events == ["it has seen no ground yet: it stops"]
    assert run.controller.decision.followed.forward == 0.0


@pytest.mark.parametrize(
    ("thresholds", "change", "reason"),
    [
        ({}, {"invalid": 0.3}, "too many pixels without depth"),
        ({}, {"image": frame(0, 0.0).image}, "the image is frozen"),
        ({}, {"image": np.full((48, 64), 0.5)}, "the image is blank"),
        ({"disagreement": 1e-6}, {}, "the estimators disagree on velocity"),
        ({"reconstruction": 1e-9}, {}, "images unlike those of training"),
        ({"variance": 1e-9}, {}, "images unlike those of training"),
        ({"map_error": 1e-9}, {}, "the memory of the ground is stale"),
    ],
)
def test_every_monitor_is_told_what_it_judges(judging, thresholds, change, reason):
    run = Run(with_selector(judging, thresholds=thresholds))
    run.ticks(WALKS_AT + 20, lambda frame: replace(frame, **change))
    assert [event.why for event in run.events if event.what == "blind"] == [reason]


def test_it_goes_on_from_memory_and_then_without(judging):
    """Both are told, but not that one image is late; what is recorded is what the models said."""
    run = Run(with_selector(judging, longest_memory=1.0))
    run.ticks(60)
    last = frame(run.step - 5, time_of(run.step - 5))
    run.ticks(5, lambda frame: last)
    run.ticks(20)
    assert run.whats() == ["standing_up", "walking"]
    good = frame(run.step - 5, time_of(run.step - 5))
    seen = run.ticks(40, lambda frame: good)
    decision, policy = run.controller.decision, run.controller.policy
    assert (all(seen), decision.has_image, decision.probability) == (True, False, 1.0)
    for name in ("anomaly_score", "variance_score", "map_error", "velocity_op", "velocity_vp"):
        value = getattr(policy, name)[0]
        assert np.abs(value).max() > 0
        np.testing.assert_array_equal(getattr(decision, name.removesuffix("_score")), value)
    assert not any(run.ticks(40, lambda frame: good)[25:])
    assert run.controller.decision.probability < 0.5
    assert all(run.ticks(300)[-10:])
    assert run.controller.decision.has_image
    told = [
        ("remembers", "no new image"),
        ("blind", "no new image for 1 s, as long as it remembers"),
        ("sees", "vision is healthy"),
    ]
    assert [(event.what, event.why) for event in run.events[2:]] == told
    passed = [event.time - good.time for event in run.events[2:4]]
    assert passed == pytest.approx([A_WHILE + 0.1, 1.1], abs=0.08), "the last tick lasts 0.1 s"


@pytest.mark.parametrize(
    "bad",
    [
        {"image": np.full((48, 64), np.nan)},
        {"image": np.zeros((64, 48))},
        {"image": np.full((48, 64), 700.0)},
        {"image": "black"},
        {"time": math.nan},
        {"time": 1e9},
        {"invalid": 2.0},
        {"number": None},
        np.zeros((48, 64)),
        Broken(),
    ],
)
def test_a_malformed_frame_costs_vision_and_nothing_else(walk, bad):
    walk.ticks(10, lambda good: replace(good, **bad) if isinstance(bad, dict) else bad)
    assert not walk.controller.decision.vision
    assert walk.events[-1].what == "blind"
    assert "depth" in walk.events[-1].why
    assert walk.controller.decision.mode is Mode.WALKING


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"joint_position": np.full(12, np.nan)}, "joint_position is not finite"),
        ({"quaternion": turned("x", 180)}, "tilted"),
        ({"time": -5.0}, "the state is"),
    ],
)
def test_a_bad_reading_damps_and_arming_brings_it_back(walk, changes, reason):
    assert all(walk.tick(**changes).stiffness.any() for _ in range(2)), "one may be odd"
    assert not walk.tick(**changes).stiffness.any()
    decision = walk.controller.decision
    assert decision.mode == walk.events[-1].what == "damping"
    assert reason in walk.events[-1].why
    assert not any(map(np.any, (decision.action, decision.latent, decision.vision)))
    walk.ticks(20)
    assert walk.controller.decision.mode is Mode.DAMPING
    walk.tick(teleop=ARM)
    walk.ticks(10)
    assert walk.controller.decision.mode is Mode.WALKING


@pytest.fixture
def telling(bundle) -> Callable[[str], Run]:
    """Robots that walk and are told where to go in one of the two forms."""

    def walk(told: str) -> Run:
        terms = PROPRIOCEPTION if told == "twist" else HEADING_PROPRIOCEPTION
        manifest = replace(bundle.manifest, proprioception=terms)
        run = Run(replace(bundle, manifest=manifest))
        run.ticks(WALKS_AT + 1, lambda frame: None)
        return run

    return walk


def told(run: Run) -> np.ndarray:
    """What the policy observed of the command; its scales are 1."""
    observed = run.controller.policy._history[0, -1][proprioception_slices()["command"]]
    np.testing.assert_allclose(run.controller.decision.told, observed, atol=1e-6)
    return observed


def test_a_policy_is_told_a_speed_and_the_angle_to_a_heading(telling):
    run = telling("heading")
    for _ in range(25):
        run.tick(teleop=TeleopCommand(0.4, 0.0, 0.8))
    angle = 25 * CONTROL_DT * 0.8
    np.testing.assert_allclose(told(run), [0.4, math.sin(angle), math.cos(angle)], atol=1e-5)
    assert [event.what for event in run.events].count("refused") == 0


def test_or_the_velocity_itself(telling):
    run = telling("twist")
    run.tick(teleop=TeleopCommand(-0.5, 0.3, -0.7))
    np.testing.assert_allclose(told(run), [-0.5, 0.3, -0.7], atol=1e-6)
    run.tick(teleop=TeleopCommand(-9.0, -9.0, 9.0))
    np.testing.assert_allclose(told(run), [-0.6, -0.5, 1.0], atol=1e-6)
    assert run.controller.decision.asked == (-0.6, -0.5, 1.0)
    assert [event.what for event in run.events].count("refused") == 0


def test_backward_and_sideways_are_refused_once_a_walk(telling):
    run = telling("heading")
    for velocity in ((-0.5,), (0.6,), (0.0, 0.2), (0.6, -0.2)) * 3:
        run.tick(teleop=TeleopCommand(*velocity))
        assert told(run)[0] == pytest.approx(max(velocity[0], 0.0))
    refused = [event for event in run.events if event.what == "refused"]
    assert refused == [Event(time_of(WALKS_AT + 1), "refused", FORWARD_ONLY)]
    run.tick(teleop=TeleopCommand(stop=True))
    run.tick(teleop=ARM)
    run.ticks(10, lambda frame: None, teleop=TeleopCommand(-0.5))
    assert [event.why for event in run.events].count(FORWARD_ONLY) == 2


def test_one_reading_from_the_future_is_forgotten(run):
    run.tick(time=1e9)
    run.ticks(30)
    assert run.whats() == ["standing_up", "walking"]


def test_a_sensor_that_froze_is_noticed_when_each_reading_is_read_twice(walk):
    for step in range(walk.step, walk.step + 16):
        walk.controller.tick(state(0.04 * (step // 2)), None, GO, time_of(step))
    assert "frozen" in walk.events[-1].why


def repeating(period: int) -> Callable[[DepthFrame], DepthFrame]:
    images = [frame(number, 0.0, seed=period).image for number in range(period)]
    return lambda frame: replace(frame, image=images[frame.number // 5 % period])


def test_images_that_come_again_are_no_images(walk):
    """Two that alternate for ever, and a second that repeats; one held for two ticks is news."""
    for period in (2, 9):
        assert all(walk.ticks(400)[-20:]), "vision is back"
        seen = walk.ticks(60 + 5 * period, repeating(period))
        assert all(seen[: 5 * period]), "each is new once"
        assert not any(seen[-20:])
        assert "came again" in walk.events[-1].why


def test_blank_images_may_come_again():
    """Nothing within reach is the same image each time; a monitor judges it."""
    buffer = FrameBuffer()
    for step in range(20):
        image = np.ones((48, 64)) if step % 2 else frame(step, 0.0).image
        buffer.offer(DepthFrame(image, step, 0.1 * step), 0.1 * step)
        assert buffer.problem == ""
        assert buffer.take(0.1 * step).fresh[0]


def hostile(random: np.random.Generator, now: float) -> dict[str, Any]:
    """Inputs of a tick, of which about a third are spoilt."""

    def one_of(*values):
        return values[random.integers(len(values))]

    def spoilt(value):
        size = np.size(value)
        noise, letters = random.normal(size=size), np.array(["a"] * size)
        numbers = [np.full(size, np.nan), np.full(size, np.inf), 1e30 * noise, 10.0 * noise]
        shapes = [np.zeros(0), np.zeros((3, 5)), np.zeros(100_000), [[1.0], [2.0, 3.0]]]
        return one_of(*numbers, *shapes, None, "?", letters)

    reading = live(now, joint_position=STANDING + 0.08 * random.normal(size=12))
    picture = frame(int(random.integers(1000)), now)
    name = one_of(*list(vars(reading))[1:])
    when = one_of(now - 1, now + 1, math.nan, -math.inf, None, "x")
    mark = one_of({"time": math.inf}, {"number": "x"}, {"invalid": math.nan})
    large = {"forward": 1e300, "left": 1e300, "turn_rate": -1e300}
    wish = one_of({"forward": math.nan}, {"turn_rate": math.inf}, large)
    wrong = one_of(
        {"state": replace(reading, **{name: spoilt(getattr(reading, name))})},
        {"state": one_of(None, 7, replace(reading, time=when))},
        {"frame": replace(picture, image=spoilt(picture.image))},
        {"frame": one_of(None, 5, "frame", replace(picture, **mark))},
        {"teleop": one_of(None, TeleopCommand(**wish))},
    )
    healthy = {"state": reading, "frame": picture, "teleop": GO}
    return healthy | (wrong if random.random() < 0.36 else {})


def test_10_000_hostile_inputs_never_raise_and_never_leave_the_limits(bundle):
    random, now, walked = np.random.default_rng(0), 0.0, 0
    controller = Controller(bundle, SafetyCfg(stand_up_seconds=0.02, least_torque=0.0))
    robot = controller.robot
    for _ in range(10_000):
        jump = random.random()
        now += 0.02 if jump < 0.99 else random.choice([0.0, -0.05, 0.3, 5.0])
        inputs = hostile(random, now)
        if controller.decision.mode is Mode.DAMPING and inputs["teleop"] is GO:
            inputs["teleop"] = TeleopCommand(forward=0.5, arm=bool(random.random() < 0.5))
        command = controller.tick(**inputs, now=math.nan if random.random() < 0.002 else now)
        assert np.isfinite(command.position).all()
        assert ((command.position >= robot.lower) & (command.position <= robot.upper)).all()
        assert ((command.stiffness >= 0) & (command.stiffness <= robot.stiffness)).all()
        assert ((command.damping >= 0) & (command.damping <= 3.0)).all()
        if controller.decision.mode is Mode.DAMPING:
            assert (command.stiffness == 0).all()
        else:
            newest = controller._watch.newest
            torque = command.stiffness * (command.position - newest.joint_position)
            torque -= command.damping * newest.joint_velocity
            assert (np.abs(torque) <= np.array(robot.torque_limit) + 1e-6).all()
            walked += controller.decision.mode is Mode.WALKING
    assert walked > 500, "the abuse must reach the walking controller"
