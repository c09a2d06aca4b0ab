"""Scores of the image monitors in a folder of depth images, for `renet calibrate --images`."""

import math
import warnings
from pathlib import Path

import numpy as np

from renet.bundle import Bundle
from renet.bundle.models import known_shapes
from renet.camera import Intrinsics
from renet.deploy.cameras.floor_view import view_problem
from renet.deploy.cameras.preprocess import DepthPreprocessor
from renet.deploy.recording.calibration_log import MIN_MINUTES
from renet.errors import RenetError, reason
from renet.files import MEGABYTE, require_regular
from renet.interface import DEPTH_SHAPE, TICK_DT
from renet.selector.monitors import MONITORS, Scorer, SelectorInput

_IMAGE_MONITORS = [name for name, monitor in MONITORS.items() if monitor.of_image]
_OF_MOTION = ("frame_age", "surprise", "stillness")
OF_IMAGES = tuple(name for name in _IMAGE_MONITORS if name not in _OF_MOTION)
"""Monitors that judge images alone; files tell neither their ages nor how the robot moved."""
_MAX_BYTES = 16 * MEGABYTE
"""Largest size of an image file, bytes."""
_MEDIAN_RANGE = (0.1, 20.0)
"""Range of the median depth of a walking robot's images, m; beyond it the scale is wrong."""
_VIEW_ANGLE = math.radians(87.0)
"""Horizontal angle of view, rad, if no lens is given: that of a RealSense D435."""


def image_scores(
    folder: Path,
    scale: float,
    lens: tuple[float, float, float, float] | None,
    bundle: Bundle,
    upside_down: bool = False,
) -> dict[str, list[np.ndarray]]:
    """Score each image but the first two, as one walk: [T] by the monitor's name.

    Args:
        folder: Folder of PNG files of one channel, taken every 0.1 s, in the order of their names.
        scale: Metres of one step of their values; 0 stands for no measurement.
        lens: Focal lengths and principal point fx, fy, cx, cy, pixels; by default of a camera that
            sees 87 degrees horizontally, without distortion.
        bundle: Bundle with the vision model and the camera.
        upside_down: True if the camera is turned by 180 degrees in its mount.

    Raises:
        RenetError: There are too few images, one cannot be read, sizes differ, the lens sees too
            little, or no walking robot sees such depths.
    """
    paths = image_paths(folder)
    camera = _intrinsics(read_image(paths[0]).shape, lens)
    preprocessor = DepthPreprocessor(camera, bundle.manifest.camera, upside_down)
    judge = _ImageJudge(bundle)
    rows = []
    medians = []
    total = np.zeros(DEPTH_SHAPE)
    for path in paths:
        pixels = read_image(path)
        image = preprocessor.image(pixels * scale)
        rows.append(judge.scores(image, preprocessor.invalid(pixels)))
        total += image
        medians.append(np.median(pixels[pixels > 0]) * scale if pixels.any() else np.nan)
    _check_scale(medians)
    robot = bundle.manifest.robot.name
    if problem := view_problem(total / len(paths), bundle.manifest.camera, robot):
        raise RenetError(problem)
    columns = np.array(rows[2:]).T
    return {name: [column] for name, column in zip(OF_IMAGES, columns, strict=True)}


def image_paths(folder: Path) -> list[Path]:
    """Return the PNG files of a folder by name; raises RenetError if they are too few."""
    paths = sorted(folder.glob("*.png"))
    least = round(60.0 * MIN_MINUTES / TICK_DT)
    if len(paths) < least:
        raise RenetError(
            f"{folder} holds {len(paths)} PNG images; calibration needs at least {least}"
            f" ({MIN_MINUTES:g} minutes, one image every {TICK_DT:g} s)"
        )
    return paths


class _ImageJudge:
    """Scores of the image monitors for one image after the other."""

    def __init__(self, bundle: Bundle) -> None:
        self._vision = bundle.sessions["vision"]
        self._scorer = Scorer(1)
        outputs = {output.name for output in self._vision.get_outputs()}
        # Policies without a variance have the other score alone.
        self._outputs = [name for name in ("anomaly_score", "variance_score") if name in outputs]
        self._unknown: dict[str, np.ndarray] = {}
        """Inputs of the vision model that the scores of images alone do not depend on."""
        for name, shape in known_shapes(self._vision, bundle.manifest.history).items():
            self._unknown[name] = np.zeros((1, *shape), np.float32)
        self._previous: np.ndarray | None = None
        """The image before the newest, [1, 48, 64]."""

    def scores(self, image: np.ndarray, invalid: float) -> np.ndarray:
        """Score an image [48, 64] with a share of invalid pixels: [monitors of `OF_IMAGES`]."""
        newest = image[None]
        # The first image has none before it.
        previous = newest if self._previous is None else self._previous
        self._previous = newest
        # Vision judges pairs, the newest image first.
        feed = {"depth": np.stack((newest, previous), axis=1)} | self._unknown
        scores = dict(zip(self._outputs, self._vision.run(self._outputs, feed), strict=True))
        seen = SelectorInput(
            anomaly_score=scores["anomaly_score"].reshape(-1),
            variance_score=scores.get("variance_score", np.zeros(1)).reshape(-1),
            image=newest,
            fresh=np.ones(1, bool),
            invalid=np.array([invalid]),
        )
        return self._scorer.scores(seen, OF_IMAGES)[:, 0]


def _check_scale(medians: list[float]) -> None:
    """Raise RenetError if no walking robot's images have such median depths, m; NaN for none."""
    # Metres and millimetres are easily mistaken for each other.
    median = float(np.nanmedian(medians)) if np.isfinite(medians).any() else 0.0
    if not _MEDIAN_RANGE[0] <= median <= _MEDIAN_RANGE[1]:
        raise RenetError(
            f"the images' median depth is {median:g} m: give --scale, the metres of one step of"
            " their values (0.001 for millimetres)"
        )


def _intrinsics(
    shape: tuple[int, ...], lens: tuple[float, float, float, float] | None
) -> Intrinsics:
    """Make the intrinsics of images of a shape (rows, columns) and a lens, or the default one."""
    height, width = shape
    if lens is None:
        focal = width / 2 / math.tan(_VIEW_ANGLE / 2)
        lens = (focal, focal, width / 2, height / 2)
    return Intrinsics(height, width, *lens)


def read_image(path: Path) -> np.ndarray:
    """Read a PNG file of one channel, [rows, columns]; raises RenetError for any other file."""
    from PIL import Image

    require_regular(path, _MAX_BYTES, "image")
    try:
        # Of images with very many pixels Pillow only warns.
        with warnings.catch_warnings(action="error", category=Image.DecompressionBombWarning):
            image = Image.open(path, formats=["PNG"])
            pixels = np.asarray(image)
    except (OSError, SyntaxError, Warning) as error:
        raise RenetError(f"cannot read the image {path}: {reason(error)}") from error
    # The pixels of an image with a palette ("P") are numbers of its colours.
    if image.mode == "P" or pixels.ndim != 2:
        raise RenetError(f"{path} has colours: give depth images of one channel, of 16 bits")
    return pixels.astype(np.float64)
