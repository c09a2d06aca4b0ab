"""Buffer of the newest good image of a camera.

A frame that is malformed, not newer than the last, or a repetition of an earlier image is dropped:
the image before it stays and grows old, until the selector leaves vision.
"""

import math
import zlib
from collections import deque

import numpy as np

from renet.deploy.cameras.base import DepthFrame
from renet.errors import RenetError
from renet.interface import DEPTH_SHAPE
from renet.pilot.images import OLDEST, Images

_HISTORY = 32
"""Number of earlier images that must not come again: one second of a camera at 30 Hz."""
_MAX_AHEAD = 0.05
"""Largest time, s, by which a frame's time may lie ahead of the robot's clock."""


class FrameBuffer:
    """Checks every frame and keeps the newest good one; never raises."""

    def __init__(self) -> None:
        self.image: np.ndarray | None = None
        """[48, 64] float32, rounded to half precision as in training; None before the first."""
        self.invalid = 0.0
        """Share of the image's pixels without a measurement, 0 to 1."""
        self.problem = ""
        """Reason why the last frame was dropped; empty if it was not."""
        self._earlier: deque[int] = deque(maxlen=_HISTORY)
        """Checksums of the images before the newest."""
        self._checksum = 0
        """Checksum of the newest image."""
        self._frame: DepthFrame | None = None
        self._time = -math.inf
        self._fresh = False
        """True until the newest image was taken."""

    def offer(self, frame: DepthFrame | None, now: float) -> None:
        """Check the camera's newest frame at `now`, s; called at every control tick."""
        self.problem = ""
        if frame is None or frame is self._frame:
            return
        try:
            image, time = clean_frame(frame, now)
        except RenetError as error:
            self.problem = str(error)
            return
        # The same frame again, or one that arrived out of order.
        if time <= self._time:
            return
        checksum = zlib.crc32(image.tobytes())
        # Equal images in a row, and those without contrast, are left to the monitors.
        if checksum in self._earlier and checksum != self._checksum and np.ptp(image) > 0.0:
            self.problem = "an earlier depth image came again"
            return
        if checksum != self._checksum:
            self._earlier.append(self._checksum)
            self._checksum = checksum
        self.image = image
        self._frame = frame
        self._time = time
        self._fresh = True
        self.invalid = float(frame.invalid)

    def age(self, now: float) -> float:
        """Return the image's age at `now`, s, at most `OLDEST`; positive even after a jump back."""
        return min(abs(now - self._time), OLDEST)

    def take(self, now: float) -> Images:
        """Return the newest image for a pilot of one robot, marked as fresh the first time only."""
        fresh = self._fresh
        self._fresh = False
        return Images(
            image=None if self.image is None else self.image[None],
            fresh=np.array([fresh]),
            age=np.array([self.age(now)]),
            invalid=np.array([self.invalid]),
            broken=np.array([bool(self.problem)]),
        )


def clean_frame(frame: DepthFrame, now: float) -> tuple[np.ndarray, float]:
    """Return the image, [48, 64] float32, and the time, s, of a frame.

    Images are rounded to half precision, as in training.

    Raises:
        RenetError: The frame is malformed; the message names what is wrong.
    """
    try:
        with np.errstate(over="ignore"):
            image = np.asarray(frame.image, np.float16).astype(np.float32)
        time = float(frame.time)
        invalid = float(frame.invalid)
        int(frame.number)
    except Exception as error:
        # A driver's object may fail in any way.
        raise RenetError("the depth frame is none, or not made of numbers") from error
    if image.shape != DEPTH_SHAPE:
        raise RenetError(f"the depth image has shape {image.shape}, expected {DEPTH_SHAPE}")
    if not np.isfinite(image).all():
        raise RenetError("the depth image is not finite")
    if image.min() < 0.0 or image.max() > 1.0:
        raise RenetError("the depth image leaves [0, 1]")
    if not (math.isfinite(time) and 0.0 <= invalid <= 1.0):
        raise RenetError("the depth frame's time or invalid share cannot be right")
    if time > now + _MAX_AHEAD:
        raise RenetError("the depth frame's time lies in the future")
    return image, time
