import numpy as np
import pytest

from renet.faults import FAULTS, Frames
from renet.interface import DEPTH_RANGE, DEPTH_SHAPE, TICK_DT

IMAGES = np.random.default_rng(0).random((30, *DEPTH_SHAPE), np.float32)
"""Frames without likeness, so that each pixel tells where it is from."""
BEFORE = 3
"""Frames before a fault."""


def play(name: str, level: float, robots: int = 4) -> np.ndarray:
    """Images delivered from the fault's first frame on, [frames, robots, 48, 64]."""
    fault = FAULTS[name](level, [np.random.default_rng(n) for n in range(robots)])
    delivered = []
    for tick, image in enumerate(IMAGES):
        elapsed = (tick - BEFORE) * TICK_DT if tick >= BEFORE else -1.0
        frames = Frames.healthy(np.repeat(image[None], robots, axis=0))
        after = fault.corrupt(frames, np.full(robots, elapsed))
        assert after.fresh.all()
        assert not after.age.any()
        assert not after.invalid.any()
        delivered.append(after.image)
    return np.stack(delivered[BEFORE:])


LIVE = IMAGES[BEFORE:, None]


def test_a_mirrored_picture_is_a_mirror_image() -> None:
    np.testing.assert_array_equal(play("mirrored", 3.0, 1), LIVE[..., ::-1])


def test_a_picture_is_turned_about_its_middle() -> None:
    np.testing.assert_array_equal(play("turned", 180, 1), LIVE[..., ::-1, ::-1])
    image = np.zeros((1, *DEPTH_SHAPE), np.float32)
    image[0, 23:25, 40:44] = 1.0  # 8 to 11 pixels right of the middle.
    fault = FAULTS["turned"](90, [np.random.default_rng(0)])
    turned = fault.corrupt(Frames.healthy(image), np.zeros(1)).image[0]
    rows, columns = np.nonzero(turned)
    assert len(rows) == 8
    assert np.abs(columns - 31.5).max() == 0.5
    assert sorted({*np.abs(rows - 23.5).tolist()}) == [8.5, 9.5, 10.5, 11.5]


def test_split_reorders_rows() -> None:
    split = play("split", 0.25, 1)
    np.testing.assert_array_equal(split[:, :, 12:], LIVE[:, :, :36])
    np.testing.assert_array_equal(split[:, :, :12], LIVE[:, :, 36:])


@pytest.mark.parametrize("share", [0.25, 0.5])
def test_half_frozen_keeps_a_band(share: float) -> None:
    images = play("half_frozen", share, 8)
    old = (images == IMAGES[BEFORE - 1]).all(axis=-1)
    assert (old ^ (images == LIVE).all(axis=-1)).all()
    assert (old == old[0]).all(), "the same rows in every frame"
    np.testing.assert_allclose(old[0].mean(axis=-1), share)
    edges = np.abs(np.diff(np.pad(old[0].astype(int), ((0, 0), (1, 1))), axis=-1)).sum(axis=-1)
    assert (edges == 2).all(), "one band"
    assert len({row.tobytes() for row in old[0]}) > 2, "elsewhere on each robot"


def test_temporal_filter_is_a_weighted_mean() -> None:
    share = 0.75
    images = play("temporal_filter", share, 1)[:, 0]
    for newest in (0, 1, 5, 20):
        ages = np.arange(newest + 1)
        weights = (1 - share) * share**ages
        past = IMAGES[BEFORE + newest - ages]
        mean = np.tensordot(weights, past, 1) + share ** (newest + 1) * IMAGES[BEFORE - 1]
        np.testing.assert_allclose(images[newest], mean, atol=1e-5)


def test_gain_drifts_both_ways() -> None:
    images = play("gain_drift", 20, 8)
    dark = LIVE < 0.4  # Double of it is within the range.
    factors = np.where(dark, images / LIVE, np.nan)
    low, high = np.nanmin(factors, axis=(2, 3)), np.nanmax(factors, axis=(2, 3))
    np.testing.assert_allclose(low, high, rtol=1e-4)
    grows = high[10] > 1
    assert set(grows.tolist()) == {True, False}
    np.testing.assert_allclose(low[0], 1.0, rtol=1e-5)
    np.testing.assert_allclose(low[10], np.where(grows, 1.2, 1 / 1.2), rtol=1e-5)
    wild = play("gain_drift", 200, 8)[-1] / LIVE[-1]
    np.testing.assert_allclose(np.median(wild[~grows], axis=(1, 2)), 0.5, rtol=1e-5)
    np.testing.assert_allclose(wild[grows][:, LIVE[-1, 0] < 0.4], 2.0, rtol=1e-5)


def test_depth_wraps_to_the_remainder() -> None:
    metres = np.linspace(0.1, 2.0, 64)
    image = np.repeat(metres[None, None] / DEPTH_RANGE, DEPTH_SHAPE[0], axis=1).astype(np.float32)
    fault = FAULTS["wrap_around"](0.75, [np.random.default_rng(0)])
    wrapped = fault.corrupt(Frames.healthy(image), np.zeros(1)).image[0, 0] * DEPTH_RANGE
    expected = metres - 0.75 * ((metres >= 0.75).astype(int) + (metres >= 1.5))
    np.testing.assert_allclose(wrapped[:-1], expected[:-1], atol=1e-5)
    assert wrapped[-1] == 2.0


@pytest.mark.parametrize("step", [64, 256])
def test_quantised_depth_is_terrace_middle(step: float) -> None:
    metres = np.linspace(0.05, 1.9, 64)
    image = np.repeat(metres[None, None] / DEPTH_RANGE, DEPTH_SHAPE[0], axis=1).astype(np.float32)
    fault = FAULTS["quantised"](step, [np.random.default_rng(0)])
    after = fault.corrupt(Frames.healthy(image), np.zeros(1)).image[0, 0] * 1e3 * DEPTH_RANGE
    terraces = after / step - 0.5
    np.testing.assert_allclose(terraces, np.round(terraces), atol=1e-3)
    errors = np.abs(after - 1e3 * metres)
    assert 0.4 * step < errors.max() <= 0.5 * step + 1e-2


def test_stray_light_moves_depths_by_share() -> None:
    images = play("stray_light", 0.35)
    source = (images - 0.65 * LIVE) / 0.35
    assert np.ptp(source, axis=(0, 2, 3)).max() < 1e-5
    metres = source[0, :, 0, 0] * DEPTH_RANGE
    assert 0.1 <= metres.min() < metres.max() <= 0.5
