"""A scene that needs no simulator, for pictures of faults: flat ground and five blocks.

Depth is found by hand (rays against a plane and boxes), so that the gallery is the same for every
bundle and can be drawn in a second.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from renet.camera import Intrinsics
from renet.faults import TICK, Frames, Injection, Injector, ViewPerturbation
from renet.faults.image import FOCAL_PIXELS
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
    view = view or ViewPerturbation.none(1)
    hidden = spread(list(range(len(BLOCKS))), float(view.glass[0])) if view.glass[0] else set()
    rays = _rays(view.turn[0])
    eye = np.array([walked, 0.0, EYE - view.lift[0]])
    with np.errstate(divide="ignore"):
        depth = np.where(rays[..., 2] < 0, -eye[2] / np.minimum(rays[..., 2], -1e-9), np.inf)
    for number, block in enumerate(BLOCKS):
        if number not in hidden:
            depth = np.minimum(depth, _box(eye, rays, *block))
    return np.clip(depth / DEPTH_RANGE, 0.0, 1.0).astype(np.float32)


def _rays(turn: np.ndarray) -> np.ndarray:
    """Directions [48, 64, 3] in the world (ahead, left, up), one metre of depth long."""
    rays = Intrinsics(fx=FOCAL_PIXELS, fy=FOCAL_PIXELS).rays().reshape(*DEPTH_SHAPE, 3)
    sine, cosine = np.sin(TILT), np.cos(TILT)
    tilt = np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])
    return rays @ (tilt @ Rotation.from_rotvec(turn).as_matrix()).T


def _box(eye: np.ndarray, rays: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Depth [48, 64] at which rays enter an axis-aligned box; infinite where they miss it."""
    rays = np.where(np.abs(rays) < 1e-9, 1e-9, rays)
    one, two = (low - eye) / rays, (high - eye) / rays
    enter, leave = np.minimum(one, two).max(-1), np.maximum(one, two).min(-1)
    return np.where((enter < leave) & (enter > 0), enter, np.inf)
