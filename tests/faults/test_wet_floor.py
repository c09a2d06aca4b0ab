import numpy as np
import pytest

from renet.faults import FAULTS, Frames
from renet.faults.wet_floor import STREAK
from renet.interface import DEPTH_SHAPE, TICK_DT

from .test_stereo import floor

FLOOR = floor().astype(np.float32)


def play(name: str, level: float, image: np.ndarray = FLOOR, ticks: int = 20, robots: int = 6):
    """Which pixels a fault changes, [ticks, robots, 48, 64]; all of them read the farthest."""
    fault = FAULTS[name](level, [np.random.default_rng(n) for n in range(robots)])
    given = Frames.healthy(np.repeat(image[None], robots, axis=0))
    images = [fault.corrupt(given, np.full(robots, t * TICK_DT)).image for t in range(ticks)]
    changed = np.stack(images) != image
    assert (np.stack(images)[changed] == 1.0).all()
    return changed


def test_each_lamp_is_one_streak() -> None:
    streaks = play("floor_reflection", 1)
    edge = np.argmax(FLOOR[:, 0] < 0.97)
    rows, columns = streaks.any(axis=3), streaks.any(axis=2)
    assert rows[..., edge : edge + STREAK[0]].all()
    np.testing.assert_array_equal(rows.sum(axis=2), STREAK[0])
    np.testing.assert_array_equal(columns.sum(axis=2), STREAK[1])
    left = columns.argmax(axis=2)
    assert 3 <= np.ptp(left, axis=0).max() <= 8
    assert len(set(left[0].tolist())) > 2
    shares = [play("floor_reflection", lamps, robots=30).mean() for lamps in (1, 2, 3, 4, 6)]
    assert (np.diff(shares) > 0).all()
    assert not play("floor_reflection", 6, np.ones(DEPTH_SHAPE, np.float32)).any(), "no floor"


@pytest.mark.parametrize("width", [0.25, 0.6])
def test_wet_patch_has_width_and_approaches(width: float) -> None:
    wet = play("wet_patch", width, ticks=40, robots=20)
    assert wet.any(axis=(0, 2, 3)).all()
    # The floor below pixel (r, c) is depth * (c - middle) / focal length to the right of the axis.
    metres = floor() * 2.0 * (np.arange(64) - 31.5) / (32 / 0.65)
    across = np.where(wet, metres, np.nan)
    whole = wet.any(axis=2)[..., [0, -1]].sum(axis=-1) == 0  # Within the image.
    widths = (np.nanmax(across, axis=(2, 3)) - np.nanmin(across, axis=(2, 3)))[whole]
    assert widths.max() == pytest.approx(width, abs=0.05)
    lowest = np.where(wet.any(axis=3), np.arange(48), -1).max(axis=2)
    moved = np.diff(lowest, axis=0)
    assert (moved >= 0).mean() > 0.9
    assert moved.max() > 0


def test_a_box_before_a_patch_hides_it() -> None:
    boxed = FLOOR.copy()
    boxed[:, 20:44] = np.minimum(boxed[:, 20:44], 0.1)
    changed = play("wet_patch", 0.6, boxed)
    assert not changed[..., 20:44].any()
    assert changed.any()
