"""The curriculum of tiles for mjlab, and tiles in a row for evaluation."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, cast

from mjlab.terrains import SubTerrainCfg, TerrainEntityCfg, TerrainGeneratorCfg

from renet.terrain.course import WIDTH, Course
from renet.terrain.tiles import LEVELS, TILE, Tile, find_tile, tiles

SubTerrainCfg.register(Tile)  # mjlab's command line asks; tiles themselves need no mjlab.

UNSEEN = 1
"""Seed of evaluation's tiles; training's is 0."""


def parkour_terrain(
    seed: int = 0, kinds: Mapping[str, Tile] | None = None, levels: int = LEVELS
) -> TerrainEntityCfg:
    """The curriculum: one column per kind of tile, by default training's, and one row per level.

    The seed is of rough ground and obstacles; other tiles hold nothing random.
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
    """Tiles in a row with a flat border, each at its own level, for evaluation.

    No training saw them: random tiles are drawn from another seed, and gaps and platforms are
    single rings where the default recipe trains on several.

    Args:
        grounds: level, 1 to 10, of each kind of tile; "flat" is one without relief. Raises
            RenetError for an unknown kind or level.
    """
    kinds = {}
    for kind, level in grounds.items():
        tile, difficulty = find_tile("rough" if kind == "flat" else kind, level)
        size = 0.0 if kind == "flat" else tile.measure(difficulty)
        kinds[kind] = replace(tile, low=size, high=size, proportion=1.0, flat_start=False)
    return parkour_terrain(UNSEEN, kinds, levels=1)


def course_row(courses: Mapping[str, Course]) -> TerrainEntityCfg:
    """Courses side by side, by name; tiles are as long as the longest of them."""
    generator = TerrainGeneratorCfg(
        curriculum=True,
        size=(max(course.length for course in courses.values()), WIDTH),
        border_width=TILE,
        num_rows=1,
        color_scheme="none",
        sub_terrains=cast(Any, dict(courses)),
        add_lights=True,
    )
    return TerrainEntityCfg(
        terrain_type="generator", terrain_generator=generator, max_init_terrain_level=None
    )
