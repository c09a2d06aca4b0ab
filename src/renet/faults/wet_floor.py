"""Polished and wet floors, in which things above them appear below the floor.

RealSense users find wrong depth on them (librealsense#8409, librealsense#10229), and
time-of-flight users a scene upside down in the ground (github.com/ifm/ifm3d/issues/118).
"""

from functools import cache

import numpy as np

from renet.camera import Intrinsics
from renet.faults.base import ImageFault
from renet.faults.image import COLUMNS
from renet.faults.vegetation import CAMERA_HEIGHT, CAMERA_PITCH
from renet.interface import DEPTH_RANGE

STREAK = (16, 4)
"""Rows and columns of a lamp's mirror image."""
SWAY_COLUMNS = 4.0
"""Columns by which mirror images move to either side as the body sways."""
SWAY_PERIOD = 3.0
"""Period of the sway, s."""
HORIZON = 0.97
"""Normalised depth below which pixels show the floor."""
APPROACH = 0.5
"""Speed at which a patch comes nearer, m/s."""
WET = (0.3, 1.3)
"""Distances along the ground at which a patch disappears and appears, m."""
IN_FRONT = 0.8
"""Share of the floor's depth below which an object stands in front of the floor."""


class FloorReflection(ImageFault):
    """Lamps in a polished floor: streaks below the horizon read the farthest depth, like pits;
    level is their number.
    """

    unit = "lamps"
    levels = (1, 2, 3, 4, 6)

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """Draw each streak's left column."""
        return rng.uniform(0, COLUMNS - STREAK[1], int(self.level))

    def spoil(self, image: np.ndarray, robot: int, elapsed: float) -> np.ndarray:
        """The image with streaks from where each lamp's part of the floor begins."""
        spoilt = image.copy()
        sway = SWAY_COLUMNS * np.sin(2 * np.pi * elapsed / SWAY_PERIOD)
        lefts = np.clip(self.patterns[robot] + sway, 0, COLUMNS - STREAK[1]).astype(int)
        for left in lefts.tolist():
            columns = slice(left, left + STREAK[1])
            floor = np.flatnonzero(image[:, columns].mean(axis=1) < HORIZON)
            if floor.size:
                spoilt[floor[0] : floor[0] + STREAK[0], columns] = 1.0
        return spoilt


class WetPatch(ImageFault):
    """A puddle mirrors the sky: a square of floor reads the farthest depth, comes nearer at walking
    speed, and is followed by the next; level is its width.

    It lies on level ground before a camera of the Go1's pose.
    """

    unit = "m"
    levels = (0.15, 0.25, 0.4, 0.6, 0.9)

    def draw(self, rng: np.random.Generator) -> tuple[float, float]:
        """Draw a patch's distance to the left of the camera, and its way so far, m."""
        return rng.uniform(-0.2, 0.2), rng.uniform(0.0, WET[1] - WET[0])

    def spoil(self, image: np.ndarray, robot: int, elapsed: float) -> np.ndarray:
        """The image with the patch where the floor is not hidden."""
        left, travelled = self.patterns[robot]
        ahead = WET[1] - (travelled + APPROACH * elapsed) % (WET[1] - WET[0])
        depth, forward, sideways = floor()
        wet = np.maximum(np.abs(forward - ahead), np.abs(sideways - left)) <= self.level / 2
        wet &= image >= IN_FRONT * np.minimum(depth / DEPTH_RANGE, 1.0)
        return np.where(wet, np.float32(1.0), image)


@cache
def floor() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute the position of level ground in each pixel; the horizon is above the image.

    Returns:
        Depth, distance ahead, and distance to the left, [48, 64] m each.
    """
    left, up = Intrinsics().axes()
    drop = np.sin(CAMERA_PITCH) - up * np.cos(CAMERA_PITCH)
    depth = np.repeat(CAMERA_HEIGHT / drop[:, None], COLUMNS, axis=1)
    forward = depth * (np.cos(CAMERA_PITCH) + up * np.sin(CAMERA_PITCH))[:, None]
    return depth, forward, depth * left
