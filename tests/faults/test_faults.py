from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from renet.deploy.robots.sim.scene import build_scene
from renet.errors import RenetError
from renet.faults import (
    FAULTS,
    SEVERITIES,
    Frames,
    Injection,
    Injector,
    PhysicalFault,
    parse_fault,
)
from renet.faults.image import fill_from_left, shifted
from renet.faults.physical import choose_evenly, obstacles
from renet.interface import DEPTH_SHAPE, TICK_DT

SENSOR_FAULTS = [name for name, fault in FAULTS.items() if not issubclass(fault, PhysicalFault)]


def ground(n: int, tick: int = 0) -> np.ndarray:
    """Something like a floor seen at a slant and a box, with grain that differs every frame."""
    rows = np.linspace(0.95, 0.03, DEPTH_SHAPE[0])[:, None] * np.ones(DEPTH_SHAPE[1])
    rows[8:20, 30:40] = 0.2  # A box, whose edges cast shadows.
    grain = np.random.default_rng(tick).normal(0, 0.005, (n, *DEPTH_SHAPE))
    return np.clip(rows + grain, 0.01, 1).astype(np.float32)


GROUND = ground(4)
TURNING = np.array([0.0, 0.6, -0.4])


def play(injections: list[Injection], n: int = 2, ticks: int = 20, seed: int = 0) -> list[Frames]:
    injector = Injector([tuple(injections)] * n, range(n), seed)
    rate = np.tile(TURNING, (n, 1))
    return [injector.apply(Frames.healthy(ground(n, t), rate), 5 * t) for t in range(ticks)]


def spoilt(fault: str, level: float, image: np.ndarray | None = None, rate=None) -> Frames:
    """The frames of four robots (or of those of `image`) under a fault that has just begun."""
    image = GROUND if image is None else image
    injector = Injector([(Injection(fault, level, onset=0),)] * len(image), range(len(image)), 1)
    return injector.apply(Frames.healthy(image, rate), 0)


@pytest.mark.parametrize("fault", SENSOR_FAULTS)
@pytest.mark.parametrize("severity", SEVERITIES)
def test_fault_acts_only_while_it_lasts(fault: str, severity: int) -> None:
    frames = play([Injection.of(fault, severity, onset=25, duration=1.0)])
    for t, frame in enumerate(frames):
        assert (frame.image.shape, frame.image.dtype) == ((2, *DEPTH_SHAPE), np.float32)
        assert 0 <= frame.image.min() <= frame.image.max() <= 1
        if not 5 <= t < 15:
            np.testing.assert_array_equal(frame.image, ground(2, t))
            assert frame.fresh.all()
    assert any(np.any(frames[t].image != ground(2, t)) for t in range(5, 15))


@pytest.mark.parametrize("name", SENSOR_FAULTS)
def test_other_robots_keep_their_frames(name: str) -> None:
    fault = FAULTS[name](FAULTS[name].level_of(5), [np.random.default_rng(n) for n in range(2)])
    for tick in range(20):
        given = Frames.healthy(ground(2, tick), np.tile(TURNING, (2, 1)))
        after = fault.corrupt(given, np.array([tick * TICK_DT, -1.0]))
        for field, value in vars(after).items():
            np.testing.assert_array_equal(value[1], getattr(given, field)[1])
        np.testing.assert_array_equal(given.image, ground(2, tick), "the input is not changed")


@pytest.mark.parametrize("fault", SENSOR_FAULTS)
def test_noise_follows_stream_and_seed(fault: str) -> None:
    once, again = (play([Injection.of(fault, 4, onset=0)], seed=3) for _ in range(2))
    injector = Injector([(Injection.of(fault, 4, onset=0),)], [1], 3)
    for t, (a, b) in enumerate(zip(once, again, strict=True)):
        np.testing.assert_array_equal(a.image, b.image)
        alone = injector.apply(Frames.healthy(ground(2, t)[1:], TURNING[None]), 5 * t)
        np.testing.assert_array_equal(alone.image[0], a.image[1])


def test_noise_has_stated_levels() -> None:
    grey = np.full((8, *DEPTH_SHAPE), 0.5)
    for sigma in (0.05, 0.1):
        image = spoilt("gaussian", sigma, grey).image
        assert image.mean() == pytest.approx(0.5, abs=0.002)
        assert image.std() == pytest.approx(sigma, rel=0.02)
    image = spoilt("salt_and_pepper", 0.3, grey).image
    for value in (0, 1):
        assert (image == value).mean() == pytest.approx(0.15, abs=0.01)


def test_blackout_fades_linearly_to_zero() -> None:
    for t, frame in enumerate(play([Injection("blackout", 0.5, onset=0)], ticks=8)):
        remaining = max(1 - t * TICK_DT / 0.5, 0)
        np.testing.assert_allclose(frame.image, ground(2, t) * remaining, atol=1e-6)


@pytest.mark.parametrize("fault", ["saturated", "occlusion"])
def test_covered_share_is_as_stated(fault: str) -> None:
    for share in (0.25, 0.5, 1.0):
        assert (spoilt(fault, share).image != GROUND).mean() == pytest.approx(share, abs=0.02)


def test_glare_raises_invalid_share() -> None:
    raw, filled = spoilt("glare", 0.3), spoilt("glare_filled", 0.3)
    holes = raw.image == 0
    assert holes.mean() == pytest.approx(0.3, abs=0.01)
    np.testing.assert_array_equal(raw.invalid, holes.mean(axis=(1, 2)))
    np.testing.assert_array_equal(filled.invalid, raw.invalid)
    assert filled.image.min() > 0
    np.testing.assert_array_equal(filled.image[~holes], GROUND[~holes])
    # Correlated: a hole's neighbour is mostly a hole too.
    assert (holes[:, :, 1:] & holes[:, :, :-1]).mean() / holes.mean() > 0.8


def test_near_field_and_wrong_scale() -> None:
    after, near = spoilt("near_field", 0.5), GROUND < 0.25
    np.testing.assert_array_equal(after.image, np.where(near, 0, GROUND))
    np.testing.assert_allclose(after.invalid, near.mean(axis=(1, 2)))
    scaled = spoilt("wrong_scale", 1.3).image
    np.testing.assert_allclose(scaled, np.minimum(GROUND * 1.3, 1), rtol=1e-6)


@pytest.mark.parametrize(("fault", "fresh"), [("frozen", True), ("unplugged", False)])
def test_frozen_repeats_and_unplugged_ages(fault, fresh) -> None:
    frames = play([Injection(fault, 1.0, onset=25)])
    for t in range(5, 15):
        np.testing.assert_array_equal(frames[t].image, ground(2, 4))
        assert (frames[t].fresh == fresh).all()
        np.testing.assert_allclose(frames[t].age, 0.0 if fresh else (t - 4) * TICK_DT)
    assert frames[15].fresh.all()
    np.testing.assert_array_equal(frames[15].image, ground(2, 15))


def test_dropped_loses_the_stated_share() -> None:
    frames = play([Injection("dropped", 0.3, onset=0)], n=40, ticks=50)
    assert 1 - np.mean([f.fresh for f in frames]) == pytest.approx(0.3, abs=0.04)


def test_latency_delays_images_as_stated() -> None:
    frames = play([Injection("latency", 200, onset=0)], n=8, ticks=30)
    grounds = np.stack([ground(8, t) for t in range(30)])
    # The first column's grain tells frames apart: [served, taken, robot].
    same = np.stack([(frames[t].image == grounds)[..., 0].all(-1) for t in range(8, 30)])
    ages = (np.arange(8, 30)[:, None] - same.argmax(axis=1)) * TICK_DT
    assert same.any(axis=1).all()
    # Delays of 0.1 to 0.3 s on a 0.1 s grid; a newer frame may overtake.
    assert 0.1 - 1e-9 <= ages.min() <= ages.max() <= 0.4 + 1e-9
    assert 0.15 < ages.mean() < 0.3
    first, second = play([Injection("latency", 500, onset=0)], ticks=2)
    np.testing.assert_array_equal(second.image, first.image, "until another one arrives")


@pytest.mark.parametrize("fault", ["frozen:5", "latency:4"])
def test_old_images_keep_their_own_share_of_holes(fault: str) -> None:
    injector = Injector([(parse_fault(f"{fault}@1s"),)] * 4, range(4), seed=0)
    for t in range(30):
        # Every frame has a depth and a share of holes of its own, which tell each other.
        share = (t + 1) / 100
        live = Frames.healthy(np.full((4, *DEPTH_SHAPE), share, np.float32))
        frames = injector.apply(replace(live, invalid=np.full(4, share)), 5 * t)
        np.testing.assert_allclose(frames.invalid, frames.image[:, 0, 0], rtol=1e-6)


def test_frames_that_are_lost_before_they_are_late_never_come() -> None:
    """Of each frame that the bus loses, latency delivers nothing; others come once at most."""
    schedule = (Injection("dropped", 0.7, onset=0), Injection("latency", 200, onset=0))
    injector = Injector([schedule] * 8, range(8), seed=0)
    dropping = Injector([schedule[:1]] * 8, range(8), seed=0)
    delivered = [[] for _ in range(8)]
    sent = [[] for _ in range(8)]
    for t in range(100):
        # The depth of a frame is its number.
        live = Frames.healthy(np.full((8, *DEPTH_SHAPE), (t + 1) / 128, np.float32))
        late = injector.apply(live, 5 * t)
        dropped = dropping.apply(live, 5 * t)
        for robot in range(8):
            if late.fresh[robot]:
                delivered[robot].append(128 * late.image[robot, 0, 0])
            if dropped.fresh[robot]:
                sent[robot].append(128 * dropped.image[robot, 0, 0])
    for numbers, whole in zip(delivered, sent, strict=True):
        assert (np.diff(numbers) > 0).all()
        # The first frame is shown at once, whether it was lost or not.
        assert set(numbers) <= {1.0, *whole}
        assert len(numbers) > 10


def test_age_of_late_frames_is_never_negative() -> None:
    """From the very first tick on, until the first late frame arrives, the image grows old."""
    frames = play([Injection("latency", 500, onset=0)], n=8, ticks=20)
    for t in range(3):
        np.testing.assert_allclose(frames[t].age, t * TICK_DT, atol=1e-9)
    assert min(frame.age.min() for frame in frames) >= 0.0


def test_motion_blur_follows_rate_and_exposure() -> None:
    edge = np.zeros((1, *DEPTH_SHAPE), np.float32)
    edge[:, :, 32:] = 1
    blurred = spoilt("motion_blur", 40, edge, np.array([[0.0, 0.0, 3.0]])).image[0, 0]
    width = 1 / np.abs(np.diff(blurred)).max()
    # 66 degrees across 64 columns.
    assert width == pytest.approx(3.0 * 0.04 * 32 / np.tan(np.radians(33)), abs=1.0)
    np.testing.assert_allclose(spoilt("motion_blur", 40, edge).image, edge, atol=1e-6)
    image = GROUND[0]
    np.testing.assert_allclose(shifted(image, 2, -3)[2:, :-3], image[:-2, 3:], rtol=1e-6)


def test_holes_fill_from_left_right_above() -> None:
    image = np.array([[1.0, 2, 3], [4, 5, 6], [7, 8, 9]])
    holes = np.array([[0, 1, 1], [1, 0, 1], [1, 1, 1]], bool)
    np.testing.assert_array_equal(fill_from_left(image, holes), [[1, 1, 1], [5, 5, 5], [5, 5, 5]])


def test_faults_compose_in_order() -> None:
    frames = play([Injection("saturated", 1.0, 0), Injection("wrong_scale", 0.5, 25)], ticks=8)
    assert [np.unique(frames[t].image).tolist() for t in (4, 6)] == [[1.0], [0.5]]


def test_fault_repeats_on_time() -> None:
    injection = Injection("gaussian", 1.0, onset=100, duration=0.1, period=0.4)
    at_work = np.array([injection.at_work(step) for step in range(600)])
    np.testing.assert_array_equal(np.flatnonzero(at_work[::5]) * 5, np.arange(100, 600, 20))
    assert at_work.sum() == 25 * 5


def test_injector_knows_who_is_failing() -> None:
    schedules = [(Injection("frozen", 0.2, 10),), (), (Injection("gaussian", 1, 20),)]
    injector = Injector(schedules, range(3), 0)
    assert injector.at_work(10).tolist() == [True, False, False]
    assert injector.at_work(20).tolist() == [False, False, True]


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: Injection("smoke", 1.0),
        lambda: Injection.of("gaussian", 6),
        lambda: Injection("gaussian", 1.0, onset=-1),
        lambda: Injection("gaussian", 1.0, duration=0),
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
    assert step > onset or elapsed == (-1 if step < onset else 0)


@pytest.mark.parametrize("kind", ["blackout", "frozen", "glare"])
@pytest.mark.parametrize("severity", SEVERITIES)
def test_intermittent_fault_has_stated_share(kind, severity) -> None:
    injection = Injection.of(f"intermittent_{kind}", severity, onset=25)
    for t, frame in enumerate(play([injection], ticks=40)):
        seconds, tick = divmod(t - 5, 10)
        on = t >= 5 and tick < round(10 * injection.level)
        assert (frame.image != ground(2, t)).any() == on
        if kind == "frozen" and on:
            np.testing.assert_array_equal(frame.image, ground(2, 4 + 10 * seconds))


def test_dropped_frames_keep_old_glare() -> None:
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


def test_cameras_without_a_simulator_refuse_physical_faults() -> None:
    for name in ("glass", "foam", "mount_knocked", "mount_creep"):
        with pytest.raises(RenetError, match="only a simulated world"):
            Injector([(Injection.of(name, 3),)], [0], 0)


def test_views_compose_and_images_pass_untouched() -> None:
    schedule = (
        Injection("foam", 0.1, 0),
        Injection("foam", 0.02, 10),
        Injection("glass", 0.4, 0),
        Injection("mount_knocked", 10.0, 0),
    )
    injector = Injector([schedule, ()], [0, 1], 5, physical=True)
    late = injector.perturbation(10)
    np.testing.assert_allclose(injector.perturbation(0).lift, [0.1, 0.0])
    np.testing.assert_allclose(late.lift, [0.12, 0.0])
    np.testing.assert_allclose(late.glass, [0.4, 0.0])
    assert np.degrees(np.linalg.norm(late.turn[0])) == pytest.approx(10.0)
    assert not late.turn[1].any()
    image = np.random.default_rng(0).random((2, 48, 64), np.float32)
    np.testing.assert_array_equal(injector.apply(Frames.healthy(image), 10).image, image)
    assert injector.at_work(10).tolist() == [True, False]


def test_mount_creeps_up_to_limit() -> None:
    schedule = (Injection("mount_creep", 4.0, onset=50),)
    injector = Injector([schedule] * 2, [0, 1], 5, physical=True)
    steps = (0, 50, 100, 200, 1000)
    turns = np.degrees([injector.perturbation(step).turn for step in steps])
    angles = np.linalg.norm(turns, axis=-1)
    np.testing.assert_allclose(angles, np.repeat([[0], [0], [4], [12], [25]], 2, axis=1))
    axes = turns[2:] / angles[2:, :, None]
    np.testing.assert_allclose(axes, np.repeat(axes[:1], 3, axis=0))
    assert not np.allclose(axes[0, 0], axes[0, 1])


@pytest.mark.parametrize(("count", "share", "expected"), [(4, 0.2, 1), (24, 0.2, 5), (24, 1.0, 24)])
def test_share_of_obstacles_is_at_least_one(count: int, share: float, expected: int) -> None:
    tiles = [list(range(count)), list(range(100, 100 + count))]
    chosen = choose_evenly(tiles, share)
    assert [len(chosen & set(geoms)) for geoms in tiles] == [expected, expected]
    assert len(chosen) == 2 * expected


@pytest.mark.parametrize(
    ("kind", "count"),
    # Blocks; four sides of a ring; four sides of nine rings, and two of the ground around them.
    [("obstacles", 24), ("platform", 4), ("stairs_up", 38)],
)
def test_boxes_above_the_start_are_obstacles(kind: str, count: int) -> None:
    model, _ = build_scene(kind, 5)
    (tile,) = obstacles(model, np.zeros((1, 2)))
    assert len(tile) == count


@pytest.mark.parametrize("kind", ["gap", "stairs_down"])
def test_ground_beyond_an_edge_is_no_obstacle(kind: str) -> None:
    model, _ = build_scene(kind, 5)
    with pytest.raises(RenetError, match="no obstacle that could be glass"):
        obstacles(model, np.zeros((1, 2)))


@pytest.mark.parametrize("fault", SENSOR_FAULTS)
def test_spared_robots_keep_their_frames(fault: str) -> None:
    schedules = [(Injection.of(fault, 4, onset=10),)] * 3
    whole, sparing = (Injector(schedules, [7, 8, 7], 0) for _ in range(2))
    for tick in range(12):
        given = Frames.healthy(ground(3, tick), np.tile(TURNING, (3, 1)))
        spared = np.array([tick >= 6, False, False])
        expected, frames = whole.apply(given, 5 * tick), sparing.apply(given, 5 * tick, spared)
        for name, values in vars(frames).items():
            np.testing.assert_array_equal(values[~spared], getattr(expected, name)[~spared], name)
        if tick >= 6:
            np.testing.assert_array_equal(frames.image[0], given.image[0])
