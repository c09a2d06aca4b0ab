"""The stages of a physics step, and how much of the model each of them looks at.

MuJoCo's stages go through all bodies and geoms. A terrain's are most of these and never move, so
where they come last, every stage but collision detection is shown a model that ends before them.
Results are the same, but for sums over the whole world.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

from renet.errors import RenetError

POSITION = ("mj_kinematics", "mj_comPos", "mj_camlight", "mj_tendon")
CONTACTS = ("mj_makeM", "mj_factorM", "mj_collision")
CONTACTS += ("mj_makeConstraint", "mj_island", "mj_projectConstraint")
SENSED = ("mj_transmission", "mj_sensorPos", "mj_fwdVelocity", "mj_sensorVel")
UNSENSED = ("mj_transmission", "mj_fwdVelocity")
UNSENSED += ("mj_fwdActuation", "mj_fwdAcceleration", "mj_fwdConstraint")
DERIVE = (*POSITION, *SENSED)
"""`mj_forward` without contacts and accelerations."""
INTEGRATORS = {
    mujoco.mjtIntegrator.mjINT_EULER: "mj_Euler",
    mujoco.mjtIntegrator.mjINT_IMPLICIT: "mj_implicit",
    mujoco.mjtIntegrator.mjINT_IMPLICITFAST: "mj_implicit",
}
SUMS = ("SUBTREECOM", "SUBTREELINVEL", "SUBTREEANGMOM", "E_POTENTIAL", "E_KINETIC")
"""Sensors that can be of the whole world."""
UNBOUND = ("RANGEFINDER", "TACTILE", "PLUGIN", "USER")
"""Sensors that may look at any geom."""


def _library() -> ctypes.CDLL:
    """MuJoCo's own, which its Python package has loaded."""
    folder = Path(mujoco.__file__).parent
    for pattern in ("libmujoco.so*", "libmujoco*.dylib"):
        for path in folder.glob(pattern):
            return ctypes.CDLL(str(path))
    raise RenetError(f"no MuJoCo library in {folder}: renet simulates on Linux and macOS")


LIBRARY = _library()


class Pipeline:
    """What native_kernel.advance calls, one stage after another, for one worker's model."""

    def __init__(self, model: mujoco.MjModel) -> None:
        """Set up for a model nobody else uses: its counts change from stage to stage."""
        self.counts = [_count(model, "nbody"), _count(model, "ngeom")]
        """Addresses of the model's numbers of bodies and geoms."""
        self._whole = [model.nbody, model.ngeom]
        self._moving = moving_part(model)
        # MuJoCo sweeps along principal axes of all geoms' positions but the world's. With one geom
        # these are the world's axes, along which tiles lie: fewer bounding boxes overlap.
        of_world = int((model.geom_bodyid == 0).sum())
        self._colliding = [model.nbody, min(of_world + 1, model.ngeom)]
        self.forward = self._stages(["mj_forward"], self._whole)
        self.derive = self._stages(DERIVE, self._moving)
        self.step = self.last_step = self._stages(["mj_step"], self._whole)
        if self._moving != self._whole:
            # Sensors wait for the last step.
            step = (*POSITION, *CONTACTS, *UNSENSED, INTEGRATORS[model.opt.integrator])
            self.step = self._stages(step, self._moving)
            self.last_step = self._stages((*POSITION, *CONTACTS, *SENSED, "mj_step2"), self._moving)

    def _stages(self, functions: Sequence[str], shown: list[int]) -> list[int]:
        """Address, number of bodies and number of geoms of each."""
        special = {"mj_collision": self._colliding}
        return [
            number for name in functions for number in (_address(name), *special.get(name, shown))
        ]


def moving_part(model: mujoco.MjModel) -> list[int]:
    """Numbers of bodies and geoms up to the last that moves; of all where that could matter.

    It could to MuJoCo's rarer features, whose stages are not among those above, and to sensors
    that look at the terrain.
    """
    sums, unbound = (
        np.isin(model.sensor_type, [getattr(mujoco.mjtSensor, f"mjSENS_{name}") for name in names])
        for names in (SUMS, UNBOUND)
    )
    if (
        model.nflex
        or model.opt.enableflags
        or model.opt.integrator not in INTEGRATORS
        or (unbound | sums & (model.sensor_objid <= 0)).any()
    ):
        return [model.nbody, model.ngeom]
    moving = moving_bodies(model)
    bodies = int(np.flatnonzero(moving).max(initial=0)) + 1
    return [bodies, int((model.geom_bodyid < bodies).sum())]


def moving_bodies(model: mujoco.MjModel) -> np.ndarray:
    """[nbody] bool: bodies that can move, mocap included."""
    return (model.body_weldid != 0) | (model.body_mocapid[model.body_rootid] >= 0)


def _address(function: str) -> int:
    return ctypes.cast(getattr(LIBRARY, function), ctypes.c_void_p).value or 0


def _count(model: mujoco.MjModel, name: str) -> int:
    """Address of a number at the beginning of mjModel, found by changing it."""
    sizes = (ctypes.c_int64 * 32).from_address(model._address)
    value = getattr(model, name)
    for index in [i for i, size in enumerate(sizes) if size == value]:
        sizes[index] += 1
        found = getattr(model, name) == value + 1
        sizes[index] -= 1
        if found:
            return model._address + 8 * index
    raise RenetError(f"the native engine does not know mjModel of MuJoCo {mujoco.__version__}")
