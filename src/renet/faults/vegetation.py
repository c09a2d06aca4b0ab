"""Tall grass, as a stereo camera at the height of a small robot sees it."""

import numpy as np

from renet.camera import Intrinsics
from renet.faults.base import ImageFault
from renet.interface import DEPTH_RANGE

CAMERA_HEIGHT = 0.33
"""Height of the Go1's camera above the ground during a walk, m."""
CAMERA_PITCH = np.radians(30.0)
"""Downward tilt of the camera, rad."""
NEAR_RANGE = 0.15
"""Smallest depth that the camera measures, m. Nearer blades are holes, which hide the ground."""
BLADE_DISTANCE = (0.05, 1.2)
"""Smallest and largest distance of a blade along the ground, m."""
BLADE_HEIGHT = (0.15, 0.5)
"""Smallest and largest height of a blade, m."""
BLADE_WIDTH = 0.008
"""Width of a blade, m."""
BLADE_LEAN = 0.15
"""Largest sideways distance of a blade's tip from its root, m."""
UNMATCHED = 0.3
"""Share of a blade's pixels without a match, because it is narrower than the matcher's window."""


class TallGrass(ImageFault):
    """Blades of 15 to 50 cm, new in every frame: near ones and parts of others are holes, the rest
    hides the ground; level is their number in view.

    A blade is a strip from root to tip in perspective, for a camera of the Go1's pose.
    """

    unit = "blades"
    levels = (8, 20, 45, 90, 180)

    def spoil(self, image: np.ndarray, robot: int, elapsed: float) -> np.ndarray:
        """The image behind the blades; those too near and part of the others are holes."""
        blades = self.depth(robot)
        unmatched = self.rngs[robot].random(image.shape) < UNMATCHED
        lost = unmatched | (blades < NEAR_RANGE / DEPTH_RANGE)
        lost &= (blades < 1.0) & (image >= blades)
        return np.where(lost, np.nan, np.minimum(image, blades))

    def depth(self, robot: int) -> np.ndarray:
        """Draw the blades of one frame.

        Returns:
            Normalised depth of the nearest blade in each pixel, [48, 64]; infinity without one.
        """
        rng = self.rngs[robot]
        count = int(self.level)
        camera = Intrinsics()
        # Distances are log-uniform.
        low, high = np.log(BLADE_DISTANCE)
        distance = np.exp(rng.uniform(low, high, count))[:, None]
        height = rng.uniform(*BLADE_HEIGHT, (count, 1))
        half_view = 0.5 * camera.width / camera.fx
        root = rng.uniform(-half_view, half_view, (count, 1)) * distance / np.cos(CAMERA_PITCH)
        lean = rng.uniform(-BLADE_LEAN, BLADE_LEAN, (count, 1))
        # Point at which the rays of each row meet the upright plane of each blade, [blades, rows]:
        # its distance below the camera, its depth, and its position along the blade.
        rows = np.arange(camera.height) + 0.5 - camera.cy
        drop = distance * np.tan(CAMERA_PITCH + np.arctan(rows / camera.fy))
        depth = distance * np.cos(CAMERA_PITCH) + drop * np.sin(CAMERA_PITCH)
        along = (CAMERA_HEIGHT - drop) / height
        middle = camera.cx + camera.fx * (root + along * lean) / depth
        half_width = 0.5 * np.maximum(camera.fx * BLADE_WIDTH / depth, 1.0)
        columns = np.arange(camera.width) + 0.5
        hit = np.abs(columns - middle[..., None]) <= half_width[..., None]
        hit &= ((along >= 0) & (along <= 1))[..., None]
        nearest = np.where(hit, depth[..., None] / DEPTH_RANGE, np.inf).min(axis=0)
        return nearest.astype(np.float32)
