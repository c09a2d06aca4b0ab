"""Colours of height maps: which way is up, and what is bright."""

import numpy as np
import pytest

from renet.evaluation.report.video import RELIEF, map_picture
from renet.interface import HEIGHT_MAP_X, HEIGHT_MAP_Y


@pytest.mark.parametrize(
    ("x", "y", "row", "column"),
    [(-1, 0, 0, -1), (0, -1, -1, 0), (-1, -1, 0, 0)],
    ids=["ahead right", "behind left", "ahead left"],
)
def test_ahead_is_up_and_left_is_left(x, y, row, column):
    values = np.zeros((len(HEIGHT_MAP_X), len(HEIGHT_MAP_Y)))
    values[x, y] = -RELIEF  # The ground is as high as colours go.
    picture = map_picture(values.ravel(), scale=1)
    brightness = picture.astype(int).sum(-1)
    high = np.argwhere(brightness != brightness[5, 5])
    expected = [row % len(HEIGHT_MAP_X), column % len(HEIGHT_MAP_Y)]
    assert high.tolist() == [expected]
    assert brightness[row, column] > brightness[5, 5]
