"""Tall grass, seen by a stereo camera at the height of a small robot."""

import numpy as np

from renet.camera import Intrinsics
from renet.faults.base import ImageFault
from renet.interface import DEPTH_RANGE

CAMERA_HEIGHT = 0.33
"""m of the Go1's camera above the ground while it walks."""
CAMERA_PITCH = np.radians(30.0)
"""Downward."""
NEAR_RANGE = 0.15
"""m of depth; nearer blades are holes, and hide what is behind them."""
REACH = (0.05, 1.2)
"""m on the ground to the nearest and the farthest blade."""
HEIGHT = (0.15, 0.5)
"""m; shortest and tallest blade."""
WIDTH = 0.008
"""m of a blade."""
SWAY = 0.15
"""m; largest sideways distance of a blade's tip from its root."""
UNMATCHED = 0.3
"""Share of a blade's pixels without a match, as it is narrower than the matcher's window."""


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
        """Depth [48, 64] of the nearest blade in one frame, infinity where there is none."""
        rng, count, camera = self.rngs[robot], int(self.level), Intrinsics()
        distance = np.exp(rng.uniform(np.log(REACH[0]), np.log(REACH[1]), count))[:, None]
        height = rng.uniform(*HEIGHT, (count, 1))
        half_view = 0.5 * camera.width / camera.fx
        root = rng.uniform(-half_view, half_view, (count, 1)) * distance / np.cos(CAMERA_PITCH)
        lean = rng.uniform(-SWAY, SWAY, (count, 1))
        # Where each row's rays meet the upright plane a blade stands in, [count, rows].
        rows = np.arange(camera.height) + 0.5 - camera.cy
        drop = distance * np.tan(CAMERA_PITCH + np.arctan(rows / camera.fy))
        depth = distance * np.cos(CAMERA_PITCH) + drop * np.sin(CAMERA_PITCH)
        along = (CAMERA_HEIGHT - drop) / height
        middle = camera.cx + camera.fx * (root + along * lean) / depth
        half_width = 0.5 * np.maximum(camera.fx * WIDTH / depth, 1.0)
        columns = np.arange(camera.width) + 0.5
        hit = np.abs(columns - middle[..., None]) <= half_width[..., None]
        hit &= ((along >= 0) & (along <= 1))[..., None]
        nearest = np.where(hit, depth[..., None] / DEPTH_RANGE, np.inf).min(axis=0)
        return nearest.astype(np.float32)
