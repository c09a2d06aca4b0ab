"""The deployed policy equals the networks it was exported from, and refuses bad input."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from renet.deploy.bundle import Bundle
from renet.deploy.policy import Policy
from renet.errors import RenetError
from renet.models.actor_critic import fuse
from renet.models.memory import EstimatorMemory


@pytest.fixture
def policy(bundle_path) -> Policy:
    return Policy(Bundle.load(bundle_path), num_robots=3)


def test_equals_the_training_side_over_20_seconds_with_switching_and_resets(policy, networks):
    random = np.random.default_rng(0)
    memory = EstimatorMemory(networks.cfg, 3, "cpu")
    image = None
    for step in range(1000):
        observation = random.normal(size=(3, 45)).astype(np.float32)
        if step % 5 == 0:
            image = random.random((3, 48, 64)).astype(np.float16)
        use_op = random.random(3) < 0.3
        action = policy.step(observation, image.astype(np.float32), use_op)
        memory.push(torch.tensor(observation))
        if step % 5 == 0:
            memory.see(torch.tensor(image))
            memory.tick(networks.advance)
        with torch.no_grad():
            latent = fuse(memory.latent_op, memory.latent_vp, torch.tensor(use_op))
            expected = networks.actor(torch.tensor(observation), latent)
        np.testing.assert_allclose(action, expected.clamp(-4.8, 4.8), atol=1e-4)
        done = random.random(3) < 0.01
        policy.reset(done)
        memory.reset(torch.tensor(done))


def test_walks_on_without_a_camera(policy):
    op = policy.step(np.zeros((3, 45)), None, np.zeros(3, bool))
    assert np.isinf(policy.anomaly_score).all()
    assert np.isfinite(op).all()


@pytest.mark.parametrize(
    ("observation", "image", "message"),
    [
        (np.zeros((3, 44)), np.zeros((3, 48, 64)), r"proprioception has shape \(3, 44\)"),
        (np.zeros((3, 45)), np.zeros((3, 64, 48)), r"depth image has shape \(3, 64, 48\)"),
        (np.full((3, 45), np.nan), np.zeros((3, 48, 64)), "proprioception contains NaN"),
        (np.zeros((3, 45)), np.full((3, 48, 64), np.inf), "depth image contains NaN or inf"),
    ],
)
def test_bad_input_is_refused_and_nothing_is_remembered(policy, observation, image, message):
    before = policy._history.copy()
    with pytest.raises(RenetError, match=message):
        policy.step(observation, image, np.zeros(3, bool))
    np.testing.assert_array_equal(policy._history, before)
    assert policy._blank.all()
