"""Depth camera on a robot, as an mjlab sensor: planar metres from one static terrain mesh."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from mjlab.sensor.sensor import SensorCfg
from mjlab.utils.buffers import CircularBuffer
from torch import Tensor

from renet.camera import Intrinsics
from renet.errors import RenetError
from renet.interface import CONTROL_DT, DEPTH_RANGE, TICK_DT
from renet.sim.depth.rasterizer import scanner
from renet.sim.depth.ray_sensor import RaySensor


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


def mount_rotation(pitch: Tensor, yaw: Tensor) -> Tensor:
    """Camera axes in the base frame, [N, 3, 3]: yaw about z, then pitch about y (down positive)."""
    cp, sp, cy, sy = pitch.cos(), pitch.sin(), yaw.cos(), yaw.sin()
    entries = (cy * cp, -sy, cy * sp, sy * cp, cy, sy * sp, -sp)
    return torch.stack((*entries, torch.zeros_like(pitch), cp), dim=-1).unflatten(-1, (3, 3))


@dataclass
class DepthNoiseCfg:
    """Depth errors added in training (RENet, Method C, "Raycaster Randomization").

    Gaussian errors of every pixel: one in proportion to distance, one constant.
    """

    relative_std: float = 0.01
    """Standard deviation of the error in proportion to distance, m/m (paper: 1 %)."""
    gaussian_std: float = 0.1
    """Standard deviation of the constant error, m. The paper says "variance 0.01" without a unit:
    0.1 reads it as m²; 0.01 would read it as a standard deviation in m, and 0.2 as the variance of
    depth divided by its 2 m range."""


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
    period: float = TICK_DT
    """Seconds between images."""
    delay: tuple[float, float] = (0.0, 0.0)
    """Age of an image when it is delivered, s, in whole control steps, uniform per episode. It
    shows the view from where the camera was then, but never from before the episode began."""

    def build(self) -> DepthCamera:
        """Instantiate the sensor; raises RenetError for a delay that is no range."""
        if not 0.0 <= self.delay[0] <= self.delay[1] < math.inf:
            raise RenetError(f"camera delay must be (least, most) in s, from 0, got {self.delay}")
        return DepthCamera(self)


def add_noise(
    depth: Tensor, cfg: DepthNoiseCfg, normal: Callable[[Tensor], Tensor] = torch.randn_like
) -> Tensor:
    """Noisy depth of the same shape, m; both errors are Gaussian, so one draw has both variances.

    Args:
        depth: m, of any shape. cfg: standard deviations. normal: draws numbers for a tensor.
    """
    if cfg.relative_std == 0.0 and cfg.gaussian_std == 0.0:
        return depth
    variance = (cfg.relative_std * depth) ** 2 + cfg.gaussian_std**2
    return depth + variance.sqrt() * normal(depth)


@dataclass
class CameraPerturbation:
    """How cameras see a scene that is not so: for faults that act on rays, not on images."""

    lift: Tensor
    """[N] m by which every surface appears higher than it is."""
    turn: Tensor
    """[N, 3, 3] rotation of the camera in its mount, camera axes."""
    unseen: list[tuple[frozenset[int], Tensor]]
    """Geoms that rays pass through, and the environments [n] whose rays do."""


class DepthCamera(RaySensor[Tensor]):
    """`data` is [N, H, W]: metres to the image plane, top row first, capped at the range.

    Renders when an image is due and somebody looks, and holds it until the next is due.

    All environments share one clock. Resetting all of them between two steps restarts it; a reset
    inside a step, of some or by chance of all, does not, for consumers count their ticks on. The
    image of those environments is then the old one until the next tick: consumers read at ticks.
    """

    def __init__(self, cfg: DepthCameraCfg) -> None:
        super().__init__(cfg)
        self.perturbation: CameraPerturbation | None = None
        """What is wrong with the view, from the next image on."""
        self.normal: Callable[[Tensor], Tensor] = torch.randn_like
        """Draws the noise of images [N, H, W]."""

    def initialize(self, mj_model, model, data, device) -> None:
        """Draw the mounts; raises KeyError for an unknown body, RenetError without terrain."""
        self._body = mj_model.body(self.cfg.body).id
        super().initialize(mj_model, model, data, device)
        self._model = mj_model
        self._nominal = torch.tensor(self.cfg.mount.position, device=device)
        count = data.qpos.shape[0]
        self._position = torch.empty(count, 3, device=device)
        self._rotation = torch.empty(count, 3, 3, device=device)
        self._delay = torch.zeros(count, dtype=torch.long, device=device)
        """Control steps by which images are late."""
        self._most = round(self.cfg.delay[1] / CONTROL_DT)
        self._poses = CircularBuffer(self._most + 1, count, device)
        """`_pose` at the last control steps of the episode; empty where images are never late."""
        self._elapsed, self._since_pose, self._due = 0.0, 0.0, True
        self._remount(torch.arange(count, device=device))

    def _remount(self, env_ids: Tensor) -> None:
        """Draw mount errors and delays of new episodes."""
        mount, count = self.cfg.mount, len(env_ids)
        error = torch.empty(count, 5, device=self._device).uniform_(-1.0, 1.0)
        self._position[env_ids] = self._nominal + mount.position_error * error[:, :3]
        pitch, yaw = (mount.angle_error * error[:, 3:]).unbind(-1)
        self._rotation[env_ids] = mount_rotation(mount.pitch + pitch, yaw)
        least = round(self.cfg.delay[0] / CONTROL_DT)
        drawn = torch.randint(least, self._most + 1, (count,), device=self._device)
        self._delay[env_ids] = drawn

    def reset(self, env_ids: Tensor | slice | None = None) -> None:
        """Begin episodes with new mounts and delays."""
        between_steps = self._cache_valid
        super().reset(env_ids)
        ids = torch.arange(len(self._delay), device=self._device)
        ids = ids if env_ids is None else ids[env_ids]
        self._remount(ids)
        self._poses.reset(ids)
        if between_steps and len(ids) == len(self._delay):
            self._elapsed, self._since_pose, self._due = 0.0, 0.0, True

    def copy_mounts(self, source: Tensor) -> None:
        """Give every environment the mount and delay of another, `source` [N]."""
        for drawn in (self._position, self._rotation, self._delay):
            drawn[:] = drawn[source]

    def update(self, dt: float) -> None:
        """Let `dt` seconds pass."""
        super().update(dt)
        if self._most:  # Poses are kept once in a control step.
            self._since_pose += dt
            if self._since_pose >= CONTROL_DT - 1e-6:
                self._since_pose -= CONTROL_DT
                self._poses.append(self._pose())
        self._elapsed += dt
        if self._elapsed >= self.cfg.period - 1e-6:
            self._elapsed -= self.cfg.period
            self._due = True

    def _pose(self) -> Tensor:
        """The body's position and rotation of now, [N, 3 + 9]."""
        position, rotation = self._data.xpos[:, self._body], self._data.xmat[:, self._body]
        return torch.cat((position, rotation.flatten(1)), dim=-1)

    def _delayed_pose(self) -> Tensor:
        """The same of when the images that are due were taken."""
        if not self._poses.is_initialized:
            return self._pose()
        steps = torch.minimum(self._delay, self._poses.current_length - 1)
        return torch.where(steps.unsqueeze(-1) > 0, self._poses[steps], self._pose())

    def _compute_data(self) -> Tensor:
        if self._due:
            self._due = False
            self._image = self._render()
            self._normalised = (self._image / self.cfg.range).half()
        return self._image

    def _view(self) -> tuple[Tensor, Tensor]:
        """Eyes [N, 3] and axes [N, 3, 3] of the cameras when the images were taken."""
        position, base = self._delayed_pose().split((3, 9), dim=-1)
        base = base.unflatten(-1, (3, 3))
        return position + (base @ self._position.unsqueeze(-1)).squeeze(-1), base @ self._rotation

    def _render(self) -> Tensor:
        """Cast all rays."""
        raw = self._cast(*self._view())
        raw = raw.unflatten(-1, (self.cfg.intrinsics.height, self.cfg.intrinsics.width))
        # A ray from a pose that is not finite hits nothing sensible; NaN fails this comparison.
        depth = torch.where(raw >= 0.0, raw, self.cfg.range)
        return add_noise(depth, self.cfg.noise, self.normal).clamp_(0.0, self.cfg.range)

    def _cast(self, eye: Tensor, rotation: Tensor) -> Tensor:
        """Depth [N, H * W] from `eye` [N, 3] and axes [N, 3, 3] as they truly are; -1: nothing."""
        wrong, lens, limit = self.perturbation, self.cfg.intrinsics, self.cfg.range
        if wrong is None:
            return self._scanner.depth(eye, rotation, lens, limit)
        # A scene that appears higher is one seen from lower.
        eye = eye - wrong.lift.unsqueeze(-1) * torch.eye(3, device=self._device)[2]
        rotation = rotation @ wrong.turn
        raw = self._scanner.depth(eye, rotation, lens, limit)
        for geoms, robots in wrong.unseen:
            bare = scanner(self._model, self._device, geoms)
            raw[robots] = bare.depth(eye[robots], rotation[robots], lens, limit)
        return raw

    def normalised(self) -> Tensor:
        """The delivered depth divided by the range, [N, H, W] float16 in [0, 1]."""
        _ = self.data
        return self._normalised
