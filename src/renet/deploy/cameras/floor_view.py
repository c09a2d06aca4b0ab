"""Comparison of a camera's images with the view of a level floor that its mount leads to expect."""

import math

import numpy as np

from renet.bundle.manifest import CameraSpec

_NEAREST = 4
"""One in so many rows, from the bottom of the image up, shows floor in front of most obstacles."""
_SCALES = (0.55, 1.8)
"""Range of the depth there over that of the floor: a unit that is wrong by half leaves it."""
_MIN_ERROR = 0.12
"""Least mean difference from the floor, as a share of the camera's range, of an image that can be
called upside down."""
_TURNED_SHARE = 0.5
"""Largest share of that difference that may remain once such an image is turned."""


def floor_view(camera: CameraSpec, height: float) -> np.ndarray:
    """Image [48, 64] in [0, 1] of a level floor by the camera of a robot that stands.

    Args:
        camera: its lens, and its mount on the base.
        height: of the base over the floor, m.
    """
    # Of the rays that go one metre ahead of the lens: how far down they get.
    up = camera.intrinsics.axes()[1]
    down = math.sin(camera.pitch) - up * math.cos(camera.pitch)
    eye = height + camera.position[2]
    depth = np.where(down > 0.0, eye / np.maximum(down, 1e-6), np.inf)
    image = np.minimum(depth, camera.range) / camera.range
    return np.repeat(image[:, None], camera.width, axis=1)


def view_problem(image: np.ndarray, floor: np.ndarray) -> str:
    """Reason why an image [48, 64] cannot be that of a robot on nearly level ground; empty if none.

    Args:
        image: depths as shares of the camera's range, 0 to 1; a mean of several will do.
        floor: the one that `floor_view` expects.
    """
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
