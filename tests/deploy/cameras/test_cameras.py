"""Cameras around cameras: faults injected, flights shown again."""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest

from renet.deploy.cameras.base import Camera, DepthFrame
from renet.deploy.cameras.faulty import FaultyCamera
from renet.deploy.recording.reader import Recording
from renet.deploy.recording.replay import ReplayCamera
from renet.deploy.recording.tick import TICK_DTYPE
from renet.errors import RenetError
from renet.faults import Injection, Injector, parse_fault
from renet.interface import CONTROL_DT

from ..fakes import Standing, frame, time_of
from ..fakes import state as standing


def watch(fault: str, steps: int, idle: int = 0, every: int = 5) -> list[DepthFrame]:
    """What is shown at each of some steps, after idle ones, of a frame in `every` steps."""
    step = 0

    def latest() -> DepthFrame:
        last = step - step % every
        return frame(last, 50.0 + time_of(last))

    source = Mock(spec=Camera, latest=latest)
    camera = FaultyCamera(source, [parse_fault(fault)], lambda: 50.0 + time_of(step), seed=1)
    camera.start()
    source.start.assert_called_once()
    seen = []
    for step in range(idle, idle + steps):  # noqa: B007  (the clock)
        seen.append(camera.latest())
    camera.close()
    source.close.assert_called_once()
    return seen


@pytest.mark.parametrize("idle", [0, 500])
def test_blackout_from_its_onset_to_its_end(idle):
    """Counted from the first look: a controller takes its time to load."""
    seen = watch("blackout@1s+0.5s", 100, idle)
    black = [not shown.image.any() for shown in seen]
    assert not any(black[:50])
    assert all(black[50:75])
    assert not any(black[75:])
    assert [shown.number - idle for shown in seen] == [5 * (k // 5) for k in range(100)]


def test_an_unplugged_camera_grows_old_and_comes_back():
    seen = watch("unplugged:1@1s", 120)
    ages = [50.0 + time_of(k) - shown.time for k, shown in enumerate(seen)]
    assert max(ages[:50]) < 0.1
    assert ages[99] == pytest.approx(1.08)
    assert max(ages[105:]) < 0.1


def test_holes_are_told():
    assert watch("glare:4@0s", 10)[-1].invalid > 0.3


@pytest.mark.parametrize("reading", [None, np.zeros(3), np.array([0.0, 0.0, 3.0])])
def test_motion_blur_follows_the_robots_turn(reading):
    """An edge is smeared over as many columns as it moves in during the exposure of 40 ms."""
    edge = np.zeros((48, 64), np.float32)
    edge[:, 32:] = 1.0
    source = Mock(spec=Camera, latest=lambda: DepthFrame(edge, 0, 50.0))
    state = None if reading is None else standing(angular_velocity=reading)
    blur = [parse_fault("motion_blur:5@0s")]
    camera = FaultyCamera(source, blur, lambda: 50.0, seed=1, read=lambda: state)
    row = camera.latest().image[0]
    rate = 0.0 if reading is None else reading[2]
    # The lens sees 66 degrees in 64 columns.
    columns = rate * 0.04 * 32 / np.tan(np.radians(33))
    assert 1.0 / np.abs(np.diff(row)).max() == pytest.approx(max(columns, 1.0), abs=1.0)
    assert (row != edge[0]).any() == (columns > 0.0)


def test_a_damaged_reading_blurs_nothing():
    source = Mock(spec=Camera, latest=lambda: frame(0, 50.0))
    state = standing(angular_velocity=np.array([0.0, np.nan, np.inf]))
    blur = [parse_fault("motion_blur:5@0s")]
    camera = FaultyCamera(source, blur, lambda: 50.0, seed=1, read=lambda: state)
    np.testing.assert_allclose(camera.latest().image, frame(0, 50.0).image, atol=1e-6)


def test_holes_of_an_image_are_told_as_long_as_it_is_shown():
    """A driver that hangs repeats an image with its share of holes, not with the newest one's."""
    step = 0

    def latest() -> DepthFrame:
        last = step - step % 5
        return replace(frame(last, 50.0 + time_of(last)), invalid=0.5 if last >= 50 else 0.25)

    source = Mock(spec=Camera, latest=latest)
    hang = [parse_fault("frozen@1s")]
    camera = FaultyCamera(source, hang, lambda: 50.0 + time_of(step), seed=1)
    shown = []
    for step in range(60):  # noqa: B007  (the clock)
        shown.append(camera.latest())
    assert shown[-1].time == pytest.approx(50.0 + time_of(55))
    np.testing.assert_array_equal(shown[-1].image, shown[49].image)
    assert shown[-1].invalid == shown[49].invalid == 0.25


def test_a_faster_camera_is_thinned_out_to_ten_frames_a_second():
    seen = watch("blackout@9s", 100, every=2)
    times = sorted({shown.time for shown in seen})
    assert len(times) == 20
    assert np.diff(times).min() >= 0.08 - 1e-9


@pytest.mark.parametrize("every", [1, 2, 5])
def test_faults_are_applied_once_to_each_frame_from_the_first_on(every, monkeypatch):
    apply = Injector.apply
    steps = []

    def counted(injector, frames, step):
        steps.append(step)
        return apply(injector, frames, step)

    monkeypatch.setattr(Injector, "apply", counted)
    watch("gaussian@0s", 50, every=every)
    assert steps[0] == 0
    assert np.diff(steps).min() >= 4, "steps at which the frames were taken"


@pytest.mark.parametrize("every", [1, 2, 5])
def test_images_that_a_pause_left_out_are_not_made_up_for(every):
    step = 0

    def latest() -> DepthFrame:
        last = step - step % every
        return frame(last, 50.0 + time_of(last))

    source = Mock(spec=Camera, latest=latest)
    camera = FaultyCamera(source, [parse_fault("blackout@9s")], lambda: 50.0 + time_of(step), 1)
    steps = [*range(20), *range(73, 93)]
    times = []
    for step in steps:  # noqa: B007  (the clock)
        times.append(camera.latest().time)
    assert np.diff(np.unique(times)).min() >= 0.08 - 1e-9


def test_a_silent_camera_stays_silent():
    silent = Mock(spec=Camera, latest=Mock(return_value=None))
    camera = FaultyCamera(silent, [parse_fault("blackout@0s")], Standing().now, seed=1)
    assert [camera.latest() for _ in range(10)] == [None] * 10


def test_faults_of_the_scene_are_refused():
    with pytest.raises(RenetError, match="acts on the scene"):
        watch("glass@1s", 1)


@pytest.mark.parametrize(
    ("text", "fields"),
    [
        ("blackout@5s", ("blackout", 0.0, 250, float("inf"))),
        ("glare:3@4s+2s", ("glare", 0.3, 200, 2.0)),
        ("unplugged:2@0.5+1.5", ("unplugged", 2.0, 25, 1.5)),
    ],
)
def test_faults_are_read(text, fields):
    assert parse_fault(text) == Injection(*fields)


@pytest.mark.parametrize(
    "text", ["", "blackout", "@5s", "blackout@", "blackout@-1", "blackout:6@1", "sunset@3", "a b@1"]
)
def test_unreadable_faults_are_refused(text):
    with pytest.raises(RenetError, match=f"cannot read the fault {text!r}|choose"):
        parse_fault(text)


def test_a_flight_is_shown_again_on_another_clock():
    ticks = np.zeros(20, TICK_DTYPE)
    ticks["now"] = 7.0 + CONTROL_DT * np.arange(20)
    ticks["frame_number"][[3, 8]] = (11, 12)
    ticks["frame_invalid"][8] = 0.25
    images = {row: np.full((48, 64), row / 10, np.float16) for row in (3, 8)}
    clock = Standing()
    camera = ReplayCamera(Recording({}, ticks, images, [], True), clock.now)
    assert camera.latest() is None
    clock.time = 50.8
    camera.start()
    numbers = []
    for _ in range(10):
        numbers.append(camera.latest().number)
        clock.time += CONTROL_DT
    assert numbers == [11] * 5 + [12] * 5
    last = camera.latest()
    assert (last.time, last.invalid) == (pytest.approx(50.9), 0.25)
    camera.close()
    with pytest.raises(RenetError, match="without a camera"):
        ReplayCamera(Recording({}, ticks, {}, [], True), clock.now)
