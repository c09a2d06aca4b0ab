"""Sensors of the true terrain around a robot, for critics and as estimators' targets."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from mjlab.sensor.sensor import SensorCfg
from torch import Tensor

from renet.interface import HEIGHT_MAP_X, HEIGHT_MAP_Y, LEGS, MAP_HEIGHT
from renet.sim.depth.ray_sensor import RaySensor


@dataclass
class HeightMapCfg(SensorCfg):
    """The 2.5D map m_t on a yaw-aligned grid around the base."""

    body: str = "robot/trunk"
    x: tuple[float, ...] = HEIGHT_MAP_X
    y: tuple[float, ...] = HEIGHT_MAP_Y
    base_height: float = MAP_HEIGHT
    """Height of the base above the terrain that reads as zero, m."""
    limit: float = 1.0
    """Values are clipped to plus or minus this, m."""

    def build(self) -> HeightMap:
        """Instantiate the sensor."""
        return HeightMap(self)


@dataclass
class FeetHeightCfg(SensorCfg):
    """Feet height h_f, each foot's mean clearance over a 5 x 5 cm patch (RENet, Method A)."""

    sites: tuple[str, ...] = tuple(f"robot/{leg}" for leg in LEGS)
    """Sites in the middle of each foot."""
    radius: float = 0.023
    """Radius of a foot, m (Go1)."""
    patch: float = 0.05
    """Side of the square under each foot, m (paper), scanned at 3 x 3 points."""
    limits: tuple[float, float] = (-0.2, 1.0)
    """Values are clipped to this range, m."""

    def build(self) -> FeetHeight:
        """Instantiate the sensor."""
        return FeetHeight(self)


class HeightMap(RaySensor):
    """`data` is [N, len(x) * len(y)]: base over terrain less `base_height`, m; y varies fastest."""

    def initialize(self, mj_model, model, data, device) -> None:
        """Find the body and the terrain; raises KeyError for an unknown body."""
        self._body = mj_model.body(self.cfg.body).id
        super().initialize(mj_model, model, data, device)
        x, y = (torch.tensor(axis, device=device) for axis in (self.cfg.x, self.cfg.y))
        self._grid = torch.cartesian_prod(x, y)

    def _compute_data(self) -> Tensor:
        pose = self._data.xpos[:, self._body], self._data.xmat[:, self._body]
        over = self._scanner.clearance(*pose, self._grid) - self.cfg.base_height
        return over.clamp_(-self.cfg.limit, self.cfg.limit)


class FeetHeight(RaySensor):
    """`data` is [N, feet]: mean height of each foot above the terrain under it, m."""

    def initialize(self, mj_model, model, data, device) -> None:
        """Find the sites and the terrain; raises KeyError for an unknown site."""
        sites = [mj_model.site(name).id for name in self.cfg.sites]
        self._sites = torch.tensor(sites, device=device)
        super().initialize(mj_model, model, data, device)
        step = torch.linspace(-self.cfg.patch / 2, self.cfg.patch / 2, 3, device=device)
        self._patch = torch.cartesian_prod(step, step)

    def _compute_data(self) -> Tensor:
        feet = self._data.site_xpos[:, self._sites]
        over = self._scanner.clearance(feet.flatten(0, 1), None, self._patch)
        return (over.mean(-1) - self.cfg.radius).clamp_(*self.cfg.limits).view(feet.shape[:2])
