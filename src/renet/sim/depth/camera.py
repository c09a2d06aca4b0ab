"""Depth camera of a robot, an mjlab sensor that sees the static terrain."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from mjlab.sensor.sensor import SensorCfg
from mjlab.utils.buffers import CircularBuffer
from torch import Tensor

from renet.camera import Intrinsics, MountCfg
from renet.errors import RenetError
from renet.interface import CONTROL_DT, DEPTH_RANGE, TICK_DT, control_steps
from renet.sim.depth.rasterizer import scanner
from renet.sim.depth.ray_sensor import RaySensor


def mount_rotation(pitch: Tensor, yaw: Tensor) -> Tensor:
    """Compute camera axes in the base frame as columns, [N, 3, 3].

    Args:
        pitch: Rotation about y after the yaw, positive downwards, [N] rad.
        yaw: Rotation about z, [N] rad.
    """
    cp = pitch.cos()
    sp = pitch.sin()
    cy = yaw.cos()
    sy = yaw.sin()
    zero = torch.zeros_like(pitch)
    first_row = (cy * cp, -sy, cy * sp)
    second_row = (sy * cp, cy, sy * sp)
    third_row = (-sp, zero, cp)
    entries = torch.stack((*first_row, *second_row, *third_row), dim=-1)
    return entries.unflatten(-1, (3, 3))


@dataclass
class DepthNoiseCfg:
    """Gaussian errors of each pixel (RENet, Method C, "Raycaster Randomization")."""

    relative_std: float = 0.01
    """Standard deviation of the error in proportion to depth, m/m (paper: 1 %)."""
    gaussian_std: float = 0.1
    """Standard deviation of the constant error, m. The paper's "variance 0.01" has no unit and is
    read as m². As a standard deviation in m it would be 0.01, and as the variance of depth divided
    by its range of 2 m it would be 0.2."""


@dataclass
class DepthCameraCfg(SensorCfg):
    """10 Hz depth camera for any mjlab task."""

    body: str = "robot/trunk"
    """MuJoCo body that carries the camera."""
    intrinsics: Intrinsics = field(default_factory=Intrinsics)
    """Size and field of view of the images."""
    mount: MountCfg = field(default_factory=MountCfg)
    """Pose on the body."""
    noise: DepthNoiseCfg = field(default_factory=DepthNoiseCfg)
    """Errors of the pixels."""
    range: float = DEPTH_RANGE
    """Largest depth, m (paper)."""
    period: float = TICK_DT
    """Time between images, s."""
    delay: tuple[float, float] = (0.0, 0.0)
    """Smallest and largest age of a delivered image, s. The age is uniform over whole control steps
    and constant during an episode. No image is older than the episode."""

    def build(self) -> DepthCamera:
        """Instantiate the sensor; raises RenetError if the delays are no range."""
        if not 0.0 <= self.delay[0] <= self.delay[1] < math.inf:
            raise RenetError(f"camera delay must be (least, most) in s, from 0, got {self.delay}")
        return DepthCamera(self)


def add_noise(
    depth: Tensor, cfg: DepthNoiseCfg, normal: Callable[[Tensor], Tensor] = torch.randn_like
) -> Tensor:
    """Add noise to depth, by one Gaussian number for each pixel with the variance of both errors.

    Args:
        depth: Depth of any shape, m.
        cfg: Standard deviations.
        normal: Function that draws normal numbers in the shape of a tensor.

    Returns:
        Noisy depth of the same shape, m.
    """
    if cfg.relative_std == 0.0 and cfg.gaussian_std == 0.0:
        return depth
    variance = (cfg.relative_std * depth) ** 2 + cfg.gaussian_std**2
    return depth + variance.sqrt() * normal(depth)


@dataclass
class CameraPerturbation:
    """Difference between the views of N cameras and their scenes, for faults that act on rays."""

    lift: Tensor
    """Height by which all surfaces appear too high, [N] m."""
    turn: Tensor
    """Rotation of the camera in its mount, in camera axes, [N, 3, 3]."""
    unseen: list[tuple[frozenset[int], Tensor]]
    """Pairs of geoms that rays pass through, and of the environments in which they do, [n]."""


class DepthCamera(RaySensor):
    """Depth camera with noise, delay and errors of its mount.

    `data` is the distance to the image plane, [N, H, W] m, at most the range; the top row is first.
    An image is rendered when it is first read after it is due, and held until the next one is due.

    All environments share one clock. A reset of all environments between two steps restarts it. A
    reset during a step does not, because consumers go on counting ticks: the image of those
    environments stays the old one until the next tick, when consumers read it.
    """

    def __init__(self, cfg: DepthCameraCfg) -> None:
        super().__init__(cfg)
        self.perturbation: CameraPerturbation | None = None
        """Difference between views and scenes, from the next image on."""
        self.normal: Callable[[Tensor], Tensor] = torch.randn_like
        """Function that draws the noise of images, [N, H, W]."""

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
        self._max_delay = control_steps(self.cfg.delay[1])
        self._poses = CircularBuffer(self._max_delay + 1, count, device)
        """`_pose` at the last control steps of the episode; empty for a camera without delay."""
        self._restart_clock()
        self._draw_mounts(torch.arange(count, device=device))

    def _restart_clock(self) -> None:
        """Begin a period, with an image due at once."""
        self._elapsed = 0.0
        self._since_pose = 0.0
        self._due = True

    def _draw_mounts(self, env_ids: Tensor) -> None:
        """Draw mount errors and delays of new episodes."""
        mount = self.cfg.mount
        count = len(env_ids)
        error = torch.empty(count, 5, device=self._device).uniform_(-1.0, 1.0)
        self._position[env_ids] = self._nominal + mount.position_error * error[:, :3]
        pitch, yaw = (mount.angle_error * error[:, 3:]).unbind(-1)
        self._rotation[env_ids] = mount_rotation(mount.pitch + pitch, yaw)
        low = control_steps(self.cfg.delay[0])
        high = self._max_delay + 1
        self._delay[env_ids] = torch.randint(low, high, (count,), device=self._device)

    def reset(self, env_ids: Tensor | slice | None = None) -> None:
        """Draw mounts and delays of the environments' new episodes."""
        # `update`, early in each step, invalidates the cache; a read at its end fills it.
        is_between_steps = self._cache_valid
        super().reset(env_ids)
        ids = torch.arange(len(self._delay), device=self._device)
        if env_ids is not None:
            ids = ids[env_ids]
        self._draw_mounts(ids)
        self._poses.reset(ids)
        if is_between_steps and len(ids) == len(self._delay):
            self._restart_clock()

    def copy_mounts(self, source: Tensor) -> None:
        """Copy the mounts and delays of the environments `source`, [N]."""
        for values in (self._position, self._rotation, self._delay):
            values[:] = values[source]

    def update(self, dt: float) -> None:
        """Advance the clock by `dt` s."""
        super().update(dt)
        # A camera with delay stores one pose in each control step.
        if self._max_delay:
            self._since_pose += dt
            if self._since_pose >= CONTROL_DT - 1e-6:
                self._since_pose -= CONTROL_DT
                self._poses.append(self._pose())
        self._elapsed += dt
        if self._elapsed >= self.cfg.period - 1e-6:
            self._elapsed -= self.cfg.period
            self._due = True

    def _pose(self) -> Tensor:
        """Return the present position and rotation of the body, [N, 3 + 9]."""
        position = self._data.xpos[:, self._body]
        rotation = self._data.xmat[:, self._body]
        return torch.cat((position, rotation.flatten(1)), dim=-1)

    def _compute_data(self) -> Tensor:
        if self._due:
            self._due = False
            self._image = self._render()
            self._normalised = (self._image / self.cfg.range).half()
        return self._image

    def _view(self) -> tuple[Tensor, Tensor]:
        """Compute positions [N, 3] and axes [N, 3, 3] of the cameras at their delayed images."""
        pose = self._pose()
        if self._poses.is_initialized:
            steps = torch.minimum(self._delay, self._poses.current_length - 1)
            pose = torch.where(steps.unsqueeze(-1) > 0, self._poses[steps], pose)
        base_position = pose[:, :3]
        base_rotation = pose[:, 3:].unflatten(-1, (3, 3))
        position = base_position + (base_rotation @ self._position.unsqueeze(-1)).squeeze(-1)
        return position, base_rotation @ self._rotation

    def _render(self) -> Tensor:
        """Render depth with noise, [N, H, W] m."""
        raw = self._cast(*self._view())
        raw = raw.unflatten(-1, (self.cfg.intrinsics.height, self.cfg.intrinsics.width))
        # NaN, from a pose that is NaN or infinite, fails the comparison, too.
        depth = torch.where(raw >= 0.0, raw, self.cfg.range)
        return add_noise(depth, self.cfg.noise, self.normal).clamp_(0.0, self.cfg.range)

    def _cast(self, position: Tensor, rotation: Tensor) -> Tensor:
        """Compute depth with the perturbation, [N, H * W] m; -1 beyond the range.

        Args:
            position: Positions of the cameras, [N, 3] m.
            rotation: Their axes, [N, 3, 3].
        """
        perturbation = self.perturbation
        lens = self.cfg.intrinsics
        limit = self.cfg.range
        if perturbation is None:
            return self._scanner.depth(position, rotation, lens, limit)
        # A scene that appears higher is a scene seen from lower.
        up = torch.eye(3, device=self._device)[2]
        position = position - perturbation.lift.unsqueeze(-1) * up
        rotation = rotation @ perturbation.turn
        raw = self._scanner.depth(position, rotation, lens, limit)
        # Render again where rays pass through some geoms.
        for geoms, robots in perturbation.unseen:
            bare = scanner(self._model, self._device, geoms)
            raw[robots] = bare.depth(position[robots], rotation[robots], lens, limit)
        return raw

    def normalised(self) -> Tensor:
        """Return the delivered depth divided by the range, [N, H, W] float16 in [0, 1]."""
        # Reading `data` renders the image if it is due.
        _ = self.data
        return self._normalised
