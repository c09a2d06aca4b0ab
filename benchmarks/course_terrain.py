"""The passages of the course, each as wide as its tile, so that none can be walked around.

Tiles of 8 m lie along +y, from one flat edge to the next. Obstacles are as large as the
curriculum's.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import mujoco
import numpy as np

from renet.errors import RenetError
from renet.terrain.tiles import (
    ACCENT,
    FLOOR,
    LEVELS,
    PIT,
    STEEL,
    STONE,
    TILE,
    Obstacles,
    Rough,
    Tile,
    TileBuilder,
    TileGeom,
    tiles,
)

LAP = (
    "flat",
    "grass",
    "grass",
    "stairs",
    "slope",
    "occlusion",
    "rough",
    "platform",
    "gap",
    "stairs",
    "obstacles",
    "grass",
    "flat",
)
"""One lap, in the order of the paper's walk: grass, stairs, slope, platforms and gaps, back."""
SHORT_LAP = ("flat", "grass", "stairs", "slope", "occlusion", "platform", "gap", "flat")
HALF = TILE / 2
SET_DOWN = 0.6
"""Where a robot is set down, m from a tile's beginning; obstacles begin 0.8 m from it or more."""
SLOPES = (0.2, 1.0)
"""Rise of a slope over 2 m at the first and last level, m: 6 to 27 degrees."""


def flat(builder: TileBuilder, measure: float) -> None:
    """Flat ground."""
    builder.square(HALF, FLOOR)


def stairs(builder: TileBuilder, rise: float) -> None:
    """Six steps of `rise` m up, a landing, six down."""
    builder.square(HALF, FLOOR)
    for step in range(1, 7):
        far = 2.6 - (step - 1) * 0.3
        color = STONE if step % 2 else STEEL
        builder.box((-HALF, HALF), (-far, far), (0.0, step * rise), color)


def slope(builder: TileBuilder, rise: float) -> None:
    """A ramp that rises by `rise` m over 2 m, a landing of 1.2 m, a ramp down."""
    run, landing, thick = 2.0, 0.6, 0.2
    builder.square(HALF, FLOOR)
    builder.box((-HALF, HALF), (-landing, landing), (0.0, rise), STEEL)
    angle, length = math.atan2(rise, run), math.hypot(rise, run)
    for side in (-1.0, 1.0):
        tilt = -side * angle
        # The middle of the ramp's upper face, less half the slab's thickness along its normal.
        y = side * (landing + run / 2) + thick / 2 * math.sin(tilt)
        z = rise / 2 - thick / 2 * math.cos(tilt)
        geom = builder.body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=(HALF, length / 2, thick / 2),
            pos=(HALF, HALF + y, z),
            quat=(math.cos(tilt / 2), math.sin(tilt / 2), 0.0, 0.0),
            rgba=STONE,
        )
        builder.geometries.append(TileGeom(geom, STONE))


def platforms(builder: TileBuilder, height: float) -> None:
    """Two platforms `height` m high and 1.5 m long."""
    builder.square(HALF, FLOOR)
    for start in (-2.2, 0.9):
        builder.box((-HALF, HALF), (start, start + 1.5), (-0.1, height), ACCENT)


def gaps(builder: TileBuilder, width: float) -> None:
    """Two gaps `width` m wide and 1 m deep, 2 m of ground between them."""
    builder.square(HALF, (-1.2, -1.0), PIT)
    start = -1.0 - width
    for stretch in ((-HALF, start), (-1.0, 1.0), (1.0 + width, HALF)):
        builder.box((-HALF, HALF), stretch, (-1.0, 0.0))


@dataclass
class Passage(Tile):
    """A tile that is crossed along y; robots are set down at its beginning."""

    obstacle: Callable[[TileBuilder, float], None] = flat
    """Adds the ground and an obstacle of a size, m."""

    def start(self, height: float) -> np.ndarray:
        """At the tile's beginning."""
        return np.array([HALF, SET_DOWN, height])

    def build(self, builder: TileBuilder, measure: float, rng: np.random.Generator) -> float:
        """Add the passage's geoms, of size `measure`, m; returns the start's height, 0 m."""
        self.obstacle(builder, measure)
        return 0.0


class Blocks(Obstacles, Passage):
    """Scattered blocks, as in training."""

    def place(self, a: float, b: float, rng: np.random.Generator) -> tuple[float, float]:
        """Middle of a block of half-sizes a, b that leaves both ends of the tile free, m."""
        x, y = rng.uniform(-3.0, 3.0), rng.uniform(-2.0, 2.5)
        return float(x), float(y)


class Relief(Rough, Passage):
    """Random relief, as in training."""


def passage(kind: str, level: int) -> Tile:
    """A passage with obstacles of a level between 1 and 10.

    Raises:
        RenetError: unknown kind or level.
    """
    if not 1 <= level <= LEVELS:
        raise RenetError(f"level must be 1 to {LEVELS}, got {level}")
    share = (level - 1) / (LEVELS - 1)
    generators = tiles()
    # Level 1 of rough ground is flat: grass grows on what level 4 has.
    relief = generators["rough"].measure(max(share, 1 / 3))
    kinds: dict[str, tuple[Callable[..., Tile], float]] = {
        "flat": (Passage, 0.0),
        "occlusion": (Passage, 0.0),
        "grass": (Relief, relief),
        "rough": (Relief, relief),
        "stairs": (partial(Passage, obstacle=stairs), generators["stairs_up"].measure(share)),
        "slope": (partial(Passage, obstacle=slope), SLOPES[0] + share * (SLOPES[1] - SLOPES[0])),
        "platform": (partial(Passage, obstacle=platforms), generators["platform"].measure(share)),
        "gap": (partial(Passage, obstacle=gaps), generators["gap"].measure(share)),
        "obstacles": (Blocks, generators["obstacles"].measure(share)),
    }
    if kind not in kinds:
        raise RenetError(f"unknown passage '{kind}': choose among {', '.join(kinds)}")
    build, measure = kinds[kind]
    return build(low=measure, high=measure)
