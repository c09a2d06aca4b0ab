from __future__ import annotations

import numpy as np

from renet.evaluation.world import SimWorld, study_env_cfg
from renet.terrain.tiles import LEVELS, TILE, tiles


def test_robots_stand_on_the_tiles_they_are_placed_on() -> None:
    kinds, levels = np.array([4, 2, 3, 5]), np.array([0, 9, 4, 2])
    world = SimWorld(study_env_cfg("Renet-Go1-Parkour", 0.5), range(4), 1, "auto")
    world.place(levels, kinds)
    readings = world.reset()
    assert ((readings.height > 0.2) & (readings.height < 0.4)).all()
    np.testing.assert_allclose(readings.proprioception[:, 6], 0.5)
    position = world.env.scene["robot"].data.root_link_pos_w.numpy()
    # Rows of the terrain lie along x, columns along y, one tile apart.
    order = np.argsort(levels)
    np.testing.assert_allclose(np.diff(position[order, 0]), TILE * np.diff(levels[order]), atol=0.7)
    rise = tiles()["stairs_up"].measure(9 / (LEVELS - 1))
    assert position[1, 2] < -5 * rise
    for _ in range(5):
        readings = world.step(np.zeros((4, 12), np.float32))
    assert not readings.ended.any()
    assert readings.travelled.max() < 0.3
