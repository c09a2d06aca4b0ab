"""A scene without a robot, for pictures of faults: flat ground and five blocks."""

from functools import cache

import mujoco
import numpy as np

from renet.camera import Intrinsics
from renet.deploy.cameras.sim import rotation, tilt
from renet.deploy.robots.mujoco import cast
from renet.faults import TICK, Frames, Injection, Injector, ViewPerturbation
from renet.faults.physical import spread
from renet.interface import CONTROL_DT, DEPTH_RANGE, DEPTH_SHAPE, STEPS_PER_TICK

EYE = 0.3
"""Height of the camera above the ground, m."""
TILT = np.radians(30.0)
"""By which it looks down."""
BLOCKS = np.array(
    [
        # ahead, left, height of the lower and upper corner, m
        [(0.70, -0.25, 0.0), (1.10, 0.25, 0.15)],
        [(0.55, 0.35, 0.0), (0.75, 0.60, 0.10)],
        [(0.50, -0.65, 0.0), (0.80, -0.35, 0.08)],
        [(1.30, 0.10, 0.0), (1.60, 0.60, 0.30)],
        [(1.30, -0.70, 0.0), (1.70, -0.20, 0.25)],
    ]
)
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
        walked = 0.6 * (step * CONTROL_DT - SHOWN * TICK)
        image = scene(injector.perturbation(step), walked)
        frames = injector.apply(Frames.healthy(image[None], TURNING), step)
    return frames.image[0]


def scene(view: ViewPerturbation | None = None, walked: float = 0.0) -> np.ndarray:
    """Normalised depth [48, 64] of ground and blocks, `walked` metres on, seen as one camera does.

    A `view` of one camera; by default it sees what is there.
    """
    view, data = view or ViewPerturbation.none(1), _ground_and_blocks()
    blocks = list(range(1, data.model.ngeom))
    hidden = sorted(spread(blocks, float(view.glass[0]))) if view.glass[0] else []
    rays = Intrinsics().rays()
    lengths = np.linalg.norm(rays, axis=1)
    eye = np.array([walked, 0.0, EYE - view.lift[0]])
    camera = tilt(TILT) @ rotation(view.turn[0])
    depth = cast(data, eye, rays / lengths[:, None] @ camera.T, hidden) / lengths
    return np.clip(depth / DEPTH_RANGE, 0.0, 1.0).astype(np.float32).reshape(DEPTH_SHAPE)


@cache
def _ground_and_blocks() -> mujoco.MjData:
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=(0, 0, 1))
    for low, high in BLOCKS:
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX, size=(high - low) / 2, pos=(low + high) / 2
        )
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return data
