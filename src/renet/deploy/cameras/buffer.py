"""Keeps the newest good image of a camera.

A frame that is malformed, no newer than the last, or an earlier image again is as good as none: the
image before it stays and grows old, and the selector leaves vision.
"""

import math
import zlib
from collections import deque

import numpy as np

from renet.deploy.cameras.base import DepthFrame
from renet.errors import RenetError
from renet.interface import DEPTH_SHAPE
from renet.pilot.images import OLDEST, Images

REMEMBERED = 32
"""Images that may not come again, one second of a camera with 30 a second."""
FUTURE = 0.05
"""Seconds by which a frame's time may run ahead of the robot's clock."""


class FrameBuffer:
    """Checks every frame and keeps the newest good one; never raises."""

    def __init__(self) -> None:
        self.image: np.ndarray | None = None
        """[48, 64] float32, rounded as in training; None before the first good frame."""
        self.invalid = 0.0
        """Share of its pixels without a measurement."""
        self.problem = ""
        """What was wrong with the last frame offered; empty if nothing was."""
        self._earlier: deque[int] = deque(maxlen=REMEMBERED)
        """Checksums of the images before the newest."""
        self._checksum = 0
        self._frame: DepthFrame | None = None
        self._time = -math.inf
        self._fresh = False

    def offer(self, frame: DepthFrame | None, now: float) -> None:
        """Look at what the camera has; called at every control tick."""
        self.problem = ""
        if frame is None or frame is self._frame:
            return
        try:
            image, time = clean_frame(frame, now)
        except RenetError as error:
            self.problem = str(error)
            return
        if time <= self._time:
            return  # The same frame again, or one that arrived out of order.
        checksum = zlib.crc32(image.tobytes())
        # The same image twice in a row is for a monitor to judge, as is one without contrast.
        if checksum in self._earlier and checksum != self._checksum and np.ptp(image) > 0.0:
            self.problem = "an earlier depth image came again"
            return
        if checksum != self._checksum:
            self._earlier.append(self._checksum)
            self._checksum = checksum
        self.image, self._frame, self._time, self._fresh = image, frame, time, True
        self.invalid = float(frame.invalid)

    def age(self, now: float) -> float:
        """Seconds since the image was taken, or until then after a clock's jump back."""
        return min(abs(now - self._time), OLDEST)

    def take(self, now: float) -> Images:
        """The newest image for a pilot of one robot; it is fresh once."""
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
    """Image [48, 64] float32 and time of a frame; raises RenetError naming what is wrong.

    Images are rounded to half precision, in which training saw them.
    """
    try:
        with np.errstate(over="ignore"):
            image = np.asarray(frame.image, np.float16).astype(np.float32)
        time, invalid, _ = float(frame.time), float(frame.invalid), int(frame.number)
    except Exception as error:  # A driver's object may fail in any way.
        raise RenetError("the depth frame is none, or not made of numbers") from error
    if image.shape != DEPTH_SHAPE:
        raise RenetError(f"the depth image has shape {image.shape}, expected {DEPTH_SHAPE}")
    if not np.isfinite(image).all():
        raise RenetError("the depth image is not finite")
    if image.min() < 0.0 or image.max() > 1.0:
        raise RenetError("the depth image leaves [0, 1]")
    if not (math.isfinite(time) and 0.0 <= invalid <= 1.0):
        raise RenetError("the depth frame's time or invalid share cannot be right")
    if time > now + FUTURE:
        raise RenetError("the depth frame's time lies in the future")
    return image, time
