import numpy as np
import pytest

from renet.camera import Intrinsics
from renet.faults import FAULTS, Frames
from renet.faults.stereo import BASELINE, FOCAL, smooth_surface
from renet.faults.vegetation import NEAR_RANGE
from renet.interface import DEPTH_RANGE, DEPTH_SHAPE


def spoil(name: str, level: float, image: np.ndarray, robots: int = 6) -> Frames:
    rngs = [np.random.default_rng(n) for n in range(robots)]
    given = np.repeat(image[None].astype(np.float32), robots, axis=0)
    return FAULTS[name](level, rngs).corrupt(Frames.healthy(given), np.zeros(robots))


def floor() -> np.ndarray:
    """A plane 33 cm below a camera that looks 30 degrees down, capped at the camera's range."""
    _, up = Intrinsics().axes()
    drop = np.sin(np.radians(30)) - up * np.cos(np.radians(30))
    depth = 0.33 / np.maximum(drop, 1e-3)
    return np.minimum(depth / DEPTH_RANGE, 1.0)[:, None] * np.ones(DEPTH_SHAPE[1])


@pytest.mark.parametrize("baseline", [25, 50, 100])
def test_edge_shadow_is_left_and_wide(baseline: float) -> None:
    image = np.full(DEPTH_SHAPE, 0.9)
    image[10:30, 30:50] = 0.2
    frames = spoil("edge_shadow", baseline, image, robots=1)
    holes = frames.image[0] == 0
    width = int(FOCAL * 1e-3 * baseline * (1 / 0.4 - 1 / 1.8))
    assert width >= 1
    # The median rounds the corners of the box; its middle rows are exact.
    columns = np.arange(DEPTH_SHAPE[1])
    assert (holes[15:25] == ((columns >= 30 - width) & (columns < 30))).all()
    assert frames.invalid[0] == holes.mean()
    assert (spoil("edge_shadow", 150, floor()).image > 0).all(), "a plane has no shadow"


@pytest.mark.parametrize("step", [0.05, 0.2])
def test_disparities_are_rounded_to_steps(step: float) -> None:
    image = floor()
    after = spoil("disparity_steps", step, image, robots=1).image[0].astype(float)
    inside = (image < 1) & (after < 1)
    scale = FOCAL * BASELINE / DEPTH_RANGE
    steps = scale / after[inside] / step
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-3)
    assert np.abs(scale / after[inside] - scale / image[inside]).max() <= step / 2 + 1e-4
    np.testing.assert_array_equal(after[image == 1], 1)


@pytest.mark.parametrize("share", [0.1, 0.45, 0.9])
def test_textureless_keeps_edges(share: float) -> None:
    image = floor()
    image[5:25, 30:45] = 0.2  # A box.
    frames = spoil("textureless", share, image)
    holes, smooth = frames.image == 0, smooth_surface(image)
    assert 0.6 < smooth.mean() < 1
    assert not holes[:, ~smooth].any()
    assert holes[:, smooth].mean() == pytest.approx(share, abs=0.01)
    np.testing.assert_allclose(frames.invalid, holes.mean(axis=(1, 2)))
    neighbours = (holes[:, :, 1:] & holes[:, :, :-1]).mean() / holes.mean()
    assert neighbours > 0.75, "patches, not single pixels"


def test_sensor_grain_does_not_make_ground_rough() -> None:
    grain = np.random.default_rng(0).normal(0, 0.005, DEPTH_SHAPE)
    assert smooth_surface(floor() + grain).mean() > 0.75


def test_dense_grass_hides_more() -> None:
    image = floor().astype(np.float32)
    hidden, blind = [], []
    for level in FAULTS["tall_grass"].levels:
        frames = spoil("tall_grass", level, image, robots=12)
        assert (frames.image <= image + 1e-6).all()
        np.testing.assert_allclose(frames.invalid, (frames.image == 0).mean(axis=(1, 2)))
        hidden.append((frames.image != image).mean())
        blind.append(frames.invalid.mean())
    assert (np.diff([hidden, blind]) > 0).all()
    assert hidden[0] < 0.25 < 0.7 < hidden[-1]
    frames = spoil("tall_grass", 45, np.ones(DEPTH_SHAPE))
    measured = frames.image[(frames.image > 0) & (frames.image < 1)] * DEPTH_RANGE
    assert measured.min() >= NEAR_RANGE - 1e-6
    assert measured.max() > 0.5


def test_grass_flickers_on_the_ground() -> None:
    image = floor().astype(np.float32)[None]
    fault = FAULTS["tall_grass"](20, [np.random.default_rng(0)])
    first, second = (fault.corrupt(Frames.healthy(image), np.zeros(1)).image for _ in range(2))
    changed = (first != image) | (second != image)
    assert (first != second)[changed].mean() > 0.5
    frames = spoil("tall_grass", 90, np.ones(DEPTH_SHAPE), robots=40)
    measured = np.where(frames.image < 1, frames.image, 0)
    assert (measured <= floor() + 1e-6).all()
    # The bottom of the image looks at ground less than a metre away.
    far = (measured > 0.5).mean(axis=(0, 2))
    assert far[:12].sum() > 0
    assert far[-12:].sum() == 0
