"""Calibration from somebody's depth images: millimetres, holes, a lens of 640 x 480."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from renet.bundle import DEFAULT, Bundle, pretrained, read_manifest
from renet.deploy.recording import calibration_images
from renet.deploy.recording.calibration_images import OF_IMAGES, image_scores
from renet.errors import RenetError
from renet.evaluation import calibrate
from renet.evaluation.calibrate import CalibrateCfg, run_calibrate

COUNT = 40
DOWN = 0.5 + 0.866 * (np.arange(480) - 239.5) / 337.2
"""How far down the ray of each row gets in a metre, of a lens that looks down by 30 degrees."""
PLANE = np.minimum(308.0 / np.maximum(DOWN, 0.05), 6000.0)
"""Depths [480] of a floor, mm, seen from 0.308 m above it."""


@pytest.fixture(autouse=True)
def few_images_will_do(monkeypatch):
    monkeypatch.setattr(calibration_images, "MIN_MINUTES", COUNT / 600)


@pytest.fixture(scope="module")
def images(tmp_path_factory) -> Path:
    """A floor in millimetres, with grain, and a hole of a tenth of the image."""
    random, path = np.random.default_rng(0), tmp_path_factory.mktemp("images")
    for number in range(COUNT):
        plane = PLANE[:, None] + random.normal(0, 10, (480, 640))
        plane[:48] = 0
        image = Image.fromarray(plane.astype(np.uint16))
        image.save(path / f"{number:05}.png", compress_level=1)
    return path


@pytest.fixture
def folder(images, tmp_path) -> Path:
    """A copy of the images, to be spoilt."""
    return Path(shutil.copytree(images, tmp_path / "images"))


def test_images_in_millimetres_set_the_thresholds_of_image_monitors_alone(folder, tmp_path):
    bundle = Path(shutil.copytree(pretrained(DEFAULT), tmp_path / "bundle"))
    before = read_manifest(bundle).selector
    run_calibrate(CalibrateCfg(bundle, images=folder))
    after = read_manifest(bundle).selector
    scores = image_scores(folder, 0.001, None, Bundle.load(bundle))
    assert scores.keys() == set(OF_IMAGES)
    assert after.beta == pytest.approx(scores["reconstruction"][0].max())
    assert f"maximum of {COUNT - 2} scores of images" in after.calibration
    learned = {name for name, _ in after.thresholds.items() - before.thresholds.items()}
    assert "variance" in learned
    assert not learned & {"disagreement", "frame_age", "map_error"}
    assert after.longest_memory == before.longest_memory


def test_pixels_are_metres_of_the_policys_view(folder):
    scores = image_scores(folder, 0.001, None, Bundle.load())
    # Rows 76 to 404 of 480 are seen: the hole above is not, and the contrast is the plane's.
    assert (scores["invalid_fraction"][0] == 0.0).all()
    seen = np.minimum(PLANE[76:404] / 2000, 1)
    np.testing.assert_allclose(scores["uniformity"][0], -seen.std(), atol=0.02)
    low = image_scores(folder, 0.001, (337.0, 337.0, 320.0, 190.0), Bundle.load())
    assert (low["invalid_fraction"][0] > 0.0).all()


def test_scattered_holes_do_not_lift_the_scores(folder):
    clean = image_scores(folder, 0.001, None, Bundle.load())["reconstruction"][0]
    random = np.random.default_rng(1)
    for path in folder.glob("*.png"):
        pixels = np.array(Image.open(path))
        pixels[random.random(pixels.shape) < 0.02] = 0
        Image.fromarray(pixels).save(path, compress_level=1)
    spoilt = image_scores(folder, 0.001, None, Bundle.load())["reconstruction"][0]
    # Holes that are read as far multiply the score by two hundred.
    assert spoilt.max() < 2.0 * clean.max()


def test_images_of_a_camera_upside_down_are_turned(folder):
    """The hole, above, is then below: of the turned images it is not seen either."""
    upright = image_scores(folder, 0.001, None, Bundle.load())
    for path in folder.glob("*.png"):
        Image.fromarray(np.array(Image.open(path))[::-1, ::-1].copy()).save(path, compress_level=1)
    turned = image_scores(folder, 0.001, None, Bundle.load(), upside_down=True)
    for name, (scores,) in upright.items():
        np.testing.assert_allclose(turned[name][0], scores, rtol=1e-6, err_msg=name)


@pytest.mark.parametrize(
    ("spoil", "options", "message"),
    [
        (lambda folder: None, {"scale": 1.0}, "median depth is .* m: give --scale"),
        (lambda folder: None, {"scale": 1e-6}, "median depth is .* m: give --scale"),
        (lambda folder: None, {"scale": 0.004}, "depth in front of the robot is .* check the unit"),
        (lambda folder: None, {"rotate": 180}, "the images are upside down: turn them by --rotate"),
        (lambda folder: None, {"lens": (900.0, 900.0, 320.0, 240.0)}, "not wide enough"),
        (lambda folder: None, {"log": (Path("walk.log"),)}, "--log or --images"),
        (lambda folder: (folder / "00003.png").unlink(), {}, "holds 39 PNG images; .* at least 40"),
        (lambda folder: (folder / "00003.png").write_text("no"), {}, "cannot read the image"),
        (
            lambda folder: Image.new("RGB", (640, 480)).save(folder / "00003.png"),
            {},
            "00003.png has colours",
        ),
        # Numbers of colours in a palette, which are one channel, too.
        (
            lambda folder: Image.new("P", (640, 480), 7).save(folder / "00003.png"),
            {},
            "00003.png has colours",
        ),
        (
            lambda folder: Image.new("I;16", (64, 48)).save(folder / "00003.png"),
            {},
            r"\(48, 64\) rows and columns",
        ),
    ],
)
def test_what_is_wrong_is_named_and_the_bundle_stays(folder, tmp_path, spoil, options, message):
    bundle = Path(shutil.copytree(pretrained(DEFAULT), tmp_path / "bundle"))
    before = (bundle / "manifest.json").read_bytes()
    spoil(folder)
    with pytest.raises(RenetError, match=message):
        run_calibrate(CalibrateCfg(bundle, **({"images": folder} | options)))
    assert (bundle / "manifest.json").read_bytes() == before


@pytest.mark.parametrize(
    "options", [{"lens": (30.0, 30.0, 32.0, 24.0)}, {"rotate": 180}, {"scale": 0.00025}]
)
def test_a_camera_without_images_calibrates_nothing(tmp_path, monkeypatch, options):
    """It was forgotten to name them: simulated walks would set thresholds instead."""
    monkeypatch.setattr(calibrate, "_calibrate_simulated", lambda cfg: pytest.fail("it walks"))
    bundle = Path(shutil.copytree(pretrained(DEFAULT), tmp_path / "bundle"))
    (name,) = options
    with pytest.raises(RenetError, match=f"--{name} is about the images of --images FOLDER"):
        run_calibrate(CalibrateCfg(bundle, **options))
