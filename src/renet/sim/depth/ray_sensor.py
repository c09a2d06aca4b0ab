"""Base of the depth camera and the terrain sensors."""

from typing import Any

from mjlab.sensor.sensor import Sensor
from torch import Tensor

from renet.sim.depth.rasterizer import scanner


class RaySensor(Sensor[Tensor]):
    """mjlab sensor that casts rays against the static terrain."""

    _data: Any

    def __init__(self, cfg: Any) -> None:
        super().__init__()
        self.cfg = cfg

    def edit_spec(self, scene_spec, entities) -> None:
        """Change nothing; mjlab calls this before it compiles the model."""

    def initialize(self, mj_model, model, data, device) -> None:
        """Store the simulation's arrays, and build a scanner of the model's terrain."""
        self._data = data
        self._device = device
        self._scanner = scanner(mj_model, device)
