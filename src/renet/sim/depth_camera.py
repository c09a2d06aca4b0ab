"""Depth camera on a robot, as an mjlab sensor: planar metres from one static terrain mesh."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import mujoco
import torch
from mjlab.sensor.sensor import Sensor, SensorCfg
from mjlab.utils.lab_api.math import matrix_from_quat
from torch import Tensor

from renet.errors import RenetError
from renet.sim.camera_model import Intrinsics, mount_rotation
from renet.sim.depth_noise import DepthNoiseCfg, add_noise
from renet.sim.raycast import scanner
from renet.vocabulary import CONTROL_DT, DEPTH_RANGE, STEPS_PER_TICK


@dataclass
class MountCfg:
    """Where the camera sits on its body, and how much that varies from episode to episode."""

    position: tuple[float, float, float] = (0.27, 0.0, 0.03)
    """Metres in the body frame (published Go1 parkour policies: on the head)."""
    pitch: float = math.radians(30.0)
    """Downward tilt, rad."""
    position_error: float = 0.01
    """Uniform, plus or minus, m (paper)."""
    angle_error: float = math.radians(5.0)
    """Uniform pitch and yaw error, plus or minus, rad (paper)."""


@dataclass
class DepthCameraCfg(SensorCfg):
    """A 10 Hz depth camera; usable in any mjlab task."""

    body: str = "robot/trunk"
    """MuJoCo body that carries the camera."""
    intrinsics: Intrinsics = field(default_factory=Intrinsics)
    mount: MountCfg = field(default_factory=MountCfg)
    noise: DepthNoiseCfg = field(default_factory=DepthNoiseCfg)
    range: float = DEPTH_RANGE
    """Depth is capped here, m (paper)."""
    period: float = CONTROL_DT * STEPS_PER_TICK
    """Seconds between images."""
    latency: tuple[int, int] = (0, 0)
    """Whole images by which what is delivered lags, uniform per episode, at most 2."""

    def build(self) -> DepthCamera:
        """Instantiate the sensor."""
        if not 0 <= self.latency[0] <= self.latency[1] <= 2:
            raise RenetError(f"camera latency must be 0 to 2 images, got {self.latency}")
        return DepthCamera(self)


@dataclass
class DepthImage:
    """What the camera delivers."""

    depth: Tensor
    """[N, H, W] metres to the image plane, top row first, capped at the range."""
    valid: Tensor
    """[N, H, W] bool, false where no surface was hit within range."""


class DepthCamera(Sensor[DepthImage]):
    """Renders when an image is due and somebody looks, and holds it until the next is due.

    All environments share one clock that restarts when all are reset. After a partial reset the
    image of those environments is the old one until the next tick: consumers read at ticks.
    """

    def __init__(self, cfg: DepthCameraCfg) -> None:
        super().__init__()
        self.cfg = cfg

    def edit_spec(self, scene_spec, entities) -> None:
        """Rays need nothing in the model."""

    def initialize(self, mj_model, model, data, device) -> None:
        """Build the mesh and per-environment mounts; raises RenetError for an unknown body."""
        body = mujoco.mj_name2id(mj_model, mujoco.mjtObj.mjOBJ_BODY, self.cfg.body)
        if body < 0:
            known = (mj_model.body(i).name for i in range(1, mj_model.nbody))
            raise RenetError(f"no body {self.cfg.body!r} for the camera; known: {', '.join(known)}")
        self._body, self._data, self._device = body, data, device
        self._scanner = scanner(mj_model, device)
        self._rays = self.cfg.intrinsics.rays(device)
        count = data.qpos.shape[0]
        self._position = torch.empty(count, 3, device=device)
        self._rotation = torch.empty(count, 3, 3, device=device)
        self._lag = torch.zeros(count, dtype=torch.long, device=device)
        self._frames: list[DepthImage] = []
        self._elapsed, self._due = 0.0, True
        self._normalised: Tensor | None = None
        self._remount(torch.arange(count, device=device))

    def _remount(self, env_ids: Tensor) -> None:
        """Draw mount errors and latency for new episodes."""
        mount, count = self.cfg.mount, len(env_ids)
        error = torch.empty(count, 5, device=self._device).uniform_(-1.0, 1.0)
        nominal = torch.tensor(mount.position, device=self._device)
        self._position[env_ids] = nominal + mount.position_error * error[:, :3]
        pitch, yaw = (mount.angle_error * error[:, 3:]).unbind(-1)
        self._rotation[env_ids] = mount_rotation(mount.pitch + pitch, yaw)
        low, high = self.cfg.latency
        self._lag[env_ids] = torch.randint(low, high + 1, (count,), device=self._device)

    def reset(self, env_ids: Tensor | slice | None = None) -> None:
        """Begin episodes; resetting all environments restarts the clock."""
        super().reset(env_ids)
        ids = torch.arange(len(self._lag), device=self._device)
        ids = ids if env_ids is None else ids[env_ids]
        self._remount(ids)
        if len(ids) == len(self._lag):
            self._elapsed, self._due = 0.0, True
            self._frames.clear()

    def update(self, dt: float) -> None:
        """Let `dt` seconds pass."""
        super().update(dt)
        self._elapsed += dt
        if self._elapsed >= self.cfg.period - 1e-6:
            self._elapsed -= self.cfg.period
            self._due = True

    def _compute_data(self) -> DepthImage:
        if self._due:
            self._due, self._normalised = False, None
            self._frames = [self._render(), *self._frames[: self.cfg.latency[1]]]
        return self._delivered()

    def _render(self) -> DepthImage:
        """Cast all rays from the current poses."""
        position, quaternion = self._data.xpos[:, self._body], self._data.xquat[:, self._body]
        base = matrix_from_quat(quaternion)
        eye = position + (base @ self._position.unsqueeze(-1)).squeeze(-1)
        raw = self._scanner.depth(eye, base @ self._rotation, self._rays, self.cfg.range)
        raw = raw.unflatten(-1, (self.cfg.intrinsics.height, self.cfg.intrinsics.width))
        # A ray from a pose that is not finite hits nothing sensible; NaN fails this comparison.
        valid = raw >= 0.0
        depth = torch.where(valid, raw, self.cfg.range)
        return DepthImage(add_noise(depth, self.cfg.noise).clamp_(0.0, self.cfg.range), valid)

    def _delivered(self) -> DepthImage:
        """The newest image, or each robot's late one."""
        if self.cfg.latency[1] == 0:
            return self._frames[0]
        lag = self._lag.clamp_max(len(self._frames) - 1)
        robots = torch.arange(len(lag), device=self._device)
        depth = torch.stack([frame.depth for frame in self._frames])[lag, robots]
        valid = torch.stack([frame.valid for frame in self._frames])[lag, robots]
        return DepthImage(depth, valid)

    def normalised(self) -> Tensor:
        """The delivered depth divided by the range, [N, H, W] float16 in [0, 1]."""
        image = self.data
        if self._normalised is None:
            self._normalised = (image.depth / self.cfg.range).half()
        return self._normalised
