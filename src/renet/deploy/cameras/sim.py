"""Simulated depth camera: rays of the physics engine, geometry and noise of the training camera."""

import mujoco
import numpy as np

from renet.bundle.manifest import CameraSpec
from renet.deploy.cameras.base import Camera, DepthFrame, next_due
from renet.deploy.robots.sim.mujoco import MujocoRobot
from renet.deploy.robots.sim.scene import TERRAIN
from renet.errors import RenetError
from renet.faults import ViewPerturbation
from renet.faults.physical import choose_evenly, obstacles

RELATIVE_STD = 0.01
"""Standard deviation of the training camera's noise per distance, m/m."""


class SimCamera(Camera):
    """Depth camera in the scene of a simulated robot, at its own rate on the robot's clock.

    Its depths are within a millimetre of the training camera's; both are tested against each other.
    The robot may be of another engine, if it offers what `MujocoRobot` does: `model`,
    `base_position`, `base_rotation`, `now`, `hide` and `cast`.
    """

    def __init__(self, robot: MujocoRobot, camera: CameraSpec, seed: int = 0) -> None:
        self._robot = robot
        self._spec = camera
        self._random = np.random.default_rng(seed)
        self._rays = camera.intrinsics.rays()
        self._period = 1.0 / camera.rate_hz
        self._due = 0.0
        """Time of the next image, s on the robot's clock."""
        self._frame: DepthFrame | None = None
        self._number = 0
        self._view = ViewPerturbation.none(1)
        """Faults of the scene and the mount that are shown."""

    def start(self) -> None:
        """Begin to stream with an image that is due now."""
        self._due = self._robot.now()

    def latest(self) -> DepthFrame:
        """Newest frame; casts rays when an image is due."""
        now = self._robot.now()
        if self._frame is None or now >= self._due - 1e-6:
            self._due = next_due(self._due, now, self._period)
            depth = self.depth()
            # One part of the noise grows with the distance, one does not.
            std = np.hypot(RELATIVE_STD * depth, self._spec.noise_std)
            depth = depth + std * self._random.standard_normal(depth.shape)
            image = np.clip(depth / self._spec.range, 0.0, 1.0)
            self._frame = DepthFrame(image.astype(np.float32), self._number, now)
            self._number += 1
        return self._frame

    def perturb(self, view: ViewPerturbation) -> None:
        """Change the view from the next image on; raises RenetError for glass without obstacles."""
        if view == self._view:
            return
        model = self._robot.model
        unseen = []
        if view.glass[0] > 0.0:
            if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, TERRAIN) < 0:
                raise RenetError("this scene has nothing that could be glass: choose a --terrain")
            # Glass is a share of the obstacles that rays pass through.
            tiles = obstacles(model, np.zeros((1, 2)))
            unseen = sorted(choose_evenly(tiles, float(view.glass[0])))
        self._robot.hide(unseen)
        self._view = view

    def depth(self) -> np.ndarray:
        """Planar depth [H, W] in metres without noise, capped at the range."""
        robot = self._robot
        spec = self._spec
        base = robot.base_rotation
        # Surfaces that seem to be higher are seen from lower down.
        lower = (0.0, 0.0, self._view.lift[0])
        eye = robot.base_position + base @ np.array(spec.position) - lower
        # A positive pitch looks down.
        mount = rotation(np.array([0.0, spec.pitch, 0.0]))
        camera = base @ mount @ rotation(self._view.turn[0])
        # Distances along unit rays become planar depths: `_rays` have a depth of 1 each.
        lengths = np.linalg.norm(self._rays, axis=1)
        distance = robot.cast(eye, (self._rays / lengths[:, None]) @ camera.T)
        return np.minimum(distance / lengths, spec.range).reshape(spec.height, spec.width)


def rotation(turn: np.ndarray) -> np.ndarray:
    """Rotation matrix [3, 3] of a rotation vector [3] rad."""
    angle = float(np.linalg.norm(turn))
    # Any axis will do for a turn of zero.
    axis = turn / angle if angle else np.array((1.0, 0.0, 0.0))
    quaternion = np.empty(4)
    matrix = np.empty(9)
    mujoco.mju_axisAngle2Quat(quaternion, axis, angle)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)
