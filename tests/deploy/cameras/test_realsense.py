"""The real driver on librealsense's software device: synthetic frames, real sensor and filters."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import pytest

from renet.deploy.cameras import realsense
from renet.deploy.cameras.realsense import ClockOffset, RealSenseCamera
from renet.errors import RenetError
from renet.training.export import camera_spec

from ..fakes import until

pytestmark = pytest.mark.wall_clock

NEEDS = "needs renet-locomotion[realsense] and libusb-1.0-0"
rs = pytest.importorskip("pyrealsense2", reason=NEEDS, exc_type=ImportError)
FOCAL = 446.8


class Device:
    """A camera made of software, 848 x 480 unless told otherwise."""

    def __init__(self, width=848, height=480, focal=FOCAL, serial="111") -> None:
        self.device = rs.software_device()
        self.device.register_info(rs.camera_info.serial_number, serial)
        self.sensor = self.device.add_sensor("Stereo Module")
        lens = rs.intrinsics()
        lens.width, lens.height, lens.fx, lens.fy = width, height, focal, focal
        lens.ppx, lens.ppy = (width - 1) / 2, (height - 1) / 2
        lens.model, lens.coeffs = rs.distortion.none, [0.0] * 5
        stream = rs.video_stream()
        stream.type, stream.index, stream.uid, stream.fmt = rs.stream.depth, 0, 1, rs.format.z16
        stream.width, stream.height, stream.fps, stream.bpp = width, height, 30, 2
        stream.intrinsics = lens
        self.profile = self.sensor.add_video_stream(stream).as_video_stream_profile()
        self.sensor.add_read_only_option(rs.option.depth_units, 0.001)
        self.sensor.add_read_only_option(rs.option.stereo_baseline, 50.0)
        self.number = 0
        self.domain = rs.timestamp_domain.hardware_clock
        self.stamp: float | None = None
        """Timestamp of the next frames, ms; None for the sensor's own clock."""

    def send(self, millimetres: np.ndarray) -> None:
        self.number += 1
        frame = rs.software_video_frame()
        pixels = np.broadcast_to(millimetres, (480, 848)).astype(np.uint16)
        frame.pixels, frame.stride, frame.bpp = pixels, 2 * pixels.shape[1], 2
        frame.timestamp = 33.3 * self.number if self.stamp is None else self.stamp
        frame.domain = self.domain
        frame.frame_number, frame.profile, frame.depth_units = self.number, self.profile, 0.001
        self.sensor.on_video_frame(frame)


class Bus:
    """A USB bus of ours: librealsense's own lists no software devices."""

    plugged: Sequence[Device] = ()
    broken = False

    def query_devices(self):
        if self.broken:
            raise RuntimeError("failed to enumerate")
        return [device.device for device in self.plugged]


@pytest.fixture
def device() -> Device:
    return Device()


@pytest.fixture
def bus(monkeypatch) -> Bus:
    """What a camera finds that is not told its device."""
    bus = Bus()
    monkeypatch.setattr(rs, "context", lambda: bus)
    return bus


@pytest.fixture
def hasty(monkeypatch) -> None:
    """Cameras look for a lost device at once."""
    monkeypatch.setattr(realsense, "FRAME_TIMEOUT", 0.02)
    monkeypatch.setattr(realsense, "RETRY_INTERVAL", 0.005)


@contextmanager
def streaming(device: Device | None = None, clock=time.monotonic, **options) -> Iterator:
    """A camera that was started; it is closed twice."""
    camera = RealSenseCamera(camera_spec(), clock, device and device.device, **options)
    camera.start()
    yield camera
    camera.close()
    camera.close()


def received(camera: RealSenseCamera, device: Device, millimetres: np.ndarray | int, count=5):
    number = device.number + count
    until(
        lambda: camera.latest() is not None and camera.latest().number >= number,
        lambda: device.send(millimetres),
    )
    return camera.latest()


def test_metres_number_time_and_holes(device):
    picture = np.where(np.arange(848) < 424, 500, np.full((480, 1), 1000))
    picture[200:260, 500:560] = 0
    with streaming(device) as camera:
        frame = received(camera, device, picture)
        assert received(camera, device, 9000).image.min() == 1.0, "far"
        assert received(camera, device, 0).invalid == 1.0, "nothing at all"
    assert frame.image.shape == (48, 64)
    np.testing.assert_allclose(frame.image[:, :30], 0.25, atol=0.01)
    # The hole in this half was filled.
    np.testing.assert_allclose(frame.image[:, 34:], 0.5, atol=0.02)
    view = 2 * 0.65 * FOCAL * 2 * 0.4875 * FOCAL
    assert frame.invalid == pytest.approx(3600 / view, rel=0.1), "counted before it was filled"
    assert frame.number <= device.number
    assert 0.0 <= time.monotonic() - frame.time < 5.0


def test_the_sensors_own_number_and_clock_are_kept(device):
    """Frames 33.3 ms apart; the last two travel for 0.3 s and, after a gap, for 0.1 s more."""
    now = [5.0]

    def shown():
        device.send(np.array(700))
        until(lambda: camera.latest() is not None and camera.latest().number == device.number)
        return camera.latest().time

    with streaming(device, lambda: now[0]) as camera:
        first = shown()
        now[0] += 0.3333
        assert shown() == pytest.approx(first + 0.0333, abs=1e-3)
        device.number += 9
        now[0] += 0.4330
        assert shown() == pytest.approx(first + 11 * 0.0333, abs=1e-3)


def test_frames_without_metadata_keep_their_age_when_the_wall_clock_is_set(monkeypatch, device):
    """Without it, librealsense stamps frames by the wall clock as they arrive."""
    device.domain = rs.timestamp_domain.system_time
    wall = [1.8e9]
    now = [5.0]
    monkeypatch.setattr(realsense, "wall_clock", lambda: wall[0])

    def age(delay: float) -> float:
        """Return the apparent age of a frame that is read `delay` seconds after it arrived."""
        device.stamp = 1000.0 * wall[0]
        wall[0] += delay
        now[0] += delay
        device.send(np.array(700))
        until(lambda: camera.latest() is not None and camera.latest().number == device.number)
        return now[0] - camera.latest().time

    with streaming(device, lambda: now[0]) as camera:
        assert age(0.01) == pytest.approx(0.01, abs=1e-3)
        for step in (-0.7, 0.7, -30.0, 30.0):
            wall[0] += step
            assert age(0.02) == pytest.approx(0.02, abs=1e-3)
            assert age(0.3) == pytest.approx(0.3, abs=1e-3)


def test_a_program_that_ends_without_closing_it_does_so(monkeypatch, device):
    """Else the interpreter's end aborts the process while the thread is inside librealsense."""
    ends = []
    monkeypatch.setattr("atexit.register", ends.append)
    with streaming(device) as camera:
        received(camera, device, 700)
        (end,) = ends
        end()
        assert not camera._thread.is_alive()


def ages(delays, period=1 / 30, skew=0.0, start=1e4) -> np.ndarray:
    """Apparent ages of frames at their arrivals, that really are as old as `delays` [T] s."""
    offset = ClockOffset()
    taken = period * np.arange(len(delays))
    stamps, arrivals = (1.0 + skew) * taken + 77.0, start + taken + delays
    return arrivals - [offset.time(*pair) for pair in zip(stamps, arrivals, strict=True)]


def test_a_delay_that_stays_is_never_forgotten():
    """Two seconds late from the tenth second on, for ten minutes."""
    delays = np.full(18_000, 0.03)
    delays[300:] = 2.03
    apparent = ages(delays)
    assert apparent[:300].max() < 0.01
    assert apparent[300:].min() > 1.3, "0.6 s of drift in ten minutes are allowed for"
    assert apparent[300 : 300 + 30 * 60].min() > 1.9


@pytest.mark.parametrize("skew", [-1e-4, 0.0, 1e-4])
def test_drifting_clocks_are_followed(skew):
    random = np.random.default_rng(0)
    apparent = ages(0.03 + 0.005 * random.random(54_000), skew=skew)
    assert apparent.max() < 0.02


def test_a_camera_s_clock_that_jumps_back_begins_anew(device):
    with streaming(device) as camera:
        device.number = 300
        late = received(camera, device, 800)
        device.number = 0
        until(lambda: camera.latest().number < 300, lambda: device.send(np.array(800)))
        assert camera.latest().time >= late.time
        assert camera.problem == ""


def test_a_lost_camera_is_looked_for_only_while_the_robot_is_braked(hasty, bus):
    bus.plugged = [Device()]
    with streaming() as camera:
        camera.busy, bus.plugged = True, []
        until(lambda: "no frame" in camera.problem)
        time.sleep(0.1)
        assert "no frame" in camera.problem
        camera.busy = False
        until(lambda: "none is connected" in camera.problem)


def test_fifty_replugs_each_with_a_new_device_clock_and_count(hasty, bus):
    bus.plugged, last = [Device()], -np.inf
    with streaming() as camera:
        for round in range(50):
            seen, device = camera.latest(), bus.plugged[0]
            until(lambda: camera.latest() is not seen, lambda: device.send(np.array(800)))  # noqa: B023
            assert camera.latest().time > last, "the clock goes on though the camera's began anew"
            bus.plugged, bus.broken = [], round % 2 == 1
            cause = "failed to enumerate" if bus.broken else "none is connected"
            until(lambda: cause in camera.problem)  # noqa: B023
            last = camera.latest().time
            bus.plugged, bus.broken = [Device()], False


def test_a_camera_is_chosen_by_its_serial_number(bus):
    bus.plugged = [Device(), Device(serial="222")]
    with streaming(serial="222") as camera:
        received(camera, bus.plugged[1], 600)


@pytest.mark.parametrize(
    ("plugged", "serial", "cause"),
    [
        ([], "", "no RealSense camera: none is connected"),
        ([{}, {"serial": "222"}], "333", r"no RealSense camera 333: 111, 222 connected"),
        ([{}, {"serial": "222"}], "", r"several .*222 connected: choose one with --serial"),
        ([{"width": 640}], "", r"it offers 640x480@30.*USB 3"),
        ([{"focal": 900.0}], "", "not wide enough"),
    ],
)
def test_what_cannot_work_is_refused_with_its_cause(bus, plugged, serial, cause):
    bus.plugged = [Device(**options) for options in plugged]
    with pytest.raises(RenetError, match=cause):
        RealSenseCamera(camera_spec(), time.monotonic, serial=serial).start()


def test_a_sensor_that_refuses_to_start_is_closed_again(device):
    device.sensor.open(device.profile)
    with pytest.raises(RenetError, match="does not start"), streaming(device):
        pass
    with streaming(device) as camera:
        received(camera, device, 900)
