"""What the depth camera and the terrain sensors share: rays and the simulation's arrays."""

from typing import Any, TypeVar

import mujoco
from mjlab.sensor.sensor import Sensor

from renet.errors import RenetError
from renet.sim.depth.rasterizer import scanner

T = TypeVar("T")


class RaySensor(Sensor[T]):
    """An mjlab sensor that casts rays against the static terrain."""

    _data: Any

    def __init__(self, cfg: Any) -> None:
        super().__init__()
        self.cfg = cfg

    def edit_spec(self, scene_spec, entities) -> None:
        """Rays need nothing in the model."""

    def initialize(self, mj_model, model, data, device) -> None:
        """Find the terrain's mesh, which is built once for each model."""
        self._data, self._device = data, device
        self._scanner = scanner(mj_model, device)


def object_id(model: mujoco.MjModel, kind: mujoco.mjtObj, name: str) -> int:
    """Number of a body or site.

    Raises:
        RenetError: there is none of that name; lists those there are.
    """
    found = mujoco.mj_name2id(model, kind, name)
    if found >= 0:
        return found
    count = {mujoco.mjtObj.mjOBJ_BODY: model.nbody, mujoco.mjtObj.mjOBJ_SITE: model.nsite}[kind]
    known = filter(None, (mujoco.mj_id2name(model, kind, i) for i in range(count)))
    label = kind.name.removeprefix("mjOBJ_").lower()
    raise RenetError(f"the scene has no {label} {name!r}: choose one of {', '.join(known)}")
