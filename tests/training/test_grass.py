"""Grass before images: which images have it, and that it only hides."""

import torch

from renet.training.grass import Grass, draw_views


def test_views_have_blades_and_holes():
    views = draw_views(seed=3)
    assert views.shape == (512, 48, 64)
    assert torch.equal(views, draw_views(seed=3))
    covered = (views < 1.0).float().mean((1, 2))
    assert 0.0 <= covered.min() < 0.03
    assert 0.2 < covered.max() < 0.6
    holes = (views == 0.0).float().mean((1, 2))
    assert (holes <= covered).all()
    assert 0.02 < holes.mean() < 0.2


def test_grass_covers_15_of_100_pairs():
    torch.manual_seed(0)
    pairs = torch.full((100, 2, 48, 64), 0.9)
    seen = Grass(pairs.device).before_pairs(pairs)
    assert torch.equal(seen[15:], pairs[15:])
    assert (seen <= pairs).all()
    # A view may hold a single blade, beside the image.
    assert ((seen[:15] < pairs[:15]).flatten(2).any(-1)).float().mean() > 0.7
    assert (seen[:15, 0] != seen[:15, 1]).flatten(1).any(1).float().mean() > 0.8
    assert (pairs == 0.9).all()


def test_grass_covers_every_seventh_robot():
    torch.manual_seed(0)
    images = torch.full((70, 48, 64), 0.9)
    seen = Grass(images.device).before_robots(images)
    overgrown = (seen < images).flatten(1).any(1)
    # A view may hold a single blade, beside the image.
    assert overgrown[::7].float().mean() > 0.7
    assert overgrown.sum() == overgrown[::7].sum()
    assert (images == 0.9).all()
