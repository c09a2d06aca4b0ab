"""tools/pictures.py: every picture, with honest numbers beside them."""

import json

import numpy as np
import pytest
from PIL import Image

from pictures import WARM_UP, Cfg, as_seen, errors, main
from renet.interface import HEIGHT_MAP_SIZE, HEIGHT_MAP_X, HEIGHT_MAP_Y
from renet.terrain.tiles import tiles


def test_every_picture_is_written_and_the_numbers_are_those_of_the_robots(tmp_path):
    out = tmp_path / "pictures"
    main(Cfg(out=out, seconds=2.0, level=8))
    names = {path.name for path in out.iterdir()}
    assert names == {"tiles.png", "camera.png", "height_map.png", "summary.json"}
    for name in names - {"summary.json"}:
        with Image.open(out / name) as picture:
            assert picture.info["Description"].startswith("bundle go1-parkour")
    summary = json.loads((out / "summary.json").read_text())
    assert [row["terrain"] for row in summary["runs"]] == list(tiles())
    flat = {row["terrain"]: row["rmse_of_flat_ground_m"] for row in summary["runs"]}
    # Level 8 of the stairs is far from flat; that of rough ground is much nearer.
    assert flat["stairs_up"] > 2 * flat["rough"]
    assert summary["provenance"]["bundle_hash"]


def test_errors_by_hand():
    maps = np.zeros((WARM_UP + 2, 1, 2, HEIGHT_MAP_SIZE))
    maps[:WARM_UP] = 9.0  # Before the memory has warmed up: not counted.
    maps[WARM_UP:, 0, 1] = 0.3
    maps[WARM_UP:, 0, 0] = [[0.4], [0.2]]
    (row,) = errors(maps, ["gap"])
    assert (row["rmse_m"], row["rmse_of_flat_ground_m"]) == pytest.approx((0.1, 0.3))


@pytest.mark.parametrize(
    ("x", "y", "row", "column"),
    [(-1, 0, 0, -1), (0, -1, -1, 0), (-1, -1, 0, 0)],
    ids=["ahead right", "behind left", "ahead left"],
)
def test_ahead_is_up_and_left_is_left(x, y, row, column):
    values = np.zeros((len(HEIGHT_MAP_X), len(HEIGHT_MAP_Y)))
    values[x, y] = -0.5  # A robot's height over high ground is small.
    picture = as_seen(values.ravel())
    assert picture[row, column] == picture.sum() == 0.5
