"""Real images against the rays of training, by hand and by projection."""

import numpy as np
import pytest

from renet.camera import Intrinsics
from renet.deploy.cameras.preprocess import DepthPreprocessor, fill_holes
from renet.errors import RenetError
from renet.training.export import camera_spec

LENS = Intrinsics(480, 848, 446.8, 446.8, 424.0, 240.0)
"""87 degrees across."""
PREPROCESSOR = DepthPreprocessor(LENS, camera_spec())


def test_every_pixel_is_taken_where_training_casts_its_ray():
    rows, columns = np.mgrid[: LENS.height, : LENS.width]
    rays = Intrinsics().rays().reshape(48, 64, 3)
    left = (LENS.cx - 0.5 - columns) / LENS.fx
    up = (LENS.cy - 0.5 - rows) / LENS.fy
    half_pixel = 0.5 / LENS.fx
    for direction, axis in ((left, 1), (up, 2)):
        seen = PREPROCESSOR.image(direction + 1.0)
        np.testing.assert_allclose(seen, (rays[..., axis] + 1) / 2, atol=half_pixel)


def test_a_camera_that_is_upside_down_shows_the_same():
    random = np.random.default_rng(0)
    lens = Intrinsics(480, 848, 446.8, 446.8, 420.0, 243.0)
    turned = Intrinsics(480, 848, 446.8, 446.8, 848 - 420.0, 480 - 243.0)
    upright = DepthPreprocessor(lens, camera_spec())
    upside_down = DepthPreprocessor(turned, camera_spec(), upside_down=True)
    depth = random.uniform(0.0, 2.0, (480, 848)) * (random.random((480, 848)) > 0.1)
    np.testing.assert_array_equal(upside_down.image(depth[::-1, ::-1]), upright.image(depth))
    assert upside_down.invalid(depth[::-1, ::-1]) == upright.invalid(depth)


def test_clipping_and_holes():
    depth = np.full((480, 848), 7.0)
    depth[:, 424:] = 0.0
    depth[300:] = 0.5
    image = PREPROCESSOR.image(depth)
    assert set(np.unique(image)) == {np.float32(0.25), np.float32(1.0)}


def test_holes_take_the_nearest_depth_around():
    image = np.array(
        [
            [3.0, 3.0, 3.0, 3.0, 9.0],
            [3.0, 0.0, 2.0, 0.0, 9.0],
            [3.0, 3.0, 3.0, 0.0, 0.0],
            [3.0, 3.0, 3.0, 0.0, 0.0],
        ]
    )
    expected = image.copy()
    expected[1, 1] = 2.0
    expected[1, 3] = expected[2, 3] = 2.0
    expected[2, 4] = 9.0  # Its only neighbours with a measurement are in the row above.
    expected[3, 3] = 3.0
    expected[3, 4] = 2.0  # Filled in the second round, from what the first one left.
    np.testing.assert_array_equal(fill_holes(image), expected)


def test_an_image_of_holes_alone_stays():
    assert (fill_holes(np.zeros((4, 4))) == 0.0).all()
    assert (PREPROCESSOR.image(np.zeros((480, 848))) == 1.0).all()


def test_scattered_holes_change_little():
    rows = np.linspace(2.0, 0.5, 480)[:, None].repeat(848, axis=1)
    holes = np.random.default_rng(0).random(rows.shape) < 0.02
    spoilt = PREPROCESSOR.image(np.where(holes, 0.0, rows))
    assert np.abs(spoilt - PREPROCESSOR.image(rows)).max() < 0.05


def test_only_the_policys_view_counts_as_invalid():
    raw = np.ones((480, 848), np.uint16)
    raw[:, :100] = 0
    assert PREPROCESSOR.invalid(raw) == 0.0
    raw[:240] = 0
    assert PREPROCESSOR.invalid(raw) == pytest.approx(0.5, abs=0.01)


def test_a_narrow_camera_is_refused():
    for side, focal in (("wide", (900.0, 446.8)), ("high", (446.8, 900.0))):
        with pytest.raises(RenetError, match=f"not {side} enough"):
            DepthPreprocessor(Intrinsics(480, 848, *focal, 424.0, 240.0), camera_spec())


def test_an_image_of_another_size_than_its_lens_is_refused():
    for look in (PREPROCESSOR.image, PREPROCESSOR.invalid):
        with pytest.raises(RenetError, match=r"\(240, 424\) rows and columns"):
            look(np.ones((240, 424)))
