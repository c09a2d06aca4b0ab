"""The deployed policy equals the networks it was exported from, and refuses bad input.

`data/images.npz` are six images of a robot walking on flat ground and the same with glare of
severity 1.
"""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from renet.bundle import Bundle, write_bundle
from renet.errors import RenetError
from renet.models.adaptation import fuse
from renet.models.config import ModelCfg
from renet.models.expectation import Evidence, Recollection, mean_blocks
from renet.models.memory import EstimatorMemory
from renet.models.renet import RENet
from renet.pilot.policy import BundlePolicy
from renet.selector import SelectorSpec, make_selector
from renet.selector.monitors import Gate
from renet.training.export import export_models
from tests.selector.inputs import seen


@pytest.fixture
def policy(bundle_path) -> BundlePolicy:
    return BundlePolicy(Bundle.load(bundle_path), num_robots=3)


@pytest.mark.parametrize("share", [1.0, 0.6])
def test_equals_the_training_side_over_20_seconds_with_switching_and_resets(
    policy, networks, share
):
    """VP gets a share of the images, and its state is that of training, whatever others show."""
    random = np.random.default_rng(0)
    memory = EstimatorMemory(networks.cfg, 3, "cpu")
    for step in range(1000):
        observation = random.normal(size=(3, 45)).astype(np.float32)
        tick = step % 5 == 0
        if tick:
            has_image = random.random(3) < share
            image, other = random.random((2, 3, 48, 64)).astype(np.float16)
            shown = np.where(has_image[:, None, None], image, other).astype(np.float32)
        use_op = random.random(3) < 0.3
        action = policy.step(observation, shown, use_op, Gate(has_image, {}) if share < 1 else None)
        memory.push(torch.tensor(observation))
        if tick:
            memory.see(torch.tensor(image), *([torch.tensor(has_image)] if share < 1 else []))
            memory.tick(networks.advance)
            np.testing.assert_array_equal(policy.has_image, has_image)
            np.testing.assert_allclose(policy.latent_vp, memory.latent_vp, atol=1e-4)
        with torch.no_grad():
            latent = fuse(memory.latent_op, memory.latent_vp, torch.tensor(use_op))
            expected = networks.actor(torch.tensor(observation), latent)
        np.testing.assert_allclose(action, expected.clamp(-4.8, 4.8), atol=1e-4)
        done = random.random(3) < 0.01
        policy.reset(done)
        memory.reset(torch.tensor(done))


def test_a_gate_withholds_what_the_vision_model_objects_to_but_only_from_whom_it_binds(policy):
    anything, images = np.zeros((3, 45)), np.random.default_rng(0).random((3, 48, 64))
    policy.step(anything, images, np.zeros(3, bool))
    limits = np.sort(policy.anomaly_score)
    gate = Gate(np.ones(3, bool), {"anomaly_score": float(limits[1])})
    for robots, has_image in ((True, policy.anomaly_score < limits[1]), (False, np.full(3, True))):
        policy.reset()
        policy.step(anything, images, np.zeros(3, bool), replace(gate, robots=np.full(3, robots)))
        np.testing.assert_array_equal(policy.has_image, has_image)


def test_walks_on_without_a_camera(policy):
    assert np.isfinite(policy.step(np.zeros((3, 45)), None, np.zeros(3, bool))).all()
    assert np.isinf([policy.anomaly_score, policy.variance_score]).all()


@pytest.mark.parametrize(
    ("observation", "image", "message"),
    [
        (np.zeros((3, 44)), np.zeros((3, 48, 64)), r"proprioception has shape \(3, 44\)"),
        (np.zeros((3, 45)), np.zeros((3, 64, 48)), r"depth image has shape \(3, 64, 48\)"),
        (np.full((3, 45), np.nan), np.zeros((3, 48, 64)), "proprioception contains NaN"),
        (np.zeros((3, 45)), np.full((3, 48, 64), np.inf), "depth image contains NaN or inf"),
        (np.zeros((3, 45)), np.full((3, 48, 64), 850, np.uint16), r"in \[0, 1\], not 850 to 850"),
        (np.zeros((3, 45)), np.full((3, 48, 64), -0.1), r"in \[0, 1\], not -0.1"),
    ],
)
def test_bad_input_is_refused_and_nothing_is_remembered(policy, observation, image, message):
    before = policy._history.copy()
    with pytest.raises(RenetError, match=message):
        policy.step(observation, image, np.zeros(3, bool))
    np.testing.assert_array_equal(policy._history, before)
    assert policy._blank.all()


def test_a_strangers_output_replaces_nothing_of_the_policy(bundle):
    class Vision:
        def get_outputs(self):
            return [SimpleNamespace(name=name) for name in ("anomaly_score", "manifest")]

        def run(self, names, feed):
            return [np.zeros(1, np.float32) for _ in names]

    policy = BundlePolicy(replace(bundle, sessions=bundle.sessions | {"vision": Vision()}))
    policy.step(np.zeros((1, 45)), np.zeros((1, 48, 64)), np.zeros(1, bool))
    assert policy.manifest is bundle.manifest


def trusted(bundle: Bundle, kind: str, images: str) -> bool:
    """Whether vision is used after six images."""
    spec = replace(bundle.manifest.selector, longest_memory=0.0)  # Its monitors alone decide.
    policy, selector = BundlePolicy(bundle), make_selector(kind, spec)
    blind, proprioception = np.zeros(1, bool), np.zeros((1, 45))
    recorded = np.load(Path(__file__).with_name("data") / "images.npz")[images]
    for tick, image in enumerate(recorded.astype(np.float32)):
        for _ in range(5):
            policy.step(proprioception, image[None], blind)
        scores = {name: getattr(policy, name) for name in ("anomaly_score", "variance_score")}
        vision = selector.update(seen(robots=1, image=image[None], **scores), 0.1 * tick)
    return bool(vision[0])


def test_it_leaves_on_glare_that_the_papers_rule_misses():
    shipped = Bundle.load()
    assert trusted(shipped, "memory", "healthy")
    assert not trusted(shipped, "memory", "glare")
    assert trusted(shipped, "switch", "glare")


@pytest.mark.parametrize(
    ("monitor", "output"),
    [("variance", "variance_score"), ("surprise", "surprise"), ("stillness", "stillness")],
)
def test_a_threshold_without_the_output_it_judges_is_refused(
    models, manifest, tmp_path, monitor, output
):
    spec = SelectorSpec(beta=0.01, thresholds={monitor: 0.5})
    path = write_bundle(tmp_path / "blind", models, replace(manifest, selector=spec))
    with pytest.raises(RenetError, match=f"has no {output}: run `renet calibrate`"):
        Bundle.load(path)


@pytest.mark.parametrize("threads", [1, 2])
def test_the_others_act_alike_when_some_retire_until_all_are_reset(bundle_path, threads):
    bundle = Bundle.load(bundle_path, threads)
    whole, left = (BundlePolicy(bundle, num_robots=5) for _ in range(2))
    random = np.random.default_rng(0)
    gone = np.zeros(5, bool)
    for step in range(40):
        if step in (7, 20):
            gone[step % 5] = True
            left.retire(gone.copy())
            before = left.latent_vp[gone]
        observation = random.normal(size=(5, 45)).astype(np.float32)
        image = random.random((5, 48, 64)).astype(np.float32)
        gate = Gate(random.random(5) < 0.6, {"anomaly_score": 1.0}, random.random(5) < 0.5)
        arguments = observation, image, random.random(5) < 0.3, gate
        expected, action = whole.step(*arguments), left.step(*arguments)
        np.testing.assert_array_equal(action[~gone], expected[~gone])
        assert not action[gone].any()
        for name in ("anomaly_score", "has_image", "latent_vp", "velocity_op", "accepted"):
            np.testing.assert_array_equal(getattr(left, name)[~gone], getattr(whole, name)[~gone])
        if gone.any():
            np.testing.assert_array_equal(left.latent_vp[gone], before)
    whole.reset()
    left.reset()
    arguments = observation, image, np.zeros(5, bool)
    np.testing.assert_array_equal(left.step(*arguments), whole.step(*arguments))


def test_a_robot_that_begins_anew_has_its_image_and_no_error_of_the_map(policy):
    policy.has_image[:] = False
    policy.map_error[:] = 0.7
    policy.reset(np.array([True, False, True]))
    assert policy.has_image.tolist() == [True, False, True]
    np.testing.assert_allclose(policy.map_error, [0.0, 0.7, 0.0])


def spoilt(policy: BundlePolicy, **changes) -> None:
    """Let a tick find other numbers for robot 1."""
    found = {"latent_op": policy.latent_op, "latent_vp": policy.latent_vp}
    found |= {"velocity_op": policy.velocity_op, "velocity_vp": policy.velocity_vp}
    found = {name: value.copy() for name, value in found.items()}
    for name, value in changes.items():
        found[name][1] = value
    policy._accept(found)


@pytest.mark.parametrize("name", ["latent_vp", "velocity_vp"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -1e30])
def test_a_vp_that_finds_no_numbers_leaves_op_driving_and_begins_anew(policy, name, value):
    """And the robots beside it walk on as they did."""
    random = np.random.default_rng(0)
    observation = random.normal(size=(3, 45)).astype(np.float32)
    image = random.random((3, 48, 64)).astype(np.float32)
    policy.step(observation, image, np.zeros(3, bool))
    vp = policy.latent_vp.copy()
    spoilt(policy, **{name: value})
    assert policy.vp_lost.tolist() == [False, True, False]
    assert not policy.op_lost.any()
    assert policy.has_image.tolist() == [True, False, True]
    np.testing.assert_array_equal(policy.latent_vp[[0, 2]], vp[[0, 2]])
    assert not policy.latent_vp[1].any()
    action = policy.step(observation, image, np.zeros(3, bool))
    assert np.isfinite(action).all()
    for _ in range(5):
        policy.step(observation, image, np.zeros(3, bool))
    assert not policy.vp_lost.any()
    policy.reset()
    assert not policy.vp_lost.any()


@pytest.mark.parametrize("name", ["latent_op", "velocity_op"])
def test_an_op_that_finds_no_numbers_is_told(policy, name):
    spoilt(policy, **{name: np.nan})
    assert policy.op_lost.tolist() == [False, True, False]


def test_surprise_and_stillness_are_those_of_training_whatever_is_withheld(manifest, tmp_path):
    torch.manual_seed(0)
    networks = RENet(ModelCfg(detector="variance", expect_image=True), critic_size=10).eval()
    path = write_bundle(tmp_path / "expecting", export_models(networks), manifest)
    policy = BundlePolicy(Bundle.load(path), num_robots=3)
    memory = EstimatorMemory(networks.cfg, 3, "cpu")
    random = np.random.default_rng(0)
    nobody = np.zeros(3, bool)
    evidence = Evidence(torch.zeros(3), torch.zeros(3))
    ages = set()
    for step in range(300):
        observation = random.normal(size=(3, 45)).astype(np.float32)
        image = random.random((3, 48, 64)).astype(np.float16)
        memory.push(torch.tensor(observation))
        if step % 5 == 0:
            fresh = memory.fresh.clone()
            has_image = torch.tensor(random.random(3) < 0.5) | fresh
            known = Recollection(
                memory.latent_vp,
                memory.history,
                mean_blocks(memory.frames[:, 0].float()),
                memory.image_age,
            )
            with torch.no_grad():
                blocks = mean_blocks(torch.tensor(image).float())
                expected = networks.expectation.surprise(known, blocks) * ~fresh
                weighed = networks.expectation.weigh(known, blocks, evidence)
            stillness = weighed.stillness * ~fresh
            # Old images, and those of robots that expect none, are no evidence.
            new = torch.tensor(random.random(3) < 0.7)
            kept = [
                torch.where(new & ~fresh, *pair) for pair in zip(weighed, evidence, strict=True)
            ]
            evidence = Evidence(*kept)
            ages |= set(memory.image_age.tolist())
            memory.see(torch.tensor(image), has_image)
            memory.tick(networks.advance)
            gate = Gate(has_image.numpy(), {}, fresh=new.numpy())
        policy.step(observation, image.astype(np.float32), nobody, gate)
        if step % 5 == 0:
            np.testing.assert_allclose(policy.surprise, expected, atol=1e-4)
            np.testing.assert_allclose(policy.stillness, stillness, atol=1e-4)
        done = random.random(3) < 0.01
        policy.reset(done)
        evidence = Evidence(*(part * ~torch.tensor(done) for part in evidence))
        memory.reset(torch.tensor(done))
    assert max(ages) > 0.25, "images were withheld for some ticks"
