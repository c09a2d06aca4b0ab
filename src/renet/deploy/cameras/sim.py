"""A simulated depth camera: the engine's own rays, the training camera's geometry and noise."""

import mujoco
import numpy as np

from renet.bundle.manifest import CameraSpec
from renet.deploy.cameras.base import Camera, DepthFrame
from renet.deploy.robots.sim.mujoco import MujocoRobot
from renet.deploy.robots.sim.scene import TERRAIN
from renet.errors import RenetError
from renet.faults import ViewPerturbation
from renet.faults.physical import choose_evenly, obstacles

RELATIVE_STD = 0.01
"""Noise of the training camera in proportion to distance, m/m."""


class SimCamera(Camera):
    """Looks at the terrain of a simulated robot's scene, at the camera's rate on the robot's clock.

    What it sees is within a millimetre of the training camera's; both are tested against each
    other. A robot of another engine offers what `MujocoRobot` does: `model`, `base_position`,
    `base_rotation`, `now`, `hide` and `cast`.
    """

    def __init__(self, robot: MujocoRobot, camera: CameraSpec, seed: int = 0) -> None:
        self._robot, self._spec = robot, camera
        self._random = np.random.default_rng(seed)
        self._rays = camera.intrinsics.rays()
        self._period, self._due = 1.0 / camera.rate_hz, 0.0
        self._frame: DepthFrame | None = None
        self._number = 0
        self._view = ViewPerturbation.none(1)

    def start(self) -> None:
        """The first image is due now."""
        self._due = self._robot.now()

    def latest(self) -> DepthFrame:
        """Newest frame; casts rays when an image is due."""
        now = self._robot.now()
        if self._frame is None or now >= self._due - 1e-6:
            self._due = max(self._due, now - self._period) + self._period
            depth = self.depth()
            std = np.hypot(RELATIVE_STD * depth, self._spec.noise_std)
            depth = depth + std * self._random.standard_normal(depth.shape)
            image = np.clip(depth / self._spec.range, 0.0, 1.0)
            self._frame = DepthFrame(image.astype(np.float32), self._number, now)
            self._number += 1
        return self._frame

    def perturb(self, view: ViewPerturbation) -> None:
        """Spoil views from the next image on; raises RenetError for glass without obstacles."""
        if view == self._view:
            return
        model, unseen = self._robot.model, []
        if view.glass[0] > 0.0:
            if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, TERRAIN) < 0:
                raise RenetError("this scene has nothing that could be glass: choose a --terrain")
            tiles = obstacles(model, np.zeros((1, 2)))
            unseen = sorted(choose_evenly(tiles, float(view.glass[0])))
        self._robot.hide(unseen)
        self._view = view

    def depth(self) -> np.ndarray:
        """Planar metres [H, W] without noise, capped at the range."""
        robot, spec = self._robot, self._spec
        base = robot.base_rotation
        # Surfaces that seem higher are surfaces seen from lower down.
        lower = (0.0, 0.0, self._view.lift[0])
        eye = robot.base_position + base @ np.array(spec.position) - lower
        mount = rotation(np.array([0.0, spec.pitch, 0.0]))  # Looks down.
        camera = base @ mount @ rotation(self._view.turn[0])
        lengths = np.linalg.norm(self._rays, axis=1)
        distance = robot.cast(eye, (self._rays / lengths[:, None]) @ camera.T)
        return np.minimum(distance / lengths, spec.range).reshape(spec.height, spec.width)


def rotation(turn: np.ndarray) -> np.ndarray:
    """Matrix [3, 3] of a rotation vector in rad."""
    angle, quaternion, matrix = float(np.linalg.norm(turn)), np.empty(4), np.empty(9)
    axis = turn / angle if angle else np.array((1.0, 0.0, 0.0))
    mujoco.mju_axisAngle2Quat(quaternion, axis, angle)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)
