"""The Oracle's image shows the height map as it lies before the robot."""

import pytest
import torch

from renet.interface import HEIGHT_MAP_SIZE, HEIGHT_MAP_X, HEIGHT_MAP_Y
from renet.models.oracle import true_image


def test_oracle_image_is_upright() -> None:
    ahead_left = HEIGHT_MAP_X.index(1.2) * len(HEIGHT_MAP_Y) + HEIGHT_MAP_Y.index(0.75)
    height_map = torch.zeros(2, HEIGHT_MAP_SIZE)
    height_map[0, ahead_left] = 0.2
    image, level = true_image(height_map)
    assert (level == 0.5).all()
    assert image[:4, :5].unique().item() == pytest.approx(0.7)
    assert image.mean() == pytest.approx(0.5 + 0.2 / HEIGHT_MAP_SIZE, abs=5e-4)


def test_oracle_image_stays_in_range() -> None:
    assert (true_image(torch.full((1, HEIGHT_MAP_SIZE), 1.3)) == 1.0).all()
    assert (true_image(torch.full((1, HEIGHT_MAP_SIZE), -1.3)) == 0.0).all()
