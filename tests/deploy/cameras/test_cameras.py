"""Cameras around cameras: faults injected, flights shown again."""

import numpy as np
import pytest

from renet.deploy.cameras.base import DepthFrame
from renet.deploy.cameras.faulty import FaultyCamera
from renet.deploy.recording.recorder import TICK_DTYPE, Recording
from renet.deploy.recording.replay import ReplayCamera
from renet.errors import RenetError
from renet.faults import parse_fault
from renet.interface import CONTROL_DT

from ..fakes import frame, time_of


class Source:
    """A clock and a camera of a given rate."""

    def __init__(self, every: int = 5) -> None:
        self.step, self.every, self.open = 0, every, False

    def now(self) -> float:
        return 50.0 + time_of(self.step)

    def start(self) -> None:
        self.open = True

    def latest(self) -> DepthFrame | None:
        last = self.step - self.step % self.every
        return frame(last, 50.0 + time_of(last))

    def close(self) -> None:
        self.open = False


def watch(source: Source, fault: str, steps: int, idle: int = 0) -> list[DepthFrame]:
    """What the camera shows at each step, first asked `idle` steps after its start."""
    camera = FaultyCamera(source, [parse_fault(fault)], source.now, seed=1)
    camera.start()
    assert source.open
    source.step += idle
    seen = []
    for _ in range(steps):
        seen.append(camera.latest())
        source.step += 1
    camera.close()
    assert not source.open
    return seen


@pytest.mark.parametrize("idle", [0, 500])
def test_blackout_from_its_onset_to_its_end(idle):
    """Counted from the first look: a controller takes its time to load."""
    seen = watch(Source(), "blackout@1s+0.5s", 100, idle)
    black = [not shown.image.any() for shown in seen]
    assert not any(black[:50])
    assert all(black[50:75])
    assert not any(black[75:])
    assert [shown.number - idle for shown in seen] == [5 * (k // 5) for k in range(100)]


def test_an_unplugged_camera_grows_old_and_comes_back():
    seen = watch(Source(), "unplugged:1@1s", 120)
    ages = [50.0 + time_of(k) - shown.time for k, shown in enumerate(seen)]
    assert max(ages[:50]) < 0.1
    assert ages[99] == pytest.approx(1.08)
    assert max(ages[105:]) < 0.1


def test_holes_are_told():
    assert watch(Source(), "glare:4@0s", 10)[-1].invalid > 0.3


def test_a_faster_camera_is_thinned_out_to_ten_frames_a_second():
    seen = watch(Source(every=2), "blackout@9s", 100)
    times = sorted({shown.time for shown in seen})
    assert len(times) == 20
    assert np.diff(times).min() >= 0.08 - 1e-9


def test_a_silent_camera_stays_silent():
    source = Source()
    source.latest = lambda: None
    assert watch(source, "blackout@0s", 10) == [None] * 10


def test_faults_of_the_scene_are_refused():
    with pytest.raises(RenetError, match="acts on the scene"):
        watch(Source(), "glass@1s", 1)


@pytest.mark.parametrize(
    ("text", "fields"),
    [
        ("blackout@5s", ("blackout", 0.0, 250, float("inf"))),
        ("glare:3@4s+2s", ("glare", 0.3, 200, 2.0)),
        ("unplugged:2@0.5+1.5", ("unplugged", 2.0, 25, 1.5)),
    ],
)
def test_faults_are_read(text, fields):
    fault = parse_fault(text)
    assert (fault.fault, fault.level, fault.onset, fault.duration) == fields


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
    source = Source()
    camera = ReplayCamera(Recording({}, ticks, images, [], True), source.now)
    assert camera.latest() is None
    source.step = 40
    camera.start()
    numbers = []
    for _ in range(10):
        numbers.append(camera.latest().number)
        source.step += 1
    assert numbers == [11] * 5 + [12] * 5
    last = camera.latest()
    assert (last.time, last.invalid) == (pytest.approx(50.9), 0.25)
    camera.close()
    with pytest.raises(RenetError, match="without a camera"):
        ReplayCamera(Recording({}, ticks, {}, [], True), source.now)
