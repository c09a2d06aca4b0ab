"""The depth camera of a robot, as an mjlab sensor that sees the static terrain."""

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


@dataclass(frozen=True)
class MountCfg:
    """Pose of the camera on its body, and its errors, which are drawn for each episode.

    Frozen, since all tasks of a robot share it.
    """

    position: tuple[float, float, float] = (0.27, 0.0, 0.03)
    """Position in the body frame, m (on the head, as in published Go1 parkour policies)."""
    pitch: float = math.radians(30.0)
    """Downward tilt, rad."""
    position_error: float = 0.01
    """Largest position error, uniform, m (paper)."""
    angle_error: float = math.radians(5.0)
    """Largest pitch and yaw error, uniform, rad (paper)."""


def mount_rotation(pitch: Tensor, yaw: Tensor) -> Tensor:
    """Camera axes in the base frame, [N, 3, 3], for yaw about z, then pitch about y, down > 0."""
    cp, sp, cy, sy = pitch.cos(), pitch.sin(), yaw.cos(), yaw.sin()
    entries = (cy * cp, -sy, cy * sp, sy * cp, cy, sy * sp, -sp)
    return torch.stack((*entries, torch.zeros_like(pitch), cp), dim=-1).unflatten(-1, (3, 3))


@dataclass
class DepthNoiseCfg:
    """Gaussian errors of every pixel (RENet, Method C, "Raycaster Randomization")."""

    relative_std: float = 0.01
    """Standard deviation of the error in proportion to distance, m/m (paper: 1 %)."""
    gaussian_std: float = 0.1
    """Standard deviation of the constant error, m. The paper's "variance 0.01" has no unit and is
    read as m². As a standard deviation in m it would be 0.01, as the variance of depth divided by
    its range of 2 m it would be 0.2."""


@dataclass
class DepthCameraCfg(SensorCfg):
    """Configuration of a 10 Hz depth camera for any mjlab task."""

    body: str = "robot/trunk"
    """MuJoCo body that carries the camera."""
    intrinsics: Intrinsics = field(default_factory=Intrinsics)
    mount: MountCfg = field(default_factory=MountCfg)
    noise: DepthNoiseCfg = field(default_factory=DepthNoiseCfg)
    range: float = DEPTH_RANGE
    """Largest depth, m (paper)."""
    period: float = TICK_DT
    """Seconds between images."""
    delay: tuple[float, float] = (0.0, 0.0)
    """Least and greatest age of a delivered image, s. The age is uniform over whole control steps
    and constant in an episode. No image is older than the episode."""

    def build(self) -> DepthCamera:
        """Instantiate the sensor; raises RenetError for a delay that is no range."""
        if not 0.0 <= self.delay[0] <= self.delay[1] < math.inf:
            raise RenetError(f"camera delay must be (least, most) in s, from 0, got {self.delay}")
        return DepthCamera(self)


def add_noise(
    depth: Tensor, cfg: DepthNoiseCfg, normal: Callable[[Tensor], Tensor] = torch.randn_like
) -> Tensor:
    """Noisy depth of the same shape, m; one Gaussian draw has the variances of both errors.

    Args:
        depth: m, of any shape. cfg: standard deviations.
        normal: draws normal numbers in the shape of a tensor.
    """
    if cfg.relative_std == 0.0 and cfg.gaussian_std == 0.0:
        return depth
    variance = (cfg.relative_std * depth) ** 2 + cfg.gaussian_std**2
    return depth + variance.sqrt() * normal(depth)


@dataclass
class CameraPerturbation:
    """How the views of N cameras differ from their scenes, for faults that act on rays."""

    lift: Tensor
    """[N] m by which every surface appears higher than it is."""
    turn: Tensor
    """[N, 3, 3] rotation of the camera in its mount, camera axes."""
    unseen: list[tuple[frozenset[int], Tensor]]
    """Pairs of geoms that rays pass through, and of the environments [n] where they do."""


class DepthCamera(RaySensor):
    """`data` is [N, H, W], m to the image plane, top row first, at most the range.

    An image is rendered when it is first read after it is due, and held until the next is due.

    All environments share one clock. Resetting all of them between two steps restarts it. A reset
    inside a step, of some or by chance of all, does not, as consumers go on counting ticks; the
    image of those environments stays the old one until the next tick, when consumers read it.
    """

    def __init__(self, cfg: DepthCameraCfg) -> None:
        super().__init__(cfg)
        self.perturbation: CameraPerturbation | None = None
        """Difference of the views from the scenes, from the next image on."""
        self.normal: Callable[[Tensor], Tensor] = torch.randn_like
        """Draws the noise of images, [N, H, W]."""

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
        """Age of delivered images in control steps, [N]."""
        self._most = round(self.cfg.delay[1] / CONTROL_DT)
        self._poses = CircularBuffer(self._most + 1, count, device)
        """`_pose` at the last control steps of the episode; empty if images are never late."""
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
        self._delay[env_ids] = torch.randint(least, self._most + 1, (count,), device=self._device)

    def reset(self, env_ids: Tensor | slice | None = None) -> None:
        """Draw mounts and delays of the environments' new episodes."""
        between_steps = self._cache_valid
        super().reset(env_ids)
        ids = torch.arange(len(self._delay), device=self._device)
        ids = ids if env_ids is None else ids[env_ids]
        self._remount(ids)
        self._poses.reset(ids)
        if between_steps and len(ids) == len(self._delay):
            self._elapsed, self._since_pose, self._due = 0.0, 0.0, True

    def copy_mounts(self, source: Tensor) -> None:
        """Copy the mounts and delays of the environments `source`, [N]."""
        for drawn in (self._position, self._rotation, self._delay):
            drawn[:] = drawn[source]

    def update(self, dt: float) -> None:
        """Advance the clock by `dt` seconds."""
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
        """Present position and rotation of the body, [N, 3 + 9]."""
        position, rotation = self._data.xpos[:, self._body], self._data.xmat[:, self._body]
        return torch.cat((position, rotation.flatten(1)), dim=-1)

    def _compute_data(self) -> Tensor:
        if self._due:
            self._due = False
            self._image = self._render()
            self._normalised = (self._image / self.cfg.range).half()
        return self._image

    def _view(self) -> tuple[Tensor, Tensor]:
        """Eyes [N, 3] and axes [N, 3, 3] of the cameras when the images were taken."""
        pose = self._pose()
        if self._poses.is_initialized:
            steps = torch.minimum(self._delay, self._poses.current_length - 1)
            pose = torch.where(steps.unsqueeze(-1) > 0, self._poses[steps], pose)
        position, base = pose[:, :3], pose[:, 3:].unflatten(-1, (3, 3))
        return position + (base @ self._position.unsqueeze(-1)).squeeze(-1), base @ self._rotation

    def _render(self) -> Tensor:
        """Depth with noise, [N, H, W] m."""
        raw = self._cast(*self._view())
        raw = raw.unflatten(-1, (self.cfg.intrinsics.height, self.cfg.intrinsics.width))
        # NaN, from a pose that is not finite, fails the comparison.
        depth = torch.where(raw >= 0.0, raw, self.cfg.range)
        return add_noise(depth, self.cfg.noise, self.normal).clamp_(0.0, self.cfg.range)

    def _cast(self, eye: Tensor, rotation: Tensor) -> Tensor:
        """Depth [N, H * W] from eyes [N, 3] and axes [N, 3, 3], perturbed; -1 where it is empty."""
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
