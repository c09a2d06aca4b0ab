"""Sizes of tiles at the levels of the curriculum."""

import pytest

from renet.errors import RenetError
from renet.terrain.tiles import GapTile, dense_tiles, find_tile, tiles


def test_sizes_grow_evenly_from_level_1_to_level_10():
    gap = GapTile(low=0.1, high=1.0)
    sizes = [gap.measure_at(level) for level in range(1, 11)]
    assert sizes == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0])


# docs/measure.md, the table of grounds.
@pytest.mark.parametrize(
    ("kind", "level", "metres"),
    [("stairs_up", 6, 0.15), ("stairs_down", 10, 0.23), ("platform", 6, 0.30), ("gap", 3, 0.23)],
)
def test_sizes_are_those_of_the_documents(kind, level, metres):
    assert find_tile(kind, level).measure_at(level) == pytest.approx(metres, abs=0.005)


def test_a_flat_start_has_no_obstacle_and_then_the_whole_range():
    for kind, tile in dense_tiles().items():
        if tile.flat_start:
            assert tile.measure_at(1) < 0.01
            assert tile.measure_at(2) == pytest.approx(tiles()[kind].measure_at(1))
            assert tile.measure_at(10) == pytest.approx(tiles()[kind].measure_at(10))


def test_unknown_kinds_and_levels_are_refused():
    with pytest.raises(RenetError, match="terrain"):
        find_tile("lava", 1)
    for level in (0, 11):
        with pytest.raises(RenetError, match=f"terrain level must be 1 to 10, got {level}"):
            find_tile("gap", level)
