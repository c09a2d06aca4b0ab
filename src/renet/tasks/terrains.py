"""The curriculum of tiles for mjlab, and tiles in a row for evaluation."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, cast

from mjlab.terrains import SubTerrainCfg, TerrainEntityCfg, TerrainGeneratorCfg

from renet.errors import RenetError
from renet.terrain.course import WIDTH, Course
from renet.terrain.own_ground import KIND
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


def own_ground(tile: Tile, level: int) -> TerrainEntityCfg:
    """A tile of somebody's own ground at a level, 1 to 10, with a flat border, for evaluation."""
    if not 1 <= level <= LEVELS:
        raise RenetError(f"terrain level must be 1 to {LEVELS}, got {level}")
    size = tile.measure((level - 1) / (LEVELS - 1))
    return parkour_terrain(UNSEEN, {KIND: replace(tile, low=size, high=size)}, levels=1)


def add_own_ground(terrain: TerrainEntityCfg | None, tile: Tile, share: float) -> None:
    """Add somebody's own ground to a curriculum of tiles, in place, as one more kind.

    Args:
        terrain: of the task; raises RenetError if it has no tiles.
        tile: the ground. share: of the robots that walk there, above 0; 1: all of them.
    """
    if not 0.0 < share <= 1.0:
        raise RenetError(f"--scene-share must be above 0 and at most 1, got {share:g}")
    if terrain is None or terrain.terrain_generator is None:
        raise RenetError("the task has no tiles to put a scene among: train a Parkour task")
    generator = terrain.terrain_generator
    others = {kind: cfg for kind, cfg in generator.sub_terrains.items() if kind != KIND}
    if share == 1.0:
        generator.sub_terrains = cast(Any, {KIND: replace(tile, proportion=1.0)})
        return
    total = sum(cfg.proportion for cfg in others.values())
    proportion = share / (1.0 - share) * total
    generator.sub_terrains = cast(Any, {**others, KIND: replace(tile, proportion=proportion)})
