"""Intel RealSense depth cameras through librealsense, with frame times on the robot's clock."""

import atexit
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import reduce
from typing import Any

import numpy as np

from renet.bundle.manifest import CameraSpec
from renet.camera import Intrinsics
from renet.deploy.cameras.base import Camera, DepthFrame
from renet.deploy.cameras.preprocess import DepthPreprocessor
from renet.errors import RenetError, install

WIDTH, HEIGHT, FPS = 848, 480, 30
"""The resolution at which the vendor says the D435 family measures best."""
SILENCE = 1.0
"""Seconds without a frame after which the camera is opened anew: it may have been replugged."""
RETRY = 0.5
"""Seconds between two attempts to open it."""
DRIFT = 1e-3
"""Seconds a second by which the clocks of camera and robot may drift apart; quartz does 1e-4."""
RESTART = 1.0
"""Seconds by which a camera's clock must jump back to have started anew."""


def realsense() -> Any:
    """The vendor's module; raises RenetError with what to install."""
    try:
        import pyrealsense2
    except ImportError as error:
        raise RenetError(
            f"the RealSense camera needs its driver: {install('realsense')}, and the package "
            f"libusb-1.0-0 of the system ({error})"
        ) from error
    return pyrealsense2


def _filters(rs: Any) -> tuple[Any, ...]:
    """librealsense's own post-processing in the order its vendor recommends.

    Holes are filled by `preprocess.fill_holes`, as calibration from images fills them.
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
    """Turns the camera's timestamps into times on the robot's clock.

    The frame that travelled fastest fixes the offset of both clocks, so that a frame held up on
    the way is as old as it is. The clocks may drift apart by `DRIFT`; a delay grows faster, or
    suddenly, and stays visible for as long as the stream lasts.
    """

    def __init__(self) -> None:
        self._offset, self._arrival = np.inf, -np.inf

    def time(self, stamp: float, arrival: float) -> float:
        """Seconds on the robot's clock of a frame stamped by the camera in seconds."""
        passed = max(arrival - self._arrival, 0.0) if np.isfinite(self._arrival) else 0.0
        self._offset = min(self._offset + DRIFT * passed, arrival - stamp)
        self._arrival = arrival
        return min(arrival, stamp + self._offset)


class RealSenseCamera(Camera):
    """A depth camera on a thread of its own.

    It opens the camera anew when frames stop, unless `busy`: librealsense stalls all threads.
    """

    def __init__(
        self,
        spec: CameraSpec,
        clock: Callable[[], float],
        device: Any = None,
        serial: str = "",
        upside_down: bool = False,
    ) -> None:
        """Set up without touching the camera; `clock` gives seconds on the robot's clock.

        `device` is an open librealsense device, such as a software device; by default the camera
        of this serial number, or the only one. `upside_down`: turned by 180 degrees in its mount.
        """
        self._spec, self._clock, self._device, self._serial = spec, clock, device, serial
        self._turn = -1 if upside_down else 1
        self._rs = realsense()
        self._latest: DepthFrame | None = None
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self.problem = ""
        """What went wrong last; empty while frames arrive."""

    def start(self) -> None:
        """Begin to stream; raises RenetError with what to do when that fails."""
        stream = self._open()
        self._thread = threading.Thread(target=self._run, args=(stream,), daemon=True)
        self._thread.start()
        # A thread inside librealsense would abort an interpreter that ends.
        atexit.register(self.close)

    def latest(self) -> DepthFrame | None:
        """Newest frame; None before the first."""
        return self._latest

    def close(self) -> None:
        """Stop streaming; safe to call twice."""
        atexit.unregister(self.close)
        self._stop.set()
        if self._thread is not None:
            self._thread.join(timeout=2 * SILENCE)

    def _open(self) -> tuple[Any, Any]:
        """Start the depth sensor; returns it and the queue its frames arrive in."""
        sensor, queue = None, self._rs.frame_queue(1)
        try:
            sensor = (self._device or self._find()).first_depth_sensor()
            profile = self._profile(sensor)
            self._preprocessor(profile)  # Refuses too narrow a view at once.
            if sensor.supports(self._rs.option.global_time_enabled):  # It follows the wall clock.
                sensor.set_option(self._rs.option.global_time_enabled, 0)
            sensor.open(profile)
            sensor.start(queue)
        except RuntimeError as error:
            if sensor is not None:
                _shut(sensor)
            raise RenetError(f"the RealSense camera does not start: {error}") from error
        return sensor, queue

    def _find(self) -> Any:
        devices = list(self._rs.context().query_devices())
        serials = [device.get_info(self._rs.camera_info.serial_number) for device in devices]
        matches = [d for d, s in zip(devices, serials, strict=True) if self._serial in ("", s)]
        if len(matches) == 1:
            return matches[0]
        seen = f"{', '.join(serials)} connected" if serials else "none is connected"
        if matches:
            raise RenetError(f"several RealSense cameras, {seen}: choose one with --serial")
        camera = f"RealSense camera {self._serial}".rstrip()
        raise RenetError(f"no {camera}: {seen}; check its USB 3 cable")

    def _profile(self, sensor: Any) -> Any:
        """The stream to open; raises RenetError if the sensor does not offer it."""
        profiles = [p.as_video_stream_profile() for p in sensor.get_stream_profiles()]
        profiles = [p for p in profiles if p and p.format() == self._rs.format.z16]
        for profile in profiles:
            if (profile.width(), profile.height(), profile.fps()) == (WIDTH, HEIGHT, FPS):
                return profile
        offered = ", ".join(f"{p.width()}x{p.height()}@{p.fps()}" for p in profiles) or "none"
        raise RenetError(
            f"the RealSense camera has no depth of {WIDTH}x{HEIGHT} at {FPS} Hz (it offers "
            f"{offered}): connect it by USB 3"
        )

    def _run(self, stream: tuple[Any, Any] | None) -> None:
        while stream is not None:
            try:
                self._stream(stream[1])
            except Exception as error:  # The robot walks on without its camera.
                self.problem = f"{type(error).__name__}: {error}"
            _shut(stream[0])
            stream = None
            while stream is None and not self._stop.wait(RETRY):
                try:
                    stream = None if self.busy else self._open()
                except Exception as error:
                    self.problem = str(error)

    def _stream(self, queue: Any) -> None:
        """Prepare frames until they stop."""
        chain, offset, last = _filters(self._rs), ClockOffset(), -np.inf
        while not self._stop.is_set():
            arrived, frame = queue.try_wait_for_frame(round(1000 * SILENCE))
            if not arrived:
                self.problem = f"no frame for {SILENCE:g} s"
                return
            now = self._clock()
            raw = frame.as_depth_frame()
            stamp = raw.get_timestamp() / 1000.0
            if stamp < last - RESTART:
                offset = ClockOffset()
            last = stamp
            filtered = reduce(lambda image, step: step.process(image), chain, raw).as_depth_frame()
            metres = np.asanyarray(filtered.get_data()) * filtered.get_units()
            pixels = np.asanyarray(raw.get_data())
            self._latest = DepthFrame(
                image=self._preprocessor(filtered.get_profile()).image(metres),
                number=raw.get_frame_number(),
                time=offset.time(stamp, now),
                invalid=self._preprocessor(raw.get_profile()).invalid(pixels),
            )
            self.problem = ""

    def _preprocessor(self, profile: Any) -> DepthPreprocessor:
        """For a stream's images; the vendor's pixel (0, 0) has its centre at (0, 0)."""
        lens = profile.as_video_stream_profile().get_intrinsics()
        middle = lens.ppx + 0.5, lens.ppy + 0.5
        focal = self._turn * lens.fx, self._turn * lens.fy
        intrinsics = Intrinsics(lens.height, lens.width, *focal, *middle)
        return DepthPreprocessor(intrinsics, self._spec)


def _shut(sensor: Any) -> None:
    """Stop and close, each of which fails if the camera is gone."""
    for end in (sensor.stop, sensor.close):
        with suppress(RuntimeError):
            end()
