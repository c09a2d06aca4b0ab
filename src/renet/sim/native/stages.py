"""The stages of a physics step, and the part of the model that each of them gets.

MuJoCo's stages loop over all bodies and geoms, of which most are terrain and never move. Where
these come last, all stages but collision detection get a model that ends before them. Results are
the same, except sums over the whole world.
"""

from ctypes import c_void_p
from functools import cache
from typing import NamedTuple

import mujoco
import numpy as np

from renet.errors import RenetError
from renet.sim.native import mujoco_memory

POSITION = ("mj_kinematics", "mj_comPos", "mj_camlight", "mj_tendon")
CONTACTS = ("mj_makeM", "mj_factorM", "mj_collision")
CONTACTS += ("mj_makeConstraint", "mj_island", "mj_projectConstraint")
SENSED = ("mj_transmission", "mj_sensorPos", "mj_fwdVelocity", "mj_sensorVel")
UNSENSED = ("mj_transmission", "mj_fwdVelocity")
UNSENSED += ("mj_fwdActuation", "mj_fwdAcceleration", "mj_fwdConstraint")
DRIVE = "drive"
"""Not of MuJoCo: motors at the beginning of a physics step (`drive` in engine.cpp)."""
DERIVE = (*POSITION, *SENSED)
"""The stages of `mj_forward` without contacts and accelerations."""
INTEGRATORS = {
    mujoco.mjtIntegrator.mjINT_EULER: "mj_Euler",
    mujoco.mjtIntegrator.mjINT_IMPLICIT: "mj_implicit",
    mujoco.mjtIntegrator.mjINT_IMPLICITFAST: "mj_implicit",
}
SUMS = ("SUBTREECOM", "SUBTREELINVEL", "SUBTREEANGMOM", "E_POTENTIAL", "E_KINETIC")
"""Sensors that may sum over the whole world."""
UNBOUND = ("RANGEFINDER", "TACTILE", "PLUGIN", "USER")
"""Sensors that may read any geom."""
SELF_CHECK = """
<mujoco><option integrator="implicitfast"/><worldbody><geom type="plane" size="1 1 1"/>
<body pos="0 0 .1"><freejoint/><geom type="box" size=".1 .1 .1"/>
  <body pos=".1 0 0"><joint name="hinge" axis="0 1 0"/><geom size=".05" pos=".1 0 0"/></body></body>
<body><geom type="box" size=".1 .2 .05" pos=".2 0 0"/></body></worldbody>
<actuator><position joint="hinge" kp="2"/></actuator><sensor><jointvel joint="hinge"/></sensor>
</mujoco>
"""


class Stage(NamedTuple):
    """A function of MuJoCo, or `DRIVE`, and the numbers of bodies and geoms that its model has."""

    function: str
    bodies: int
    geoms: int


def stages_of(model: mujoco.MjModel, steps: int, derive: bool, driven: bool = False) -> list[Stage]:
    """The stages of physics steps of a model, in order.

    Args:
        model: not changed. steps: number of steps; 0: all that follows from the present state.
        derive: whether to end with poses and velocities of the state after the last step.
        driven: whether each step begins with `DRIVE`.
    """
    whole, moving = (model.nbody, model.ngeom), moving_part(model)
    if not steps:
        return [Stage("mj_forward", *whole)]
    # MuJoCo sweeps along the principal axes of the positions of all geoms but the world's. If there
    # is one such geom, these are the world's axes, as are the tiles': fewer bounding boxes overlap.
    of_world = int((model.geom_bodyid == 0).sum())
    shown = {"mj_step": whole, "mj_collision": (model.nbody, min(of_world + 1, model.ngeom))}
    if moving == whole:
        step = last_step = ("mj_step",)
    else:
        step = (*POSITION, *CONTACTS, *UNSENSED, INTEGRATORS[model.opt.integrator])
        # Sensors are computed in the last step alone.
        last_step = (*POSITION, *CONTACTS, *SENSED, "mj_step2")
    if driven:
        step = (DRIVE, *step)
        last_step = (DRIVE, *last_step)
    functions = step * (steps - 1) + last_step + (DERIVE if derive else ())
    return [Stage(name, *shown.get(name, moving)) for name in functions]


def moving_part(model: mujoco.MjModel) -> tuple[int, int]:
    """Numbers of bodies and geoms up to the last one that moves.

    They are those of the whole model if a sensor may read the terrain, or if it has features of
    MuJoCo whose stages are not among those above.
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
        return model.nbody, model.ngeom
    bodies = int(np.flatnonzero(moving_bodies(model)).max(initial=0)) + 1
    return bodies, int((model.geom_bodyid < bodies).sum())


def moving_bodies(model: mujoco.MjModel) -> np.ndarray:
    """[nbody] bool: bodies that can move, mocap bodies included."""
    return (model.body_weldid != 0) | (model.body_mocapid[model.body_rootid] >= 0)


@cache
def check_mujoco() -> None:
    """Check the version of MuJoCo, the layout of its structs, and its stages against `mj_step`.

    Raises:
        RenetError: the installed MuJoCo cannot be stepped stage by stage.
    """
    try:
        _check_stages()
    except (LookupError, AttributeError, OSError) as error:
        raise RenetError(
            f"the native engine cannot step MuJoCo {mujoco.__version__}: {error}. Install "
            f"mujoco~={mujoco_memory.VERSION}0, or use --engine warp"
        ) from error


def _check_stages() -> None:
    """Raise LookupError, AttributeError or OSError where a step cannot be split into stages."""
    if not mujoco.__version__.startswith(mujoco_memory.VERSION):
        raise LookupError(f"it knows versions {mujoco_memory.VERSION}*")
    model = mujoco.MjModel.from_xml_string(SELF_CHECK)
    plain, staged = mujoco.MjData(model), mujoco.MjData(model)
    sizes = [mujoco_memory.model_size(model, name) for name in ("nbody", "ngeom")]
    library, time = mujoco_memory.library(), mujoco_memory.time(staged)
    mujoco.mj_forward(model, staged)  # Poses of what never moves.
    whole = model.nbody, model.ngeom
    for stage in stages_of(model, 2, derive=False):
        for size, shown in zip(sizes, stage[1:], strict=True):
            size.value = shown
        function = getattr(library, stage.function)
        function.argtypes, function.restype = [c_void_p] * 2, None
        function(model._address, staged._address)
    for size, value in zip(sizes, whole, strict=True):
        size.value = value
    mujoco.mj_step(model, plain, 2)
    same = all(
        np.array_equal(getattr(plain, name), getattr(staged, name))
        for name in ("qpos", "qvel", "sensordata", "qfrc_constraint")
    )
    if not same or time[0] != plain.time:
        raise LookupError("its stages do not make its step")
