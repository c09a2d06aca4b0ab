"""Blades before the detector's training images."""

import torch

from renet.models.config import ModelCfg
from renet.models.renet import RENet
from renet.training.config import SupervisionCfg
from renet.training.sparse_grass import draw_views, grow
from renet.training.supervision import Supervision


def test_views_hold_one_to_twenty_blades_and_holes_where_one_is_not_measured():
    views = draw_views(seed=3)
    assert views.shape == (512, 48, 64)
    assert torch.equal(views, draw_views(seed=3))
    covered = (views < 1.0).float().mean((1, 2))
    assert 0.0 <= covered.min() < 0.03
    assert 0.2 < covered.max() < 0.6
    holes = (views == 0.0).float().mean((1, 2))
    assert (holes <= covered).all()
    assert 0.02 < holes.mean() < 0.2


def test_blades_hide_the_ground_in_15_of_100_pairs_and_differ_between_their_images():
    torch.manual_seed(0)
    pairs = torch.full((100, 2, 48, 64), 0.9)
    seen = grow(pairs, draw_views()[400:])
    assert torch.equal(seen[15:], pairs[15:])
    assert (seen <= pairs).all()
    assert ((seen[:15] < pairs[:15]).flatten(2).any(-1)).float().mean() > 0.9
    assert (seen[:15, 0] != seen[:15, 1]).flatten(1).any(1).float().mean() > 0.9
    assert (pairs == 0.9).all()


def test_the_variance_detector_alone_learns_from_them(monkeypatch):
    for detector, share in (("variance", 0.15), ("reconstruction", 0.0)):
        model = RENet(ModelCfg(detector=detector), critic_size=5)
        learned: list[torch.Tensor] = []
        monkeypatch.setattr(model.autoencoder, "loss", lambda p, to=learned: to.append(p) or {})
        supervision = Supervision(model, SupervisionCfg(autoencoder_images=40))
        supervision._anomaly_losses(torch.ones(10, 10, 2, 48, 64))
        grown = (learned[0] < 1.0).flatten(1).any(1).float().mean()
        assert grown == 0.0 if share == 0.0 else 0.1 < grown <= share
