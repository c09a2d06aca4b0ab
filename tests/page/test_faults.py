"""The page's faults do to images what the catalogue's do."""

import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from renet.bundle import Bundle
from renet.deploy.cameras.sim import SimCamera
from renet.deploy.robots.mujoco import MujocoRobot
from renet.deploy.robots.scene import build_scene
from renet.faults import FAULTS, Frames, PhysicalFault, ViewPerturbation
from renet.page.contract import SCENES
from renet.page.writer import WEB
from tests.page.conftest import run_node

STREAMS = 16
SEVERITIES = (1, 3, 5)
CERTAIN = (
    "blackout", "saturated", "near_field", "wrong_scale", "motion_blur", "frozen", "unplugged",
    "edge_shadow", "disparity_steps", "shadow_steps", "intermittent_blackout", "intermittent_frozen"
)  # fmt: skip
"""Faults without randomness: the same image, up to rounding."""
NAMES = [name for name, fault in FAULTS.items() if not issubclass(fault, PhysicalFault)]


def frames() -> list[dict[str, Any]]:
    """Ground that comes nearer, with noise: two frames before a fault, twelve during it."""
    rng = np.random.default_rng(3)
    rows, columns = np.mgrid[:48, :64]
    out = []
    for tick in range(14):
        image = 0.9 - 0.015 * rows + 0.002 * columns - 0.01 * tick
        image = np.clip(image + 0.02 * rng.standard_normal((48, 64)), 0.0, 1.0)
        out.append(
            {
                "image": image.astype(np.float32),
                "angularVelocity": rng.normal(0.0, 1.5, 3),
                "elapsed": 0.1 * (tick - 2) if tick >= 2 else -1.0,
            }
        )
    return out


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


def catalogue(name: str, level: float, seed: int, given: list[dict[str, Any]]) -> np.ndarray:
    fault = FAULTS[name](level, [np.random.default_rng(seed)])
    out = []
    for frame in given:
        image = frame["image"]
        healthy = Frames.healthy(image[None], frame["angularVelocity"][None])
        after = fault.corrupt(healthy, np.array([frame["elapsed"]]))
        if frame["elapsed"] >= 0:
            out.append(summary(image, after))
    return np.array(out)


@pytest.fixture(scope="module")
def delivered(node_page: Path, tmp_path_factory) -> dict[str, Any]:
    """Of each fault and severity [streams, frames, numbers], by the page."""
    path = tmp_path_factory.mktemp("faults") / "input.json"
    listed = [{k: np.ravel(v).tolist() for k, v in f.items()} for f in frames()]
    streams = {name: 1 if name in CERTAIN else STREAMS for name in NAMES}
    path.write_text(json.dumps({"frames": listed, "streams": streams, "severities": SEVERITIES}))
    return run_node("faults.mjs", WEB, node_page, path)


@pytest.mark.parametrize("severity", SEVERITIES)
@pytest.mark.parametrize("name", NAMES)
def test_fault_does_what_the_catalogue_says(delivered, name: str, severity: int):
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


@pytest.mark.parametrize("name", ["glass", "foam", "mount_knocked"])
def test_physical_fault_shows_what_the_runtime_would_see(node_page: Path, name: str):
    contract = json.loads((node_page / "renet-page.json").read_text())
    model, ground = build_scene("platform", SCENES["platform"][1])
    manifest = Bundle.load().manifest
    for severity in (1, 5):
        seen = run_node("view.mjs", WEB, node_page, name, severity)
        level = FAULTS[name].level_of(severity)
        robot = MujocoRobot(model, manifest.robot, ground)
        robot.data.qpos[0] = 1.0
        mujoco.mj_forward(robot.model, robot.data)
        camera = SimCamera(robot, manifest.camera)
        np.testing.assert_allclose(seen["clean"], camera.depth().ravel(), atol=1e-4)
        turn = Rotation.from_matrix(seen["turn"] or np.eye(3)).as_rotvec()
        if name == "mount_knocked":
            assert np.linalg.norm(turn) == pytest.approx(np.radians(level))
        lift, glass = (np.array([level * (name == one)]) for one in ("foam", "glass"))
        camera.perturb(ViewPerturbation(lift, turn[None], glass))
        np.testing.assert_allclose(seen["spoilt"], camera.depth().ravel(), atol=1e-4)
        changed = not np.allclose(seen["spoilt"], seen["clean"], atol=1e-3)
        assert changed or severity == 1, "what is glass may be out of sight at severity 1"
        assert seen["repaired"] == seen["clean"]
    assert {s["name"] for s in contract["scenes"] if s["glass"]} == {"stairs_up", "platform"}


def test_page_offers_every_fault_of_the_catalogue(node_page: Path):
    offered = json.loads((node_page / "renet-page.json").read_text())["faults"]
    assert [fault["name"] for fault in offered] == list(FAULTS)
