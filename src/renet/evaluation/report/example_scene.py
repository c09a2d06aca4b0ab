"""Blocks before a simulated robot, for pictures of faults."""

from functools import cache

import mujoco
import numpy as np

from renet.bundle import DEFAULT, pretrained, read_manifest
from renet.deploy.cameras.sim import SimCamera
from renet.deploy.robots.mujoco import MujocoRobot
from renet.deploy.robots.scene import build_scene
from renet.faults import Frames, Injection, Injector, ViewPerturbation
from renet.interface import CONTROL_DT, DEPTH_RANGE, STEPS_PER_TICK, TICK_DT

PLACE = 0.3
"""Where the robot stands on its tile, m ahead of the middle."""
TURNING = np.array([[0.0, 1.0, 2.0]])
"""Rate of the base in the pictures, rad/s."""
SHOWN = 5
"""Ticks into the fault at which the picture is taken."""


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
