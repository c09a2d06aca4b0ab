"""True terrain around a robot, for critics and as the estimators' targets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import torch
from mjlab.sensor.sensor import Sensor, SensorCfg
from torch import Tensor

from renet.errors import RenetError
from renet.sim.raycast import scanner
from renet.vocabulary import HEIGHT_MAP_X, HEIGHT_MAP_Y, LEGS

BASE_HEIGHT = 0.3
"""Metres of the base above flat ground that read as height zero (Extreme Parkour)."""
FOOT_RADIUS = 0.023
"""Metres (Go1 model)."""
PATCH = 0.05
"""Side in metres of the square under each foot (paper: 5 x 5 cm)."""


def _object_id(model: mujoco.MjModel, kind: mujoco.mjtObj, name: str) -> int:
    found = mujoco.mj_name2id(model, kind, name)
    if found < 0:
        raise RenetError(f"the scene has no {kind.name.removeprefix('mjOBJ_').lower()} {name!r}")
    return found


@dataclass
class HeightMapCfg(SensorCfg):
    """2.5D map m_t on a yaw-aligned grid around the base."""

    body: str = "robot/trunk"
    x: tuple[float, ...] = HEIGHT_MAP_X
    y: tuple[float, ...] = HEIGHT_MAP_Y
    limit: float = 1.0
    """Values are clipped to plus or minus this, m."""

    def build(self) -> HeightMap:
        """Instantiate the sensor."""
        return HeightMap(self)


@dataclass
class FeetHeightCfg(SensorCfg):
    """Feet height h_f: each foot's mean clearance over a 5 x 5 cm patch (RENet, Method A)."""

    sites: tuple[str, ...] = tuple(f"robot/{leg}" for leg in LEGS)
    limits: tuple[float, float] = (-0.2, 1.0)
    """Values are clipped to this range, m."""

    def build(self) -> FeetHeight:
        """Instantiate the sensor."""
        return FeetHeight(self)


class TerrainSensor(Sensor[Tensor]):
    """What both sensors share: a scanner and the simulation's arrays."""

    _data: Any

    def edit_spec(self, scene_spec, entities) -> None:
        """Rays need nothing in the model."""

    def initialize(self, mj_model, model, data, device) -> None:
        """Find the mesh."""
        self._data, self._device = data, device
        self._scanner = scanner(mj_model, device)

    def _heights(self, points: Tensor) -> Tensor:
        """Terrain height under [..., 2] world points."""
        return self._scanner.height(points.reshape(-1, 2)).reshape(points.shape[:-1])


class HeightMap(TerrainSensor):
    """`data` is [N, len(x) * len(y)]: base height over the terrain, less BASE_HEIGHT, m."""

    def __init__(self, cfg: HeightMapCfg) -> None:
        super().__init__()
        self.cfg = cfg

    def initialize(self, mj_model, model, data, device) -> None:
        """See TerrainSensor.initialize."""
        super().initialize(mj_model, model, data, device)
        self._body = _object_id(mj_model, mujoco.mjtObj.mjOBJ_BODY, self.cfg.body)
        x, y = (torch.tensor(axis, device=device) for axis in (self.cfg.x, self.cfg.y))
        self._grid = torch.cartesian_prod(x, y)

    def _compute_data(self) -> Tensor:
        position, quaternion = self._data.xpos[:, self._body], self._data.xquat[:, self._body]
        w, x, y, z = quaternion.unbind(-1)
        yaw = torch.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        forward = torch.stack((yaw.cos(), yaw.sin()), dim=-1)
        left = torch.stack((-yaw.sin(), yaw.cos()), dim=-1)
        offset = self._grid[:, :1] * forward[:, None] + self._grid[:, 1:] * left[:, None]
        heights = self._heights(position[:, None, :2] + offset)
        limit = self.cfg.limit
        return (position[:, 2:] - BASE_HEIGHT - heights).clamp(-limit, limit)


class FeetHeight(TerrainSensor):
    """`data` is [N, feet]: mean height of each foot above the terrain under it, m."""

    def __init__(self, cfg: FeetHeightCfg) -> None:
        super().__init__()
        self.cfg = cfg

    def initialize(self, mj_model, model, data, device) -> None:
        """See TerrainSensor.initialize."""
        super().initialize(mj_model, model, data, device)
        sites = [_object_id(mj_model, mujoco.mjtObj.mjOBJ_SITE, name) for name in self.cfg.sites]
        self._sites = torch.tensor(sites, device=device)
        step = torch.linspace(-PATCH / 2, PATCH / 2, 3, device=device)
        self._patch = torch.cartesian_prod(step, step)

    def _compute_data(self) -> Tensor:
        feet = self._data.site_xpos[:, self._sites]
        under = self._heights(feet[:, :, None, :2] + self._patch).mean(-1)
        return (feet[..., 2] - FOOT_RADIUS - under).clamp(*self.cfg.limits)
