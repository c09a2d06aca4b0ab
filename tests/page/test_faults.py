"""The page's faults do to images what the catalogue's do."""

import json

import mujoco
import numpy as np
import pytest

from renet.bundle import Bundle
from renet.deploy.cameras.sim import SimCamera
from renet.deploy.robots.sim.mujoco import MujocoRobot
from renet.deploy.robots.sim.scene import FLAT, build_scene
from renet.descriptions import find_description
from renet.faults import FAULTS, Frames
from renet.page.contract import GROUNDS, OFFERED
from renet.page.writer import WEB
from tests.page.conftest import run_node

STREAMS = 16
SEVERITIES = (1, 3, 5)
CERTAIN = ("blackout", "saturated", "frozen", "unplugged")
"""Faults without randomness: the same image, up to rounding."""


def frames() -> list[dict]:
    """Ground that comes nearer, with noise: two frames before a fault, twelve during it."""
    rng = np.random.default_rng(3)
    rows, columns = np.mgrid[:48, :64]
    ground, ticks = 0.9 - 0.015 * rows + 0.002 * columns, range(-2, 12)
    noise = 0.02 * rng.standard_normal((len(ticks), 48, 64))
    images = [np.clip(ground - 0.01 * tick + n, 0, 1) for tick, n in zip(ticks, noise, strict=True)]
    return [
        {"image": image.astype(np.float32), "elapsed": 0.1 * tick if tick >= 0 else -1.0}
        for tick, image in zip(ticks, images, strict=True)
    ]


def summary(before: np.ndarray, after: Frames) -> list[float]:
    image = after.image[0].astype(float)
    rows, columns = np.mgrid[:48, :64]
    return [
        image.mean(),
        image.std(),
        (image == 0).mean(),
        (image == 1).mean(),
        (np.abs(image - before) > 1e-6).mean(),
        (image * rows).mean() / 48,
        (image * columns).mean() / 64,
        float(after.invalid[0]),
        float(after.fresh[0]),
        float(after.age[0]),
    ]


def catalogue(name: str, level: float, seed: int, given: list[dict]) -> np.ndarray:
    fault, summaries = FAULTS[name](level, [np.random.default_rng(seed)]), []
    for image, elapsed in (frame.values() for frame in given):
        after = fault.corrupt(Frames.healthy(image[None]), np.array([elapsed]))
        if elapsed >= 0:
            summaries.append(summary(image, after))
    return np.array(summaries)


@pytest.fixture(scope="module")
def delivered(node_page, tmp_path_factory) -> dict:
    """The page's summaries of each fault and severity, [streams, frames, numbers]."""
    path = tmp_path_factory.mktemp("faults") / "input.json"
    listed = [{k: np.ravel(v).tolist() for k, v in f.items()} for f in frames()]
    streams = {name: 1 if name in CERTAIN else STREAMS for name in OFFERED}
    path.write_text(json.dumps({"frames": listed, "streams": streams, "severities": SEVERITIES}))
    return run_node("faults.mjs", WEB, node_page, path)


@pytest.mark.parametrize("severity", SEVERITIES)
@pytest.mark.parametrize("name", OFFERED)
def test_fault_does_what_the_catalogue_says(delivered, name, severity):
    level, given = FAULTS[name].level_of(severity), frames()
    mine = np.array(delivered[name][SEVERITIES.index(severity)])
    its = np.stack([catalogue(name, level, seed, given) for seed in range(len(mine))])
    if name in CERTAIN:
        np.testing.assert_allclose(mine, its, atol=1e-4)
        return
    # Means over frames of each stream; four standard errors of the difference between streams.
    mine, its = mine.mean(axis=1), its.mean(axis=1)
    error = np.hypot(mine.std(axis=0), its.std(axis=0)) / np.sqrt(STREAMS)
    far = np.abs(mine.mean(axis=0) - its.mean(axis=0)) - (4.0 * error + 1e-3)
    assert (far <= 0.0).all(), far


@pytest.mark.parametrize("number", [0, 1], ids=["go1", "go2"])
@pytest.mark.parametrize("ground", [name for name in GROUNDS if name != FLAT])
def test_camera_sees_what_the_runtimes_camera_sees(robots_page, ground, number):
    manifest = Bundle.load(robots_page / "bundles" / str(number)).manifest
    description = find_description(manifest.robot.name)
    model, height = build_scene(ground, GROUNDS[ground][1], robot=description)
    robot = MujocoRobot(model, manifest.robot, height)
    robot.data.qpos[0] = 1.0
    mujoco.mj_forward(robot.model, robot.data)
    its = SimCamera(robot, manifest.camera).depth().ravel()
    assert its.std() > 0.1
    link = f"?robot={description.name.split()[1].lower()}&ground={ground}"
    np.testing.assert_allclose(run_node("view.mjs", WEB, robots_page, link), its, atol=1e-4)
