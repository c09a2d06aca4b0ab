"""Sensors of the true terrain around a robot, for critics and as targets of estimators."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from mjlab.sensor.sensor import SensorCfg
from torch import Tensor

from renet.interface import HEIGHT_MAP_X, HEIGHT_MAP_Y, LEGS, MAP_HEIGHT
from renet.sim.depth.ray_sensor import RaySensor


@dataclass
class HeightMapCfg(SensorCfg):
    """2.5D height map m_t on a yaw-aligned grid around the base."""

    body: str = "robot/trunk"
    """Body around which the map is."""
    x: tuple[float, ...] = HEIGHT_MAP_X
    """Positions of the grid's points, forwards, m."""
    y: tuple[float, ...] = HEIGHT_MAP_Y
    """Positions of the grid's points, to the left, m."""
    base_height: float = MAP_HEIGHT
    """Height of the base above the terrain at which the map is zero, m."""
    limit: float = 1.0
    """Largest absolute value, to which values are clipped, m."""

    def build(self) -> HeightMap:
        """Instantiate the sensor."""
        return HeightMap(self)


@dataclass
class FeetHeightCfg(SensorCfg):
    """Feet heights h_f: mean clearance of each foot over a patch of 5 x 5 cm (RENet, Method A)."""

    sites: tuple[str, ...] = tuple(f"robot/{leg}" for leg in LEGS)
    """Sites at the centres of the feet."""
    radius: float = 0.023
    """Radius of a foot, m (Go1)."""
    patch: float = 0.05
    """Side of the square under each foot, m (paper); it is scanned at 3 x 3 points."""
    limits: tuple[float, float] = (-0.2, 1.0)
    """Smallest and largest value, to which values are clipped, m."""

    def build(self) -> FeetHeight:
        """Instantiate the sensor."""
        return FeetHeight(self)


class HeightMap(RaySensor):
    """Sensor of the height map.

    `data` is the height of the base above the terrain, less `base_height`, at each point of the
    grid, [N, len(x) * len(y)] m; y varies fastest.
    """

    def initialize(self, mj_model, model, data, device) -> None:
        """Find the body and the terrain; raises KeyError for an unknown body."""
        self._body = mj_model.body(self.cfg.body).id
        super().initialize(mj_model, model, data, device)
        x = torch.tensor(self.cfg.x, device=device)
        y = torch.tensor(self.cfg.y, device=device)
        self._grid = torch.cartesian_prod(x, y)

    def _compute_data(self) -> Tensor:
        position = self._data.xpos[:, self._body]
        rotation = self._data.xmat[:, self._body]
        height = self._scanner.clearance(position, rotation, self._grid) - self.cfg.base_height
        return height.clamp_(-self.cfg.limit, self.cfg.limit)


class FeetHeight(RaySensor):
    """Sensor of the feet's heights; `data` is the mean clearance of each foot, [N, feet] m."""

    def initialize(self, mj_model, model, data, device) -> None:
        """Find the sites and the terrain; raises KeyError for an unknown site."""
        sites = [mj_model.site(name).id for name in self.cfg.sites]
        self._sites = torch.tensor(sites, device=device)
        super().initialize(mj_model, model, data, device)
        step = torch.linspace(-self.cfg.patch / 2, self.cfg.patch / 2, 3, device=device)
        self._patch = torch.cartesian_prod(step, step)

    def _compute_data(self) -> Tensor:
        feet = self._data.site_xpos[:, self._sites]
        clearance = self._scanner.clearance(feet.flatten(0, 1), None, self._patch)
        height = (clearance.mean(-1) - self.cfg.radius).clamp_(*self.cfg.limits)
        return height.view(feet.shape[:2])
