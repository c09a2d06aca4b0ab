"""A task with one more kind of tile: `python examples/add_tile.py train Renet-Go1-Beams`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mjlab.tasks.registry import load_env_cfg, load_rl_cfg

from renet.cli import main
from renet.registry import register_task
from renet.terrain.tiles import FLOOR, STEEL, TILE, Tile, TileBuilder


@dataclass
class Beams(Tile):
    """Beams around the start, `measure` metres high."""

    low: float = 0.03
    high: float = 0.20

    def build(self, builder: TileBuilder, measure: float, rng: np.random.Generator) -> float:
        """Add the floor and the beams; the start is at height 0."""
        builder.square(TILE / 2, FLOOR)
        for inner in (1.2, 2.0, 2.8):
            builder.ring(inner, inner + 0.1, (-0.1, measure), STEEL)
        return 0.0


env, play = (load_env_cfg("Renet-Go1-Parkour", play) for play in (False, True))
for cfg in (env, play):
    cfg.scene.terrain.terrain_generator.sub_terrains["beams"] = Beams(flat_start=True)
register_task("Renet-Go1-Beams", env, play, load_rl_cfg("Renet-Go1-Parkour"))

if __name__ == "__main__":
    raise SystemExit(main())
