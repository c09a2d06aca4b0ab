"""The real driver on librealsense's software device: synthetic frames, real sensor and filters."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest

rs = pytest.importorskip(
    "pyrealsense2", reason="needs renet[realsense] and libusb-1.0-0", exc_type=ImportError
)

from renet.deploy.cameras import realsense  # noqa: E402
from renet.deploy.cameras.realsense import ClockOffset, RealSenseCamera  # noqa: E402
from renet.errors import RenetError  # noqa: E402
from renet.training.bundle import camera_spec  # noqa: E402

FOCAL = 446.8


class Device:
    """A camera made of software, 848 x 480 unless told otherwise."""

    def __init__(self, width: int = 848, height: int = 480) -> None:
        self.shape = (height, width)
        self.device = rs.software_device()
        self.sensor = self.device.add_sensor("Stereo Module")
        lens = rs.intrinsics()
        lens.width, lens.height, lens.fx, lens.fy = width, height, FOCAL, FOCAL
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

    def send(self, millimetres: np.ndarray) -> None:
        self.number += 1
        frame = rs.software_video_frame()
        frame.pixels, frame.stride, frame.bpp = millimetres.astype(np.uint16), 1696, 2
        frame.timestamp, frame.domain = 33.3 * self.number, rs.timestamp_domain.hardware_clock
        frame.frame_number, frame.profile, frame.depth_units = self.number, self.profile, 0.001
        self.sensor.on_video_frame(frame)


def until(condition: Callable[[], bool], act: Callable[[], None] = lambda: None) -> None:
    """Act until a condition holds; threads need their time."""
    for _ in range(1000):
        if condition():
            return
        act()
        time.sleep(0.01)
    pytest.fail("it never happened")


@pytest.fixture
def device() -> Device:
    return Device()


@pytest.fixture
def camera(device):
    camera = RealSenseCamera(camera_spec(), time.monotonic, device.device)
    camera.start()
    yield camera
    camera.close()


def received(camera: RealSenseCamera, device: Device, millimetres: np.ndarray):
    number = device.number + 5
    until(
        lambda: camera.latest() is not None and camera.latest().number >= number,
        lambda: device.send(millimetres),
    )
    return camera.latest()


def test_metres_number_time_and_holes(camera, device):
    picture = np.full((480, 848), 1000)
    picture[:, :424] = 500
    picture[200:260, 500:560] = 0
    frame = received(camera, device, picture)
    assert frame.image.shape == (48, 64)
    np.testing.assert_allclose(frame.image[:, :30], 0.25, atol=0.01)
    # The hole in this half was filled.
    np.testing.assert_allclose(frame.image[:, 34:], 0.5, atol=0.02)
    view = 2 * 0.65 * FOCAL * 2 * 0.4875 * FOCAL
    assert frame.invalid == pytest.approx(3600 / view, rel=0.1), "counted before it was filled"
    assert frame.number <= device.number
    assert 0.0 <= time.monotonic() - frame.time < 5.0


def test_far_is_one_and_nothing_at_all_is_far(camera, device):
    assert received(camera, device, np.full((480, 848), 9000)).image.min() == 1.0
    blind = received(camera, device, np.zeros((480, 848)))
    assert blind.invalid == 1.0


def test_frames_that_stop_and_come_back(monkeypatch, device):
    monkeypatch.setattr(realsense, "SILENCE", 0.05)
    monkeypatch.setattr(realsense, "RETRY", 0.01)
    camera = RealSenseCamera(camera_spec(), time.monotonic, device.device)
    camera.start()
    picture = np.full((480, 848), 800)
    for _ in range(5):
        received(camera, device, picture)
        until(lambda: "no frame" in camera.problem)
        stale = camera.latest()
        assert camera.latest() is stale, "what there is grows old; the selector sees that"
    camera.close()
    camera.close()


def test_a_slow_port_and_no_camera_are_refused():
    narrow = RealSenseCamera(camera_spec(), time.monotonic, Device(640, 480).device)
    with pytest.raises(RenetError, match=r"it offers 640x480@30.*USB 3"):
        narrow.start()
    with pytest.raises(RenetError, match="none is connected"):
        RealSenseCamera(camera_spec(), time.monotonic, serial="12345").start()


def test_a_late_frame_is_as_old_as_it_is():
    offset = ClockOffset()
    assert offset.time(100.0, 7.0) == 7.0
    assert offset.time(100.1, 7.3) == pytest.approx(7.1), "0.2 s on the way"
    assert offset.time(100.2, 7.19) == pytest.approx(7.19), "the fastest so far"
    assert offset.time(0.5, 8.0) == 8.0, "another clock after a restart"
