from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from renet.errors import RenetError
from renet.faults import FAULTS, SEVERITIES, Frames, Injection, Injector, PhysicalFault
from renet.faults.image import fill_holes, shifted
from renet.interface import DEPTH_SHAPE, TICK_DT

SENSOR_FAULTS = [name for name, fault in FAULTS.items() if not issubclass(fault, PhysicalFault)]


def ground(n: int, tick: int = 0) -> np.ndarray:
    """Something like a floor seen at a slant and a box, with grain that differs every frame."""
    rows = np.linspace(0.95, 0.03, DEPTH_SHAPE[0])[:, None] * np.ones(DEPTH_SHAPE[1])
    rows[8:20, 30:40] = 0.2  # A box, whose edges cast shadows.
    grain = np.random.default_rng(tick).normal(0, 0.005, (n, *DEPTH_SHAPE))
    return np.clip(rows + grain, 0.01, 1).astype(np.float32)


def play(injections: list[Injection], n: int = 2, ticks: int = 20, seed: int = 0) -> list[Frames]:
    injector = Injector([tuple(injections)] * n, range(n), seed)
    rate = np.tile(np.array([0.0, 0.6, -0.4]), (n, 1))
    return [injector.apply(Frames.healthy(ground(n, t), rate), 5 * t) for t in range(ticks)]


def spoilt(fault: str, level: float, n: int = 4) -> tuple[np.ndarray, Frames]:
    injector = Injector([(Injection(fault, level, onset=0),)] * n, range(n), 1)
    return ground(n), injector.apply(Frames.healthy(ground(n)), 0)


@pytest.mark.parametrize("fault", SENSOR_FAULTS)
@pytest.mark.parametrize("severity", SEVERITIES)
def test_every_fault_spoils_after_its_onset_and_only_then(fault: str, severity: int) -> None:
    frames = play([Injection.of(fault, severity, onset=25)])
    for t, frame in enumerate(frames):
        assert frame.image.shape == (2, *DEPTH_SHAPE)
        assert frame.image.dtype == np.float32
        assert frame.image.min() >= 0
        assert frame.image.max() <= 1
        if t < 5:
            np.testing.assert_array_equal(frame.image, ground(2, t))
            assert frame.fresh.all()
    assert any(np.any(f.image != ground(2, t)) for t, f in enumerate(frames[5:], start=5))


@pytest.mark.parametrize("name", SENSOR_FAULTS)
def test_robots_it_is_not_at_work_on_keep_their_frames(name: str) -> None:
    fault = FAULTS[name](FAULTS[name].level_of(5), [np.random.default_rng(n) for n in range(2)])
    for tick in range(20):
        given = Frames.healthy(ground(2, tick), np.array([[0.0, 0.6, -0.4]] * 2))
        after = fault.corrupt(given, np.array([tick * TICK_DT, -1.0]))
        for field, value in vars(after).items():
            np.testing.assert_array_equal(value[1], getattr(given, field)[1])
        np.testing.assert_array_equal(given.image, ground(2, tick), "the input is not changed")


@pytest.mark.parametrize("fault", SENSOR_FAULTS)
def test_a_fault_of_limited_duration_leaves_no_trace(fault: str) -> None:
    frames = play([Injection.of(fault, 3, onset=25, duration=0.5)])
    for t in range(10, 20):
        np.testing.assert_array_equal(frames[t].image, ground(2, t))
        assert frames[t].fresh.all()


@pytest.mark.parametrize("fault", SENSOR_FAULTS)
def test_robots_draw_their_own_noise_by_stream_and_seed(fault: str) -> None:
    once, again = (play([Injection.of(fault, 4, onset=0)], seed=3) for _ in range(2))
    injector = Injector([(Injection.of(fault, 4, onset=0),)], [1], 3)
    for t, (a, b) in enumerate(zip(once, again, strict=True)):
        np.testing.assert_array_equal(a.image, b.image)
        rate = np.array([[0.0, 0.6, -0.4]])
        alone = injector.apply(Frames.healthy(ground(2, t)[1:], rate), 5 * t)
        np.testing.assert_array_equal(alone.image[0], a.image[1])


@pytest.mark.parametrize("sigma", [0.05, 0.1])
def test_gaussian_has_the_stated_deviation(sigma: float) -> None:
    injector = Injector([(Injection("gaussian", sigma, 0),)] * 8, range(8), 0)
    image = injector.apply(Frames.healthy(np.full((8, *DEPTH_SHAPE), 0.5)), 0).image
    assert image.mean() == pytest.approx(0.5, abs=0.002)
    assert image.std() == pytest.approx(sigma, rel=0.02)


def test_salt_and_pepper_hits_the_stated_share_half_each() -> None:
    injector = Injector([(Injection("salt_and_pepper", 0.3, 0),)] * 8, range(8), 0)
    image = injector.apply(Frames.healthy(np.full((8, *DEPTH_SHAPE), 0.5)), 0).image
    assert (image == 0).mean() == pytest.approx(0.15, abs=0.01)
    assert (image == 1).mean() == pytest.approx(0.15, abs=0.01)


def test_blackout_fades_linearly_to_zero() -> None:
    frames = play([Injection("blackout", 0.5, onset=0)], ticks=8)
    for t in range(8):
        remaining = max(1 - t * TICK_DT / 0.5, 0)
        np.testing.assert_allclose(frames[t].image, ground(2, t) * remaining, atol=1e-6)


@pytest.mark.parametrize("fault", ["saturated", "occlusion"])
@pytest.mark.parametrize("share", [0.25, 0.5, 1.0])
def test_covered_share_is_as_stated(fault: str, share: float) -> None:
    before, after = spoilt(fault, share)
    assert (after.image != before).mean() == pytest.approx(share, abs=0.02)


def test_glare_holes_read_zero_and_raise_the_invalid_fraction_filled_or_not() -> None:
    before, raw = spoilt("glare", 0.3)
    _, filled = spoilt("glare_filled", 0.3)
    holes = raw.image == 0
    assert holes.mean() == pytest.approx(0.3, abs=0.01)
    np.testing.assert_array_equal(raw.invalid, holes.mean(axis=(1, 2)))
    np.testing.assert_array_equal(filled.invalid, raw.invalid)
    assert filled.image.min() > 0
    np.testing.assert_array_equal(filled.image[~holes], before[~holes])
    # Correlated: a hole's neighbour is mostly a hole too.
    assert (holes[:, :, 1:] & holes[:, :, :-1]).mean() / holes.mean() > 0.8


def test_near_field_turns_what_is_closer_into_holes() -> None:
    before, after = spoilt("near_field", 0.5)
    near = before < 0.25
    assert (after.image[near] == 0).all()
    np.testing.assert_array_equal(after.image[~near], before[~near])
    np.testing.assert_allclose(after.invalid, near.mean(axis=(1, 2)))


def test_wrong_scale_multiplies_and_caps() -> None:
    before, after = spoilt("wrong_scale", 1.3)
    np.testing.assert_allclose(after.image, np.minimum(before * 1.3, 1), rtol=1e-6)


def test_frozen_repeats_the_last_image_as_a_fresh_frame() -> None:
    frames = play([Injection("frozen", 0.5, onset=25)])
    for t in range(5, 10):
        np.testing.assert_array_equal(frames[t].image, ground(2, 4))
        assert frames[t].fresh.all()
        assert (frames[t].age == 0).all()
    np.testing.assert_array_equal(frames[10].image, ground(2, 10))


def test_unplugged_delivers_nothing_and_ages_until_it_returns() -> None:
    frames = play([Injection("unplugged", 1.0, onset=25)])
    for t in range(5, 15):
        np.testing.assert_array_equal(frames[t].image, ground(2, 4))
        assert not frames[t].fresh.any()
        np.testing.assert_allclose(frames[t].age, (t - 4) * TICK_DT)
    assert frames[15].fresh.all()
    np.testing.assert_array_equal(frames[15].image, ground(2, 15))


def test_dropped_loses_the_stated_share() -> None:
    frames = play([Injection("dropped", 0.3, onset=0)], n=40, ticks=50)
    assert 1 - np.mean([f.fresh for f in frames]) == pytest.approx(0.3, abs=0.04)


def test_latency_serves_an_image_as_old_as_stated() -> None:
    frames = play([Injection("latency", 200, onset=0)], n=8, ticks=30)
    ages = []
    for t in range(8, 30):
        for i in range(8):
            match = [k for k in range(t + 1) if np.array_equal(frames[t].image[i], ground(8, k)[i])]
            ages.append((t - match[0]) * TICK_DT)
    # Delays of 0.1 to 0.3 s on a 0.1 s grid; a newer frame may overtake.
    assert min(ages) >= 0.1 - 1e-9
    assert max(ages) <= 0.4 + 1e-9
    assert 0.15 < np.mean(ages) < 0.3


def test_motion_blur_moves_the_image_by_rate_times_exposure() -> None:
    edge = np.zeros((1, *DEPTH_SHAPE), np.float32)
    edge[:, :, 32:] = 1
    injector = Injector([(Injection("motion_blur", 40, 0),)], [0], 0)
    blurred = injector.apply(Frames.healthy(edge, np.array([[0.0, 0.0, 3.0]])), 0).image[0, 0]
    width = 1 / np.abs(np.diff(blurred)).max()
    # 66 degrees across 64 columns.
    assert width == pytest.approx(3.0 * 0.04 * 32 / np.tan(np.radians(33)), abs=1.0)
    still = injector.apply(Frames.healthy(edge), 0).image
    np.testing.assert_allclose(still, edge, atol=1e-6)


def test_shifted_moves_whole_pixels_exactly() -> None:
    image = ground(1)[0]
    np.testing.assert_allclose(shifted(image, 2, -3)[2:, :-3], image[:-2, 3:], rtol=1e-6)


def test_fill_holes_takes_the_left_then_the_right_then_the_row_above() -> None:
    image = np.array([[1.0, 2, 3], [4, 5, 6], [7, 8, 9]])
    holes = np.array([[0, 1, 1], [1, 0, 1], [1, 1, 1]], bool)
    np.testing.assert_array_equal(fill_holes(image, holes), [[1, 1, 1], [5, 5, 5], [5, 5, 5]])


def test_faults_compose_in_order() -> None:
    frames = play([Injection("saturated", 1.0, 0), Injection("wrong_scale", 0.5, 25)], ticks=8)
    assert (frames[4].image == 1).all()
    assert (frames[6].image == 0.5).all()


def test_a_fault_comes_again_on_time_and_without_flicker() -> None:
    injection = Injection("gaussian", 1.0, onset=100, duration=0.1, period=0.4)
    at_work = np.array([injection.at_work(step) for step in range(600)])
    np.testing.assert_array_equal(np.flatnonzero(at_work[::5]) * 5, np.arange(100, 600, 20))
    assert at_work.sum() == 25 * 5


def test_injector_knows_who_is_failing() -> None:
    schedules = [(Injection("frozen", 0.2, 10),), (), (Injection("gaussian", 1, 20),)]
    injector = Injector(schedules, range(3), 0)
    assert injector.at_work(10).tolist() == [True, False, False]
    assert injector.at_work(20).tolist() == [False, False, True]
    assert not Injection("frozen", 0.2, 10).at_work(20)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: Injection("smoke", 1.0),
        lambda: Injection.of("gaussian", 6),
        lambda: Injection("gaussian", 1.0, onset=-1),
        lambda: Injection("gaussian", 1.0, duration=0),
        lambda: Injector([(Injection.of("foam", 3),)], [0], 0),
    ],
)
def test_what_no_model_stands_for_is_refused(wrong) -> None:
    with pytest.raises(RenetError):
        wrong()


@given(
    onset=st.integers(0, 100),
    duration=st.floats(0.02, 3),
    gap=st.floats(0, 3),
    step=st.integers(0, 1000),
)
@settings(max_examples=200)
def test_elapsed_is_within_the_duration_or_off(onset, duration, gap, step) -> None:
    injection = Injection("gaussian", 1.0, onset, duration, duration + gap)
    elapsed = injection.elapsed(step)
    assert elapsed == -1 or 0 <= elapsed < duration
    if step < onset:
        assert elapsed == -1
    if step == onset:
        assert elapsed == 0


@pytest.mark.parametrize("kind", ["blackout", "frozen", "glare"])
@pytest.mark.parametrize("severity", SEVERITIES)
def test_an_intermittent_fault_is_on_for_the_stated_part_of_every_second(kind, severity) -> None:
    injection = Injection.of(f"intermittent_{kind}", severity, onset=25)
    frames = play([injection], ticks=40)
    changed = [bool((f.image != ground(2, t)).any()) for t, f in enumerate(frames)]
    on = round(10 * injection.level)
    assert changed == [t >= 5 and (t - 5) % 10 < on for t in range(40)]
    for t in range(5, 40):
        if kind == "frozen" and changed[t]:
            before = 5 + (t - 5) // 10 * 10 - 1
            np.testing.assert_array_equal(frames[t].image, ground(2, before))


def test_lost_frames_show_the_glare_of_the_last_delivered_one() -> None:
    frames = play([Injection.of("glare_dropped", 4, onset=25)], ticks=40)[5:]
    glare = FAULTS["glare"].level_of(4)
    assert all(f.invalid[f.fresh] == pytest.approx(glare, abs=1e-3) for f in frames)
    lost = 1 - np.mean([f.fresh for f in frames])
    assert lost == pytest.approx(FAULTS["dropped"].level_of(4), abs=0.15)
    for before, after in pairwise(frames):
        held = ~after.fresh
        np.testing.assert_array_equal(after.image[held], before.image[held])


def test_two_faults_spoil_what_both_alone_spoil() -> None:
    late = play([Injection.of("blobs_latency", 5, onset=25)], ticks=31)[30].image
    blobs = play([Injection.of("blobs", 5, onset=25)], ticks=6)[5].image
    dirty = blobs != ground(2, 5)
    # Pixels of the lens are covered, and the ground beside them is one of an earlier frame.
    np.testing.assert_array_equal(late[dirty], blobs[dirty])
    clean = ~dirty[0]
    matches = [k for k in range(31) if np.array_equal(late[0][clean], ground(2, k)[0][clean])]
    assert matches[0] < 30
    assert FAULTS["blobs_latency"].describe(5) == "30 blobs + 500 ms"
