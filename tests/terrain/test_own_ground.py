"""Own ground: what a file says is what a robot walks on, and what cannot be is told in a line."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from PIL import Image

from renet.errors import RenetError
from renet.terrain.height_map import interpolate, read_heights
from renet.terrain.own_ground import GroundFile
from renet.terrain.tiles import TILE, Tile


def tile_of(file: Path, **options) -> Tile:
    return GroundFile(file=file, **options).tile()


def surface(tile: Tile, difficulty: float, points: np.ndarray, seed: int = 0) -> np.ndarray:
    """Heights by MuJoCo's rays under points [K, 2] m from the middle of the built tile."""
    spec = mujoco.MjSpec()
    spec.worldbody.add_body(name="terrain")
    tile.function(difficulty, spec, np.random.default_rng(seed))
    return rays(spec.compile(), points + TILE / 2)


def rays(model: mujoco.MjModel, points: np.ndarray) -> np.ndarray:
    """Heights by MuJoCo's rays under points [K, 2] m of a model; 10 m for none."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    heights = []
    for x, y in points:
        eye, down, geom = np.array([x, y, 9.0]), np.array([0, 0, -1.0]), np.zeros(1, np.int32)
        heights.append(9.0 - mujoco.mj_ray(model, data, eye, down, None, 1, -1, geom))
    return np.array(heights)


def scene(folder: Path, body: str) -> Path:
    path = folder / "scene.xml"
    path.write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    return path


@pytest.fixture
def hills(tmp_path) -> Path:
    """A ridge along y at x = 2 m and a pit at x = -2 m, on ground at 0.5 m."""
    x = np.linspace(-4.0, 4.0, 81)
    line = 0.5 + 0.3 * np.exp(-((x - 2) ** 2)) - 0.2 * np.exp(-((x + 2) ** 2))
    file = tmp_path / "hills.npy"
    np.save(file, np.tile(line, (81, 1)))
    return file


PLACES = np.array([[2.0, 0.0], [-2.0, 0.0], [2.0, 2.5], [3.0, -1.0], [-3.0, 1.5]])


@pytest.mark.parametrize("level", [1, 10])
def test_a_robot_walks_on_the_heights_of_the_map(hills, level):
    share = level / 10
    x = PLACES[:, 0]
    wanted = 0.3 * np.exp(-((x - 2) ** 2)) - 0.2 * np.exp(-((x + 2) ** 2))
    heights = surface(tile_of(hills), (level - 1) / 9, PLACES)
    np.testing.assert_allclose(heights, share * wanted, atol=0.01)


def test_robots_start_on_level_ground_and_tiles_meet_at_zero(hills):
    tile = tile_of(hills)
    spec = mujoco.MjSpec()
    spec.worldbody.add_body(name="terrain")
    start = tile.function(1.0, spec, np.random.default_rng(0)).origin
    line = np.linspace(-0.45, 0.45, 7)
    pad = np.stack([line, line[::-1]], axis=1)
    np.testing.assert_allclose(surface(tile, 1.0, pad), start[2], atol=1e-4)
    edge = np.linspace(-3.9, 3.9, 14)
    for side in (-3.999, 3.999):
        rim = np.stack([np.full(14, side), edge], axis=1)
        assert np.abs(surface(tile, 1.0, rim)).max() < 2e-3
        assert np.abs(surface(tile, 1.0, rim[:, ::-1])).max() < 2e-3


def test_a_picture_is_seen_from_above(tmp_path):
    grey = np.zeros((81, 81), np.uint16)
    grey[5:25, 50:70] = 65535  # Up is +y, right is +x.
    file = tmp_path / "block.png"
    Image.fromarray(grey).save(file)
    heights = surface(tile_of(file, height=0.2), 1.0, np.array([[2.0, 2.5], [2.0, -2.5]]))
    np.testing.assert_allclose(heights, [0.2, 0.0], atol=1e-3)
    Image.fromarray((grey / 257).astype(np.uint8)).save(file)
    np.testing.assert_allclose(read_heights(file, 0.2).max(), 0.2)


def test_wide_maps_give_every_level_another_piece(tmp_path):
    file = tmp_path / "wide.npy"
    np.save(file, np.random.default_rng(1).uniform(0, 0.2, (201, 201)))
    tile = tile_of(file, width=40.0)
    first, again, other = (surface(tile, 1.0, PLACES, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 0.01


def test_interpolation_is_exact_for_planes():
    y, x = np.mgrid[0:5, 0:7]
    rows, columns = np.array([0.0, 1.3, 4.0]), np.array([0.25, 5.9, 6.0])
    found = interpolate(2.0 * y + 3.0 * x, rows, columns)
    np.testing.assert_allclose(found, 2.0 * rows[:, None] + 3.0 * columns[None])


def test_a_scene_is_cut_off_at_its_tile(tmp_path):
    body = """
        <geom type="plane" size="0 0 1" pos="0 0 -.1"/>
        <geom type="box" pos="2 0 .05" size=".5 50 .15"/>
        <geom type="box" pos="-2 0 .05" size=".5 .5 .15" euler="0 0 45"/>
        <geom type="box" pos="30 0 .05" size=".5 .5 .15"/>
        <geom type="box" pos="0 3 .05" size=".5 .5 .15" contype="0"/>"""
    tile = tile_of(scene(tmp_path, body))
    assert tile.begin == pytest.approx(-0.1)
    places = np.array([[2.0, 3.9], [-2.0, 0.65], [-2.0, 0.9], [0.0, 3.0]])
    np.testing.assert_allclose(surface(tile, 0.0, places), [0.2, 0.2, -0.1, -0.1], atol=1e-6)
    np.testing.assert_allclose(surface(tile, 0.0, np.array([[2.0, 4.1]])), [9.0 + 1.0], atol=1e-6)
    assert tile.measure(0.0) == tile.measure(1.0) == pytest.approx(0.3)


def test_a_scenes_height_field_keeps_its_heights(tmp_path):
    elevation = " ".join(f"{0.1 * row}" for row in range(5) for _ in range(4))
    path = tmp_path / "scene.xml"
    path.write_text(
        f"""<mujoco><asset><hfield name="h" nrow="5" ncol="4" size="1 1 .4 .1"
        elevation="{elevation}"/></asset><worldbody><geom type="plane" size="9 9 1"/>
        <geom type="hfield" hfield="h" pos="2 2 0"/></worldbody></mujoco>"""
    )
    places = np.array([[2.0, 1.2], [2.0, 2.0], [2.0, 2.8]])
    wanted = rays(mujoco.MjModel.from_xml_path(str(path)), places)
    assert np.ptp(wanted) == pytest.approx(0.32)
    np.testing.assert_allclose(surface(tile_of(path), 0.0, places), wanted, atol=1e-6)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("<geom type='sphere' size='1'/>", "is a sphere; training and studies know boxes"),
        ("<geom type='plane' size='9 9 1' euler='5 0 0'/>", "is a plane that is turned"),
        ("<geom type='box' size='1 1 1' pos='2 0 0'/>", "nothing carries a robot"),
        ("", "nothing carries a robot"),
        ("<body name='cat'><freejoint/><geom size='.1'/></body>", "its body 'cat' moves"),
        (
            "<geom type='plane' size='9 9 1'/>"
            "<geom name='beam' type='box' size='1 6 .1' euler='0 0 20'/>",
            "geom beam of the scene reaches beyond the 8 m square",
        ),
        ("<geom", "cannot use the scene"),
        ("<replicate count='1000000000'><geom size='1'/></replicate>", "needs more than"),
    ],
)
def test_scenes_that_cannot_be_are_told_in_a_line(tmp_path, body, message):
    with pytest.raises(RenetError, match=message) as told:
        tile_of(scene(tmp_path, body))
    assert "\n" not in str(told.value)


def saved(folder: Path, name: str, array: np.ndarray) -> Path:
    np.save(folder / name, array, allow_pickle=True)
    return folder / name


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((9, 9, 3)), r"has the shape \(9, 9, 3\): give rows and columns"),
        (np.zeros((1, 9)), "2 or more of each"),
        (np.full((9, 9), np.nan), "not finite: fill its holes"),
        (np.array([["a"]]), "must hold numbers"),
        (np.array([[{}]]), "no .npy of numbers"),
        (np.zeros((5, 9)), "8 m by 4 m, smaller than a tile of 8 m: .* --scene-width 16"),
    ],
)
def test_arrays_that_are_no_map_are_told_in_a_line(tmp_path, array, message):
    with pytest.raises(RenetError, match=message) as told:
        tile_of(saved(tmp_path, "map.npy", array))
    assert "\n" not in str(told.value)


def test_files_that_are_no_ground_are_told_in_a_line(tmp_path):
    for name, message in {
        "map.png": "no .png that Pillow reads",
        "map.npy": "no .npy of numbers",
        "map.csv": "is no ground: give a height map",
    }.items():
        (tmp_path / name).write_text("not what its name says")
        with pytest.raises(RenetError, match=message):
            tile_of(tmp_path / name)
    with pytest.raises(RenetError, match="cannot read the height map"):
        tile_of(tmp_path / "absent.npy")
    with pytest.raises(RenetError, match="must be positive"):
        tile_of(tmp_path / "map.npy", width=-1.0)
