"""Comparison of a camera's images with its view of a level floor, as its mount predicts it."""

import math

import numpy as np

from renet.bundle.manifest import CameraSpec
from renet.robots import robots

_NEAREST = 4
"""The lowest of so many equal parts of an image shows floor in front of most obstacles."""
_SCALES = (0.55, 1.8)
"""Range of the depth in that part over the depth of the floor; a unit wrong by half is outside."""
_MIN_ERROR = 0.12
"""Smallest mean difference from the floor, as a share of the camera's range, from which an image
may be upside down."""
_TURNED_SHARE = 0.5
"""Largest share of that difference that remains once such an image is turned."""


def floor_view(camera: CameraSpec, height: float) -> np.ndarray:
    """Return the image [48, 64], 0 to 1, of a level floor from the camera of a standing robot.

    Args:
        camera: Lens of the camera, and its mount on the base.
        height: Height of the base above the floor, m.
    """
    # Distance down of each row's rays, m, one metre ahead of the lens.
    up = camera.intrinsics.axes()[1]
    down = math.sin(camera.pitch) - up * math.cos(camera.pitch)
    eye = height + camera.position[2]
    depth = np.where(down > 0.0, eye / np.maximum(down, 1e-6), np.inf)
    image = np.minimum(depth, camera.range) / camera.range
    return np.repeat(image[:, None], camera.width, axis=1)


def view_problem(image: np.ndarray, camera: CameraSpec, robot: str) -> str:
    """Return why a robot on nearly level ground cannot have taken an image; empty if it can.

    Args:
        image: Depths as shares of the camera's range, [48, 64]; may be the mean of several images.
        camera: Camera of the robot.
        robot: Name of the robot. The camera of a robot without a description is at an unknown
            height: all its images pass.
    """
    if robot not in robots():
        return ""
    floor = floor_view(camera, robots()[robot].height)
    error = float(np.abs(image - floor).mean())
    turned = float(np.abs(image[::-1, ::-1] - floor).mean())
    if error > _MIN_ERROR and turned < _TURNED_SHARE * error:
        return "the images are upside down: turn them by --rotate 180, or leave that option out"
    rows = slice(-(len(floor) // _NEAREST), None)
    scale = float(np.median(image[rows] / floor[rows]))
    if not _SCALES[0] <= scale <= _SCALES[1]:
        return (
            f"the depth in front of the robot is {scale:.2g} times that of a level floor: check the"
            " unit of the depths and the camera's mount"
        )
    return ""
