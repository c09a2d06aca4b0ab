"""Intel RealSense depth cameras through librealsense, with frame times on the robot's clock."""

import atexit
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import reduce
from time import time as wall_clock
from typing import Any

import numpy as np

from renet.bundle.manifest import CameraSpec
from renet.camera import Intrinsics
from renet.deploy.cameras.base import Camera, DepthFrame
from renet.deploy.cameras.preprocess import DepthPreprocessor
from renet.errors import RenetError, install

_WIDTH = 848
_HEIGHT = 480
"""Pixels of the depth image: those at which, by its vendor, the D435 family measures best."""
_FPS = 30
"""Frames a second."""
FRAME_TIMEOUT = 1.0
"""Time without a frame, s, after which the camera is opened anew: it may have been replugged."""
RETRY_INTERVAL = 0.5
"""Time between two attempts to open the camera, s."""
_MAX_DRIFT = 1e-3
"""Largest drift between the clocks of camera and robot that is followed, s/s; quartz drifts by up
to 1e-4."""
_CLOCK_RESET = 1.0
"""Jump back of the camera's clock, s, from which the camera has started anew."""


def realsense() -> Any:
    """Import the module of librealsense; raises RenetError that says what to install."""
    try:
        import pyrealsense2
    except ImportError as error:
        raise RenetError(
            f"the RealSense camera needs its driver: {install('realsense')}, and the package "
            f"libusb-1.0-0 of the system ({error})"
        ) from error
    return pyrealsense2


def _filters(rs: Any) -> tuple[Any, ...]:
    """Filters of librealsense in the order that its vendor recommends.

    Holes are left to `preprocess.fill_holes`, which fills them in calibration from images, too.
    """
    temporal = rs.temporal_filter()
    # Its persistence would refill holes from old frames: a partly frozen image.
    temporal.set_option(rs.option.holes_fill, 0)
    return (
        rs.decimation_filter(2),
        rs.disparity_transform(True),
        rs.spatial_filter(),
        temporal,
        rs.disparity_transform(False),
    )


class ClockOffset:
    """Converts the camera's timestamps into times on the robot's clock.

    The frame that travelled fastest fixes the offset between both clocks, so that a frame that was
    delayed on its way shows its true age. The offset follows a drift of up to `_MAX_DRIFT`. Delays
    grow faster than that, or suddenly, and therefore stay visible as long as the stream lasts.
    """

    def __init__(self) -> None:
        self._offset = np.inf
        """Smallest difference between arrival and timestamp, s, with the drift allowed for."""
        self._arrival = -np.inf
        """Time at which the last frame arrived, s on the robot's clock."""

    def time(self, stamp: float, arrival: float) -> float:
        """Return the time of a frame on the robot's clock, s.

        Args:
            stamp: Timestamp of the frame on the camera's clock, s.
            arrival: Time at which the frame arrived, s on the robot's clock.
        """
        passed = max(arrival - self._arrival, 0.0) if np.isfinite(self._arrival) else 0.0
        self._offset = min(self._offset + _MAX_DRIFT * passed, arrival - stamp)
        self._arrival = arrival
        return min(arrival, stamp + self._offset)


class FrameClock:
    """Converts the timestamps of one stream's frames, of whichever clock, to the robot's clock."""

    def __init__(self, rs: Any) -> None:
        """Begin a stream; `rs` is the module of librealsense."""
        self._system_time = rs.timestamp_domain.system_time
        self._offset = ClockOffset()
        self._last = -np.inf
        """Last timestamp of the camera's clock, s."""

    def time(self, frame: Any, arrival: float) -> float:
        """Return the time of a frame that has just arrived at `arrival`, s on the robot's clock."""
        stamp = frame.get_timestamp() / 1000.0
        # Without the metadata of frames, which not every kernel passes on, librealsense stamps them
        # by the wall clock as they come. It may be set, so nothing of it is kept for later frames.
        if frame.get_frame_timestamp_domain() == self._system_time:
            return arrival - max(wall_clock() - stamp, 0.0)
        # The camera's clock started anew: so must its offset.
        if stamp < self._last - _CLOCK_RESET:
            self._offset = ClockOffset()
        self._last = stamp
        return self._offset.time(stamp, arrival)


class RealSenseCamera(Camera):
    """RealSense camera that is read on a thread of its own.

    When frames stop, the thread opens the camera anew, unless `busy`: meanwhile librealsense stalls
    all threads.
    """

    def __init__(
        self,
        spec: CameraSpec,
        clock: Callable[[], float],
        device: Any = None,
        serial: str = "",
        upside_down: bool = False,
    ) -> None:
        """Set up without opening the camera.

        Args:
            spec: Format of the policy's images.
            clock: Function that returns the time on the robot's clock, s.
            device: Open librealsense device, such as a software device; by default a camera that
                is connected.
            serial: Serial number of the camera to open; empty for the only one.
            upside_down: True if the camera is turned by 180 degrees in its mount.
        """
        self._spec = spec
        self._clock = clock
        self._device = device
        self._serial = serial
        self._upside_down = upside_down
        self._rs = realsense()
        self._latest: DepthFrame | None = None
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self.problem = ""
        """Last problem of the camera; empty while frames arrive."""

    def start(self) -> None:
        """Begin to stream; raises RenetError with what to do when that fails."""
        stream = self._open()
        self._thread = threading.Thread(target=self._run, args=(stream,), daemon=True)
        self._thread.start()
        # A thread inside librealsense would abort an interpreter that ends.
        atexit.register(self.close)

    def latest(self) -> DepthFrame | None:
        """Return the newest frame; None before the first."""
        return self._latest

    def close(self) -> None:
        """Stop streaming; a second call does nothing."""
        atexit.unregister(self.close)
        self._stop.set()
        if self._thread is not None:
            self._thread.join(timeout=2 * FRAME_TIMEOUT)

    def _open(self) -> tuple[Any, Any]:
        """Start the depth sensor; returns it and the queue in which its frames arrive."""
        sensor = None
        queue = self._rs.frame_queue(1)
        try:
            sensor = (self._device or self._find()).first_depth_sensor()
            profile = self._profile(sensor)
            # Raises at once if the view is too narrow.
            self._preprocessor(profile)
            # The global time follows the computer's wall clock, which may be set while walking.
            if sensor.supports(self._rs.option.global_time_enabled):
                sensor.set_option(self._rs.option.global_time_enabled, 0)
            sensor.open(profile)
            sensor.start(queue)
        except RuntimeError as error:
            if sensor is not None:
                _shut(sensor)
            raise RenetError(f"the RealSense camera does not start: {error}") from error
        return sensor, queue

    def _find(self) -> Any:
        """Find the camera of the chosen serial number; raises RenetError unless one is."""
        devices = list(self._rs.context().query_devices())
        serials = [device.get_info(self._rs.camera_info.serial_number) for device in devices]
        matches = []
        for device, serial in zip(devices, serials, strict=True):
            if self._serial in ("", serial):
                matches.append(device)
        if len(matches) == 1:
            return matches[0]
        seen = f"{', '.join(serials)} connected" if serials else "none is connected"
        if matches:
            raise RenetError(f"several RealSense cameras, {seen}: choose one with --serial")
        camera = f"RealSense camera {self._serial}".rstrip()
        raise RenetError(f"no {camera}: {seen}; check its USB 3 cable")

    def _profile(self, sensor: Any) -> Any:
        """Find the profile of the stream to open; raises RenetError if the sensor has none."""
        profiles = []
        for stream in sensor.get_stream_profiles():
            profile = stream.as_video_stream_profile()
            if profile and profile.format() == self._rs.format.z16:
                profiles.append(profile)
        for profile in profiles:
            if (profile.width(), profile.height(), profile.fps()) == (_WIDTH, _HEIGHT, _FPS):
                return profile
        offered = ", ".join(f"{p.width()}x{p.height()}@{p.fps()}" for p in profiles) or "none"
        raise RenetError(
            f"the RealSense camera has no depth of {_WIDTH}x{_HEIGHT} at {_FPS} Hz (it offers "
            f"{offered}): connect it by USB 3"
        )

    def _run(self, stream: tuple[Any, Any] | None) -> None:
        """Read frames, and open the camera anew whenever they stop; the thread's function."""
        while stream is not None:
            try:
                self._stream(stream[1])
            except Exception as error:
                # The robot walks on without its camera.
                self.problem = f"{type(error).__name__}: {error}"
            _shut(stream[0])
            stream = None
            while stream is None and not self._stop.wait(RETRY_INTERVAL):
                try:
                    stream = None if self.busy else self._open()
                except Exception as error:
                    self.problem = str(error)

    def _stream(self, queue: Any) -> None:
        """Prepare frames until they stop."""
        chain = _filters(self._rs)
        clock = FrameClock(self._rs)
        while not self._stop.is_set():
            arrived, frame = queue.try_wait_for_frame(round(1000 * FRAME_TIMEOUT))
            if not arrived:
                self.problem = f"no frame for {FRAME_TIMEOUT:g} s"
                return
            raw = frame.as_depth_frame()
            # Taken at once: preparing the image takes time.
            time = clock.time(raw, self._clock())
            filtered = reduce(lambda image, step: step.process(image), chain, raw).as_depth_frame()
            # Depth is taken from the filtered image, holes are counted in the raw one.
            metres = np.asanyarray(filtered.get_data()) * filtered.get_units()
            pixels = np.asanyarray(raw.get_data())
            self._latest = DepthFrame(
                image=self._preprocessor(filtered.get_profile()).image(metres),
                number=raw.get_frame_number(),
                time=time,
                invalid=self._preprocessor(raw.get_profile()).invalid(pixels),
            )
            self.problem = ""

    def _preprocessor(self, profile: Any) -> DepthPreprocessor:
        """Make the preprocessor of a stream's images."""
        lens = profile.as_video_stream_profile().get_intrinsics()
        # librealsense puts the origin at the centre of the first pixel, renet at its corner.
        middle = (lens.ppx + 0.5, lens.ppy + 0.5)
        intrinsics = Intrinsics(lens.height, lens.width, lens.fx, lens.fy, *middle)
        return DepthPreprocessor(intrinsics, self._spec, self._upside_down)


def _shut(sensor: Any) -> None:
    """Stop and close a sensor; either call fails if the camera is gone."""
    for end in (sensor.stop, sensor.close):
        with suppress(RuntimeError):
            end()
