"""The README's film: whole, and of the story that its caption tells."""

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageSequence

from renet.evaluation.video import DARK_GREEN, DARK_RED
from renet.palette import REMEMBERS_COLOUR, SEES_COLOUR, rgb
from tests.browser import compare

FILM = Path(__file__).parents[1] / "docs" / "figures" / "walk.webp"


@pytest.fixture(scope="module")
def pictures() -> np.ndarray:
    """[T, height, width, 3]"""
    with Image.open(FILM) as film:
        frames = [np.asarray(frame.convert("RGB"), float) for frame in ImageSequence.Iterator(film)]
    return np.stack(frames)


def chips(pictures: np.ndarray) -> np.ndarray:
    """Colours of the states beside both robots' titles, [T, 2, 3]."""
    width = pictures.shape[2] // 2
    boxes = [
        pictures[:, 3:6, side * width + width - 80 : side * width + width - 10] for side in (0, 1)
    ]
    return np.stack([box.mean(axis=(1, 2)) for box in boxes], axis=1)


def test_it_is_small_and_no_picture_is_blank_or_stands_still(pictures: np.ndarray) -> None:
    assert FILM.stat().st_size < 2.5e6
    count, height, width, _ = pictures.shape
    assert count >= 60
    assert (height, width) == (300, 800)
    for half in (pictures[:, :, : width // 2], pictures[:, :, width // 2 :]):
        assert half.std(axis=(1, 2, 3)).min() > 20
    right = pictures[:-1, :, width // 2 :]  # At last the robot has left its tile, and stands.
    assert np.abs(np.diff(right, axis=0)).mean(axis=(1, 2, 3)).min() > 0.5


def test_the_right_robot_remembers_and_the_left_one_believes_and_falls(
    pictures: np.ndarray,
) -> None:
    left, right = np.moveaxis(chips(pictures), 1, 0)

    def near(colours: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
        return np.abs(colours - colour).max(axis=1) < 25

    fell, crossed = near(left, DARK_RED), near(right, DARK_GREEN)
    assert (near(left, rgb(SEES_COLOUR)) | fell).all(), "it takes its last image for sight"
    assert near(right[0:5], rgb(SEES_COLOUR)).all()
    assert (near(right[30:], rgb(REMEMBERS_COLOUR)) | crossed[30:]).all()
    # Each half says how it ended, in the last second at least, and to the end.
    for outcome in (fell, crossed):
        assert outcome[-12:].all()
        assert not outcome[:30].any()
    assert 12 <= crossed.sum() <= 16, "it ends about a second after the right robot has crossed"
    # Once it has fallen its picture stops, and is dim beside the other's.
    width = pictures.shape[2] // 2
    between = pictures[fell, 120:240]
    assert between[:, :, :width].mean() < 0.6 * between[:, :, width:].mean()
    changes = np.abs(np.diff(pictures[:, 24:-24, :width], axis=0)).mean(axis=(1, 2, 3))
    assert changes[:30].min() > 0.5
    assert changes[-5:].max() < 0.5


def test_start_leap_fall_and_end_look_like_their_golden_pictures(pictures: np.ndarray) -> None:
    """Below one another; the file decodes to the same pictures everywhere."""
    chosen = np.concatenate(pictures[[0, 29, 58, -1]]).astype(np.uint8)
    Image.fromarray(chosen).save(stream := io.BytesIO(), "PNG")
    compare(stream.getvalue(), FILM.parents[2] / "tests" / "golden" / "film.png", worst=6.0)
