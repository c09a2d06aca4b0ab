"""The image monitors' scores of somebody's depth images, for `renet calibrate --images`."""

import math
import warnings
from pathlib import Path

import numpy as np

from renet.bundle import Bundle
from renet.camera import Intrinsics
from renet.deploy.cameras.preprocess import DepthPreprocessor
from renet.deploy.recording.calibration_log import MIN_MINUTES
from renet.errors import RenetError, reason
from renet.files import MEGABYTE, require_regular
from renet.interface import TICK_DT
from renet.selector.monitors import MONITORS, Scorer, SelectorInput

OF_IMAGES = tuple(n for n, m in MONITORS.items() if m.of_image and n != "frame_age")
"""Monitors that judge images alone; files do not tell when their images were taken."""
MAX_IMAGE = 16 * MEGABYTE
"""Bytes of a file."""
PLAUSIBLE = 0.1, 20.0
"""Median depth of a walking robot's images, m; beyond it the scale is wrong."""
WIDTH = math.radians(87.0)
"""Horizontal angle of view of a camera whose lens is not given: a RealSense D435's."""


def image_scores(
    folder: Path, scale: float, lens: tuple[float, float, float, float] | None, bundle: Bundle
) -> dict[str, list[np.ndarray]]:
    """The scores of each image but the first two, [T], by monitor name, as one walk.

    Args:
        folder: of PNG files of one channel, one taken every 0.1 s, in the order of their names.
        scale: metres of one step of their values; 0 stands for no measurement.
        lens: focal lengths and principal point fx, fy, cx, cy, pixels; by default those of a
            camera that sees 87 degrees horizontally, without distortion.

    Raises:
        RenetError: too few images, one that is none, sizes that differ, a lens that sees too
            little, or depths that no walking robot sees.
    """
    paths = sorted(folder.glob("*.png"))
    least = round(60.0 * MIN_MINUTES / TICK_DT)
    if len(paths) < least:
        raise RenetError(
            f"{folder} holds {len(paths)} PNG images; calibration needs at least {least}"
            f" ({MIN_MINUTES:g} minutes, one image every {TICK_DT:g} s)"
        )
    vision, scorer = bundle.sessions["vision"], Scorer(1)
    outputs = {output.name for output in vision.get_outputs()}
    names = [name for name in ("anomaly_score", "variance_score") if name in outputs]
    preprocessor, newest, rows, medians = None, np.zeros(0), [], []
    for path in paths:
        pixels = read_image(path)
        if preprocessor is None:
            height, width = pixels.shape
            focal = width / 2 / math.tan(WIDTH / 2)
            intrinsics = lens or (focal, focal, width / 2, height / 2)
            camera = Intrinsics(height, width, *intrinsics)
            preprocessor = DepthPreprocessor(camera, bundle.manifest.camera)
        older, newest = newest, preprocessor.image(pixels * scale)[None]
        pair = np.stack((newest, older if older.size else newest), axis=1)
        scores = dict(zip(names, vision.run(names, {"depth": pair}), strict=True))
        seen = SelectorInput(
            anomaly_score=scores["anomaly_score"].reshape(-1),
            variance_score=scores.get("variance_score", np.zeros(1)).reshape(-1),
            image=newest,
            fresh=np.ones(1, bool),
            invalid=np.array([preprocessor.invalid(pixels)]),
        )
        rows.append(scorer.scores(seen, OF_IMAGES)[:, 0])
        medians.append(np.median(pixels[pixels > 0]) * scale if pixels.any() else np.nan)
    median = float(np.nanmedian(medians)) if np.isfinite(medians).any() else 0.0
    if not PLAUSIBLE[0] <= median <= PLAUSIBLE[1]:
        raise RenetError(
            f"the images' median depth is {median:g} m: give --scale, the metres of one step of"
            " their values (0.001 for millimetres)"
        )
    return {name: [column] for name, column in zip(OF_IMAGES, np.array(rows[2:]).T, strict=True)}


def read_image(path: Path) -> np.ndarray:
    """Values [rows, columns] of an image file of one channel; raises RenetError otherwise."""
    from PIL import Image

    require_regular(path, MAX_IMAGE, "image")
    try:
        with warnings.catch_warnings(action="error", category=Image.DecompressionBombWarning):
            pixels = np.asarray(Image.open(path, formats=["PNG"]))
    except (OSError, SyntaxError, Warning) as error:
        raise RenetError(f"cannot read the image {path}: {reason(error)}") from error
    if pixels.ndim != 2:
        raise RenetError(f"{path} has colours: give depth images of one channel, of 16 bits")
    return pixels.astype(np.float64)
