"""Layer counts of the paper; attention and the anomaly score against other ways to compute them."""

import pytest
import torch
import torch.nn.functional as functional
from torch import nn

from renet.models import estimators
from renet.models.autoencoder import DepthAutoencoder, variance_score
from renet.models.config import ModelCfg
from renet.models.estimators import AttentionEncoder, MlpEncoder


@pytest.mark.parametrize(
    ("module", "kind", "layers"),
    [
        (estimators.ProprioceptionEmbedding(10), nn.Linear, 2),
        (estimators.DepthEmbedding(2), nn.Conv2d, 3),
        (estimators.OPEstimator(ModelCfg()), nn.GRUCell, 1),
        (estimators.VPEstimator(ModelCfg()), nn.GRUCell, 1),
        (DepthAutoencoder().encode, nn.Conv2d, 3),
        (DepthAutoencoder().decode, nn.ConvTranspose2d, 3),
    ],
)
def test_layer_counts_match_the_paper(module, kind, layers):
    assert sum(isinstance(m, kind) for m in module.modules()) == layers


def test_attention_is_one_layer_with_one_head():
    torch.manual_seed(0)
    encoder, inputs = AttentionEncoder(2), [torch.randn(5, 64), torch.randn(5, 64)]
    tokens = torch.cat(inputs, dim=-1).reshape(5, 8, 16) + encoder.position
    parts = (tokens @ encoder.query_key_value.weight.T + encoder.query_key_value.bias).split(16, -1)
    mixed = functional.scaled_dot_product_attention(*(part[:, None] for part in parts))[:, 0]
    expected = encoder.compress(encoder.norm(tokens + mixed).flatten(1))
    torch.testing.assert_close(encoder(inputs), expected, atol=1e-5, rtol=1e-4)


def test_the_mlp_encoder_compresses_the_concatenation():
    encoder, inputs = MlpEncoder(2), [torch.randn(5, 64), torch.randn(5, 64)]
    torch.testing.assert_close(encoder(inputs), encoder.fuse(torch.cat(inputs, dim=-1)))
    assert encoder.fuse[0].in_features == 128


def test_variance_loss_is_least_at_true_error(monkeypatch):
    detector = DepthAutoencoder("variance")
    depth = torch.rand(4, 2, 48, 64)
    error = torch.rand(2, 48, 64) * 0.2 + 0.05
    log_variance = torch.zeros(2, 48, 64, requires_grad=True)
    monkeypatch.setattr(detector, "predict", lambda x: (x + error, log_variance.expand_as(x)))
    optimizer = torch.optim.Adam([log_variance], lr=0.1)
    for _ in range(300):
        losses = detector.loss(depth)
        optimizer.zero_grad()
        losses["anomaly_nll"].backward()
        optimizer.step()
    torch.testing.assert_close(log_variance.detach(), (error**2).log(), atol=0.02, rtol=0)
    assert not losses["anomaly"].requires_grad
    assert losses["anomaly"].item() == pytest.approx((error**2).mean().item(), rel=1e-4)


def test_the_variance_score_by_hand():
    depth, drawn = torch.full((1, 2, 48, 64), 0.5), torch.full((1, 2, 48, 64), 0.3)
    log_variance = torch.full_like(depth, 0.04).log()
    torch.testing.assert_close(variance_score(depth, drawn, log_variance), torch.tensor([1.0]))
