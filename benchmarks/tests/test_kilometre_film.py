"""The film of the long walk: which robots it shows, and which of their steps."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from PIL import Image

import kilometre_film
from kilometre_film import Visit, clip, pair
from renet.errors import RenetError
from renet.evaluation.trace import Film, Trace
from renet.interface import HEIGHT_MAP_SIZE

STEPS = 60


def walk():
    """Two robots: one is in section 1 from step 8 to 29, the other falls in it in step 21."""
    section = np.zeros((STEPS, 2), int)
    section[8:, 0] = 1
    section[30:, 0] = 2
    section[3:, 1] = 1
    section[21:, 1] = 2
    trace = Trace.empty(STEPS, 2)
    trace.fell[21, 1] = trace.ended[21, 1] = True
    trace.vision[:, 0] = True
    trace.failing[12:, 0] = True
    poses = np.zeros((STEPS, 2, 7))
    poses[..., 3] = 1.0
    # Poses and images say of which step, tick and robot they are.
    poses[:, 0, 0] = np.arange(STEPS)
    poses[:, 1, 0] = -np.arange(STEPS)
    images = np.zeros((STEPS // 5, 2, 48, 64), np.uint8)
    images[:, 0] = np.arange(STEPS // 5)[:, None, None]
    maps = np.zeros((STEPS // 5, 2, HEIGHT_MAP_SIZE))
    film = Film(poses, images, maps, maps > 0.0)
    position = np.cumsum(np.full((STEPS, 2), 0.1), axis=0)
    finished = np.zeros((STEPS, 2), bool)
    finished[50:, 0] = True
    return Visit(replace(trace, film=film), section, position, finished)


def test_each_robot_is_shown_from_its_own_beginning_of_a_section():
    cut = clip(walk(), 1, [0, 1], start=0.5)
    # From the first tick in the section on, up to the step in which it is left or ends.
    shown = cut.film.poses[:, :, 0]
    np.testing.assert_array_equal(shown[:21, 0], np.arange(10, 31))
    np.testing.assert_array_equal(shown[:17, 1], -np.arange(5, 22))
    np.testing.assert_array_equal(cut.film.images[:4, 0, 0, 0], (2, 3, 4, 5))
    np.testing.assert_array_equal(cut.failing[:4, 0], (False, False, True, True))
    assert cut.travelled[0, 0] == pytest.approx(1.1 - 0.5)


def test_who_is_through_or_fell_stays_in_the_last_picture():
    cut = clip(walk(), 1, [0, 1], start=0.5)
    assert len(cut.fell) == 21 + 50
    assert set(cut.film.poses[20:, 0, 0]) == {30.0}
    assert set(cut.film.poses[16:, 1, 0]) == {-21.0}
    np.testing.assert_array_equal(cut.fallen[-1], (False, True))
    assert not cut.fallen[15, 1]
    # Where it is set down after a fall is not where it fell.
    assert cut.travelled[-1, 1] == cut.travelled[15, 1]


def test_the_laps_last_section_ends_where_the_lap_does():
    visit = walk()
    np.testing.assert_array_equal(visit.steps(2, 0)[[0, -1]], (35, 50))


def test_a_walk_that_ends_too_early_is_told():
    with pytest.raises(RenetError, match="has not come to its sections"):
        clip(walk(), 3, [0, 1], start=0.0)


def test_the_pair_shows_the_largest_difference():
    ends = np.full((2, 3, 4), "crossed", object)
    ends[1, 1, 2] = "stuck"
    ends[1, 2, :2] = "fell"
    ends[0, 2, 3] = "fell"
    assert pair(ends) == 2


def test_a_film_is_written(tmp_path, monkeypatch):
    monkeypatch.setattr(kilometre_film, "SHOWN", ("gaps",))
    panels = [np.full((30, 40, 3), value, np.uint8) for value in (0, 200)]
    monkeypatch.setattr(kilometre_film, "pictures", lambda *given: iter(panels))
    starts = np.array((0.0, 0.5, 2.0))
    out = kilometre_film.write(
        tmp_path / "a.webp", mujoco.MjSpec(), walk(), {"memory": 0, "blind": 1}, {"gaps": 1}, starts
    )
    with Image.open(out) as image:
        assert image.n_frames == 2
