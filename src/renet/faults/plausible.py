"""Wrong images that look healthy, without holes and noise.

Depths are normalised: 1 is `DEPTH_RANGE` metres. A number after the name of a project is that of
its public issue, so that librealsense#7588 is github.com/realsenseai/librealsense/issues/7588.
"""

from dataclasses import replace

import numpy as np

from renet.faults.base import FOREVER, Fault, Frames, ImageFault
from renet.faults.image import COLUMNS, ROWS
from renet.faults.timing import Frozen
from renet.interface import DEPTH_RANGE


class Mirrored(ImageFault):
    """Left and right are exchanged, by a setting that a restart of the driver resets; level is for
    how many seconds.

    Users flip depth in their programs, to see themselves as in a mirror (librealsense#9389).
    """

    unit = "s"
    levels = (0.2, 0.5, 1.0, 3.0, FOREVER)
    level_is_duration = True

    def spoil(self, image: np.ndarray, robot: int, elapsed: float) -> np.ndarray:
        return image[:, ::-1]


class Turned(ImageFault):
    """The picture is turned about its middle: a camera mounted on its side or upside down, or a
    setting that should undo it; level is the angle.

    Cameras are mounted upside down for their cables (realsense-ros#798), and drivers that turn
    images turn depth wrongly (depthai-ros#750).
    """

    unit = "°"
    levels = (5, 15, 45, 90, 180)

    def spoil(self, image: np.ndarray, robot: int, elapsed: float) -> np.ndarray:
        """Take the nearest pixel of the turned image; its border is repeated."""
        middle_row = (ROWS - 1) / 2
        middle_column = (COLUMNS - 1) / 2
        rows, columns = np.mgrid[:ROWS, :COLUMNS]
        down = rows - middle_row
        right = columns - middle_column
        sine = np.sin(np.radians(self.level))
        cosine = np.cos(np.radians(self.level))
        row = np.rint(middle_row + cosine * down + sine * right).astype(int)
        column = np.rint(middle_column + cosine * right - sine * down).astype(int)
        return image[row.clip(0, ROWS - 1), column.clip(0, COLUMNS - 1)]


class Split(ImageFault):
    """Transfers begin late: the image is moved down, and its last rows stand above its first ones;
    level is their share.

    Users see a crack across the image until the camera is started anew (librealsense#7777).
    """

    unit = "share"
    levels = (0.1, 0.2, 0.3, 0.4, 0.5)

    def spoil(self, image: np.ndarray, robot: int, elapsed: float) -> np.ndarray:
        return np.roll(image, round(self.level * ROWS), axis=0)


class HalfFrozen(Frozen):
    """A band of rows keeps what it showed before the fault, and the others are live; level is the
    band's share of the image.

    A buffer that is written in part brings a strip of an old frame (librealsense#7588).
    """

    unit = "share"
    levels = (0.2, 0.35, 0.5, 0.65, 0.8)
    level_is_duration = False

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """Draw a mask of the frozen rows, [48] bool."""
        height = round(self.level * ROWS)
        top = rng.integers(0, ROWS - height + 1)
        rows = np.arange(ROWS)
        return (rows >= top) & (rows < top + height)

    def corrupt(self, frames: Frames, elapsed: np.ndarray) -> Frames:
        """Put the band of the last image from before the fault into the images."""
        last = super().corrupt(frames, elapsed).image
        frozen = np.array(self.patterns)[:, :, None]
        return replace(frames, image=np.where(frozen, last, frames.image))


class TemporalFilter(Fault):
    """Each image is mixed with the one delivered before it, so that edges trail behind; level is
    the past's share.

    RealSense's filter has a share of 0.6 by default; users see after-images with it
    (librealsense#13670, librealsense#9589).
    """

    unit = "share"
    levels = (0.6, 0.75, 0.85, 0.9, 0.95)
    _past: np.ndarray | None = None

    def corrupt(self, frames: Frames, elapsed: np.ndarray) -> Frames:
        """The exponential mean of the images since the fault began."""
        if self._past is None:
            self._past = frames.image.copy()
        share = np.where(elapsed < 0, 0.0, self.level).astype(np.float32)[:, None, None]
        self._past = share * self._past + (1 - share) * frames.image
        return replace(frames, image=self._past.copy())


class GainDrift(ImageFault):
    """Depths grow or shrink by a part of themselves in every second, to half or double at most;
    level is that part.

    As cameras warm up depth drifts by 2 % in half an hour (librealsense#684,
    libfreenect2#535), and for no known reason by 10 % (librealsense#12457). Here it is quicker.
    """

    unit = "%/s"
    levels = (2, 5, 10, 20, 40)

    def draw(self, rng: np.random.Generator) -> float:
        """Draw 1 for depths that grow, or -1 for depths that shrink."""
        return rng.choice((-1.0, 1.0))

    def spoil(self, image: np.ndarray, robot: int, elapsed: float) -> np.ndarray:
        factor = min((1 + self.level / 100) ** elapsed, 2.0)
        return image * np.float32(factor ** self.patterns[robot])


class WrapAround(ImageFault):
    """Depth begins at zero again beyond a range, as the phase of a time-of-flight camera does;
    level is the range.

    It is c / 2f for light modulated at f: 1.5 m at 100 MHz (docs.chronoptics.com, Phase Wrapping;
    Droeschel et al. 2010, Multi-frequency Phase Unwrapping for Time-of-Flight Cameras).
    """

    unit = "m"
    levels = (1.8, 1.5, 1.2, 1.0, 0.75)

    def spoil(self, image: np.ndarray, robot: int, elapsed: float) -> np.ndarray:
        """The remainder of each depth; pixels out of the camera's range return no light."""
        wrapped = np.mod(image, np.float32(self.level / DEPTH_RANGE))
        return np.where(image < 1.0, wrapped, image)


class Quantised(ImageFault):
    """Depth has lost its last binary digits: the ground becomes terraces, each at the middle of the
    depths that it stands for; level is their height.

    Depth of 16 bits in mm is cut to 8 bits on its way (realsense-ros#2140), which leaves steps of
    256 mm, or is sent in decimetres to save bandwidth (zed-ros-wrapper#313).
    """

    unit = "mm"
    levels = (32, 64, 128, 256, 512)

    def spoil(self, image: np.ndarray, robot: int, elapsed: float) -> np.ndarray:
        """The image of rounded depths; pixels out of range stay as they are."""
        step = np.float32(1e-3 * self.level / DEPTH_RANGE)
        terraces = (np.floor(image / step) + np.float32(0.5)) * step
        return np.where(image < 1.0, terraces, image)


class StrayLight(ImageFault):
    """Light of something close by is scattered in the lens and draws every depth towards its own;
    level is by which share.

    Scattering is a systematic error of time-of-flight cameras (Schäfer et al. 2014, Model Based
    Scattering Correction in Time-of-Flight Cameras). The source is 10 to 50 cm away.
    """

    unit = "share"
    levels = (0.1, 0.2, 0.35, 0.5, 0.7)

    def draw(self, rng: np.random.Generator) -> float:
        """Draw the normalised depth of the source of the light."""
        return rng.uniform(0.1, 0.5) / DEPTH_RANGE

    def spoil(self, image: np.ndarray, robot: int, elapsed: float) -> np.ndarray:
        share = np.float32(self.level)
        return (1 - share) * image + share * np.float32(self.patterns[robot])
