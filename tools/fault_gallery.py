"""Draw every fault at its severities: `python tools/fault_gallery.py`, docs/figures/faults.webp.

Each picture shows blocks before a simulated robot.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import mujoco
import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from renet.bundle import DEFAULT, pretrained, read_manifest
from renet.deploy.cameras.sim import SimCamera
from renet.deploy.robots.sim.mujoco import MujocoRobot
from renet.deploy.robots.sim.scene import build_scene
from renet.evaluation import figures
from renet.evaluation.results import Provenance
from renet.faults import FAULTS, SEVERITIES, Frames, Injection, Injector, ViewPerturbation
from renet.interface import CONTROL_DT, DEPTH_RANGE, STEPS_PER_TICK, TICK_DT

OUT = Path(__file__).parents[1] / "docs" / "figures" / "faults.webp"
SEED = 1
WIDTH = 1100
"""Pixels."""
PLACE = 0.3
"""Where the robot stands on its tile, m ahead of the middle."""
TURNING = np.array([[0.0, 1.0, 2.0]])
"""Rate of the base in the pictures, rad/s."""
SHOWN = 5
"""Ticks into the fault at which the picture is taken."""


def draw_gallery(faults: Sequence[str], seed: int) -> Figure:
    """One picture of each fault at each severity; faults of time look like a healthy image."""
    framed: dict[Any, Any] = dict.fromkeys(("axes.spines.top", "axes.spines.right"), True)
    with plt.rc_context({**figures.STYLE, **framed, "axes.grid": False}):
        size = (1.6 * len(SEVERITIES) + 1.6, 1.22 * len(faults))
        figure, axes = plt.subplots(len(faults), len(SEVERITIES), figsize=size, squeeze=False)
        for row, fault in zip(axes, faults, strict=True):
            for axis, severity in zip(row, SEVERITIES, strict=True):
                axis.imshow(example(fault, severity, seed), cmap="gray", vmin=0, vmax=1)
                level = FAULTS[fault].level_of(severity)
                axis.set_title(
                    FAULTS[fault].describe(level), fontsize=8, loc="center", fontweight="normal"
                )
                axis.set(xticks=[], yticks=[])
            row[0].set_ylabel(fault.replace("_", " "), fontsize=8, rotation=0, ha="right")
        return figure


def example(fault: str, severity: int, seed: int) -> np.ndarray:
    """An image [48, 64] of the scene, half a second into a fault, base turning."""
    injection = Injection.of(fault, severity, onset=0)
    injector = Injector([(injection,)], [0], seed, physical=True)
    frames = Frames.healthy(scene()[None])
    for step in range(0, (SHOWN + 1) * STEPS_PER_TICK, STEPS_PER_TICK):
        # The robot walks, so that an old image differs from a new one.
        walked = 0.6 * (step * CONTROL_DT - SHOWN * TICK_DT)
        image = scene(injector.perturbation(step), walked)
        frames = injector.apply(Frames.healthy(image[None], TURNING), step)
    return frames.image[0]


def scene(view: ViewPerturbation | None = None, walked: float = 0.0) -> np.ndarray:
    """Normalised depth [48, 64] of ground and blocks, `walked` metres on, seen as one camera does.

    A `view` of one camera; by default it sees what is there.
    """
    robot, camera = _robot_and_camera()
    robot.data.qpos[0] = PLACE + walked
    mujoco.mj_forward(robot.model, robot.data)
    camera.perturb(view or ViewPerturbation.none(1))
    return np.clip(camera.depth() / DEPTH_RANGE, 0.0, 1.0).astype(np.float32)


@cache
def _robot_and_camera() -> tuple[MujocoRobot, SimCamera]:
    manifest = read_manifest(pretrained(DEFAULT))
    model, ground = build_scene("obstacles", level=10, seed=1)
    robot = MujocoRobot(model, manifest.robot, ground)
    return robot, SimCamera(robot, manifest.camera)


def main() -> None:
    """Draw, shrink, and write a WebP."""
    with tempfile.TemporaryDirectory() as folder:
        where = Provenance("no policy", "", "MuJoCo", SEED)
        drawn, path = draw_gallery(list(FAULTS), SEED), Path(folder) / "faults.png"
        picture = Image.open(figures.save_figure(drawn, path, where))
        height = round(picture.height * WIDTH / picture.width)
        picture.resize((WIDTH, height), Image.Resampling.LANCZOS).save(OUT, quality=60)
    print(f"{OUT}: {OUT.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
