"""HIM against an independent NumPy reference."""

from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import renet
from renet.models.him import HybridInternalModel, sinkhorn, swapped_prediction_loss, target_view
from renet.training import checkpoint as checkpoints
from renet.training.export import load_networks


def reference_sinkhorn(score: np.ndarray) -> np.ndarray:
    """SwAV's form: prototypes as rows, alternating row and column normalisation."""
    q = np.exp(score / 0.05).T
    q /= q.sum()
    prototypes, batch = q.shape
    for _ in range(3):
        q /= q.sum(axis=1, keepdims=True) * prototypes
        q /= q.sum(axis=0, keepdims=True) * batch
    return (q * batch).T


@settings(max_examples=20)
@given(seed=st.integers(0, 1000), batch=st.integers(2, 40))
def test_sinkhorn_and_loss_match_the_reference(seed, batch):
    random = np.random.default_rng(seed)
    draws = [random.normal(size=(count, 16)) for count in (batch, batch, 32)]
    source, target, prototypes = (x / np.linalg.norm(x, axis=-1, keepdims=True) for x in draws)
    scores = source @ prototypes.T, target @ prototypes.T
    assignments = [reference_sinkhorn(s) for s in scores]
    counts = torch.ones(batch, dtype=torch.float64)
    got = sinkhorn(torch.tensor(scores[0]), counts)
    np.testing.assert_allclose(got, assignments[0], atol=1e-9)

    def log_softmax(x):
        return x - np.log(np.exp(x).sum(-1, keepdims=True))

    # HIMLoco's code takes the mean of a [batch, 32] table; the temperature is SwAV's.
    logs = [log_softmax(s / 0.1) for s in scores]
    expected = -0.5 * (assignments[0] * logs[1] + assignments[1] * logs[0]).mean()
    got = swapped_prediction_loss(*map(torch.tensor, (source, target, prototypes)), counts)
    np.testing.assert_allclose(got, expected, atol=1e-9)


def test_uncounted_pairs_are_ignored():
    torch.manual_seed(0)
    him, latent, following = HybridInternalModel(), torch.randn(9, 64), torch.randn(9, 45)
    some = torch.tensor([1, 0, 1, 1, 0, 0, 1, 1, 0]).bool()
    alone = him(latent[some], following[some], torch.ones(int(some.sum())))
    torch.testing.assert_close(him(latent, following, some.float()), alone)
    assert him(latent, following, torch.zeros(9)) == 0.0


def test_training_pulls_matching_views_together():
    torch.manual_seed(0)
    him = HybridInternalModel()
    latent, following = torch.randn(256, 64), torch.randn(256, 45)
    following[:, :16] = latent[:, :16]
    optimizer = torch.optim.Adam(him.parameters(), lr=1e-3)
    losses = []
    for _ in range(150):
        loss = him(latent, following, torch.ones(256))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    chance = np.log(32) / 32
    assert losses[0] > 0.9 * chance
    assert losses[-1] < 0.5 * chance
    # At HIMLoco's temperature of 3 the prototypes collapse onto one line in as many steps.
    assert him.effective_rank() > 8
    assert him.usage > 16


def test_the_shipped_prototypes_have_not_collapsed():
    shipped = Path(renet.__file__).parent / "pretrained" / "checkpoint"
    model = load_networks(checkpoints.find(shipped))
    assert min(model.op_him.effective_rank(), model.vp_him.effective_rank()) > 8


def test_collapse_shows_in_rank_and_usage():
    torch.manual_seed(0)
    him = HybridInternalModel()
    with torch.no_grad():
        line = torch.randn(16)
        him.prototypes.weight.copy_(torch.outer(torch.randn(32).sign(), line))
        him.source.weight.zero_()
        him.source.bias.copy_(line)
    him(torch.randn(64, 64), torch.randn(64, 45), torch.ones(64))
    sides = (him.prototypes.weight @ line > 0).sum().item()
    torch.testing.assert_close(him.effective_rank(), torch.tensor(1.0), atol=1e-3, rtol=0)
    assert him.usage.item() == pytest.approx(sides, rel=1e-3)


def test_target_has_velocity_for_command():
    state, velocity = torch.arange(45.0).repeat(2, 1), torch.tensor([[7.0, 8.0, 9.0]] * 2)
    view = target_view(state, velocity)
    # Angular velocity and gravity (0 to 5), joints and actions (9 to 44), then the velocity.
    expected = [*range(6), *range(9, 45), 7, 8, 9]
    torch.testing.assert_close(view, torch.tensor([expected] * 2, dtype=torch.float32))
