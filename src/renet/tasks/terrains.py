"""Terrains for mjlab: the curriculum of tiles, and rows of tiles for evaluation."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, cast

from mjlab.terrains import SubTerrainCfg, TerrainEntityCfg, TerrainGeneratorCfg

from renet.errors import RenetError
from renet.interface import OWN_GROUND
from renet.options import NO_TILES, check_share
from renet.terrain.course import COURSE_WIDTH, Course
from renet.terrain.tiles import LEVELS, TILE, Tile, find_tile, tiles

# mjlab's command line accepts only its subclasses; `Tile` itself must not import mjlab.
SubTerrainCfg.register(Tile)

EVALUATION_SEED = 1
"""Seed of the tiles of evaluation; that of training is 0."""


def parkour_terrain(
    seed: int = 0, kinds: Mapping[str, Tile] | None = None, levels: int = LEVELS
) -> TerrainEntityCfg:
    """Configure the curriculum: a column for each kind of tile, and a row for each level.

    Args:
        seed: Seed of rough ground and obstacles; other tiles are not random.
        kinds: Tiles by kind, by default those of training.
        levels: Number of levels.
    """
    generator = TerrainGeneratorCfg(
        seed=seed,
        curriculum=True,
        size=(TILE, TILE),
        border_width=TILE,
        num_rows=levels,
        color_scheme="none",
        sub_terrains=cast(Any, tiles() if kinds is None else kinds),
        add_lights=True,
    )
    return TerrainEntityCfg(
        terrain_type="generator", terrain_generator=generator, max_init_terrain_level=1
    )


def tile_row(grounds: Mapping[str, int]) -> TerrainEntityCfg:
    """Configure a row of tiles with a flat border, each at its own level, for evaluation.

    The tiles are new to a policy: random ones have another seed than in training, and gaps and
    platforms are single rings, of which the default recipe has several on a tile.

    Args:
        grounds: Level, from 1 to 10, of each kind of tile; "flat" is a tile without relief.

    Raises:
        RenetError: There is no such kind or level.
    """
    kinds = {}
    for kind, level in grounds.items():
        # Flat ground is rough ground of height 0.
        tile = find_tile("rough" if kind == "flat" else kind, level)
        size = 0.0 if kind == "flat" else tile.measure_at(level)
        kinds[kind] = replace(tile, low=size, high=size, proportion=1.0, flat_start=False)
    return parkour_terrain(EVALUATION_SEED, kinds, levels=1)


def course_row(courses: Mapping[str, Course]) -> TerrainEntityCfg:
    """Configure courses side by side; all tiles are as long as the longest course.

    Args:
        courses: Courses by name.
    """
    generator = TerrainGeneratorCfg(
        curriculum=True,
        size=(max(course.length for course in courses.values()), COURSE_WIDTH),
        border_width=TILE,
        num_rows=1,
        color_scheme="none",
        sub_terrains=cast(Any, dict(courses)),
        add_lights=True,
    )
    return TerrainEntityCfg(
        terrain_type="generator", terrain_generator=generator, max_init_terrain_level=None
    )


def own_ground(tile: Tile, level: int) -> TerrainEntityCfg:
    """Configure a user's own ground at a level from 1 to 10, with a flat border, for evaluation.

    Raises:
        RenetError: There is no such level.
    """
    if not 1 <= level <= LEVELS:
        raise RenetError(f"terrain level must be 1 to {LEVELS}, got {level}")
    size = tile.measure_at(level)
    return parkour_terrain(
        EVALUATION_SEED, {OWN_GROUND: replace(tile, low=size, high=size)}, levels=1
    )


def add_own_ground(terrain: TerrainEntityCfg | None, tile: Tile, share: float) -> None:
    """Add a user's own ground to a curriculum of tiles, in place, as one more kind.

    Args:
        terrain: The task's terrain.
        tile: The ground.
        share: Share of the robots that walk there, above 0; with 1 the other tiles are removed.

    Raises:
        RenetError: The terrain has no tiles, or the share is out of its range.
    """
    check_share(share)
    if terrain is None or terrain.terrain_generator is None:
        raise RenetError(NO_TILES)
    generator = terrain.terrain_generator
    if share == 1.0:
        generator.sub_terrains = cast(Any, {OWN_GROUND: replace(tile, proportion=1.0)})
        return
    # Proportions are relative to each other: that of the new kind follows from the others' sum.
    others = {kind: cfg for kind, cfg in generator.sub_terrains.items() if kind != OWN_GROUND}
    total = sum(cfg.proportion for cfg in others.values())
    proportion = share / (1.0 - share) * total
    generator.sub_terrains = cast(Any, {**others, OWN_GROUND: replace(tile, proportion=proportion)})
