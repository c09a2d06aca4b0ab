"""The page's faults do to images what the catalogue's do."""

import json

import mujoco
import numpy as np
import pytest

from renet.bundle import pretrained, read_manifest
from renet.deploy.cameras.sim import SimCamera
from renet.deploy.robots.sim.mujoco import MujocoRobot
from renet.deploy.robots.sim.scene import FLAT, build_scene
from renet.faults import FAULTS, Frames
from renet.page.contract import GROUNDS, OFFERED
from renet.page.writer import WEB
from renet.robots import find_robot
from tests.page.conftest import run_node

STREAMS = 16
SEVERITIES = (1, 3, 5)
CERTAIN = ("blackout", "saturated", "frozen", "unplugged", "mirrored")
"""Faults without randomness: the same image, up to rounding."""
ROWS, COLUMNS = np.mgrid[:48, :64]
TICKS = np.arange(-2, 12)
"""Two frames before a fault, twelve during it."""
ELAPSED = np.where(TICKS >= 0, 0.1 * TICKS, -1.0)
GROUND = 0.9 - 0.015 * ROWS + 0.002 * COLUMNS - 0.01 * TICKS[:, None, None]
IMAGES = GROUND + 0.02 * np.random.default_rng(3).standard_normal(GROUND.shape)
FRAMES = [*zip(IMAGES.clip(0, 1).astype(np.float32), ELAPSED, strict=True)]
"""Ground that comes nearer, with noise, and seconds since the fault."""
UNEVEN = [name for name in GROUNDS if name != FLAT]
ROBOTS = {"go1": "go1-parkour", "go2": "go2-parkour"}
"""Bundle that a link to a robot leads to."""


def summary(before: np.ndarray, after: Frames) -> np.ndarray:
    """Ten numbers of each stream's frame, [streams, 10]."""
    image = after.image.astype(float)
    changed = np.abs(image - before) > 1e-6
    parts = image, image == 0, image == 1, changed, image * ROWS / 48, image * COLUMNS / 64
    mean, *shares = (part.mean(axis=(1, 2)) for part in parts)
    state = after.invalid, after.fresh, after.age
    return np.stack([mean, image.std(axis=(1, 2)), *shares, *state], axis=1)


def catalogue(name: str, level: float, streams: int) -> np.ndarray:
    fault = FAULTS[name](level, [np.random.default_rng(seed) for seed in range(streams)])
    summaries = []
    for image, elapsed in FRAMES:
        frames = Frames.healthy(np.repeat(image[None], streams, axis=0))
        after = fault.corrupt(frames, np.full(streams, elapsed))
        summaries += [summary(image, after)] if elapsed >= 0 else []
    return np.stack(summaries, axis=1)


@pytest.fixture(scope="module")
def delivered(node_page, tmp_path_factory) -> dict:
    """The page's summaries of each fault and severity, [streams, frames, numbers]."""
    path = tmp_path_factory.mktemp("faults") / "input.json"
    listed = [{"image": image.ravel().tolist(), "elapsed": elapsed} for image, elapsed in FRAMES]
    streams = {name: 1 if name in CERTAIN else STREAMS for name in OFFERED}
    path.write_text(json.dumps({"frames": listed, "streams": streams, "severities": SEVERITIES}))
    return run_node("faults.mjs", WEB, node_page, path)


@pytest.mark.parametrize("severity", SEVERITIES)
@pytest.mark.parametrize("name", OFFERED)
def test_fault_does_what_the_catalogue_says(delivered, name, severity):
    mine = np.array(delivered[name][SEVERITIES.index(severity)])
    its = catalogue(name, FAULTS[name].level_of(severity), len(mine))
    if name in CERTAIN:
        np.testing.assert_allclose(mine, its, atol=1e-4)
        return
    # Means over frames of each stream; four standard errors of the difference between streams.
    mine, its = mine.mean(axis=1), its.mean(axis=1)
    error = np.hypot(mine.std(axis=0), its.std(axis=0)) / np.sqrt(STREAMS)
    far = np.abs(mine.mean(axis=0) - its.mean(axis=0)) - (4.0 * error + 1e-3)
    assert (far <= 0.0).all(), far


def link_to(robot: str, ground: str) -> str:
    return f"?robot={robot}&ground={ground}"


@pytest.fixture(scope="module")
def views(node_page) -> dict[str, list[float]]:
    """What the page's camera sees, by link."""
    links = [link_to(robot, ground) for robot in ROBOTS for ground in UNEVEN]
    return run_node("view.mjs", WEB, node_page, *links)


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("ground", UNEVEN)
def test_camera_sees_what_the_runtimes_camera_sees(views, ground, name):
    manifest = read_manifest(pretrained(ROBOTS[name]))
    description = find_robot(manifest.robot.name)
    model, height = build_scene(ground, GROUNDS[ground][1], robot=description)
    robot = MujocoRobot(model, manifest.robot, height)
    robot.data.qpos[0] = 1.0
    mujoco.mj_forward(robot.model, robot.data)
    its = SimCamera(robot, manifest.camera).depth().ravel()
    assert its.std() > 0.1
    np.testing.assert_allclose(views[link_to(name, ground)], its, atol=1e-4)
