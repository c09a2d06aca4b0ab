"""Stages of a physics step, and the part of the model that each of them processes.

MuJoCo's stages loop over all bodies and geoms, most of which are terrain and never move. Where
these come last, all stages but collision detection process a model that ends before them. Results
are the same, except sums over the whole world.
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
SENSOR_STAGES = ("mj_transmission", "mj_sensorPos", "mj_fwdVelocity", "mj_sensorVel")
SENSORLESS_STAGES = ("mj_transmission", "mj_fwdVelocity")
SENSORLESS_STAGES += ("mj_fwdActuation", "mj_fwdAcceleration", "mj_fwdConstraint")
DRIVE = "drive"
"""Stage of the motors at the beginning of a physics step, which is not MuJoCo's (`drive` in
engine.cpp)."""
DERIVE = (*POSITION, *SENSOR_STAGES)
"""Stages of `mj_forward` without contacts and accelerations."""
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
    """Function of MuJoCo, or `DRIVE`, and the part of the model that it processes."""

    function: str
    """Name of the function."""
    bodies: int
    """Number of bodies, from the first."""
    geoms: int
    """Number of geoms, from the first."""


def stages_of(model: mujoco.MjModel, steps: int, derive: bool, driven: bool = False) -> list[Stage]:
    """List the stages of physics steps, in order.

    Args:
        model: The model, which is not changed.
        steps: Number of steps; 0 computes all that follows from the present state.
        derive: End with poses and velocities of the state after the last step.
        driven: Begin each step with `DRIVE`.
    """
    whole = (model.nbody, model.ngeom)
    moving = moving_part(model)
    if not steps:
        return [Stage("mj_forward", *whole)]
    # MuJoCo sweeps along the principal axes of the positions of all geoms but the world's. If there
    # is one such geom, these are the world's axes, as are the tiles': fewer bounding boxes overlap.
    world_geoms = int((model.geom_bodyid == 0).sum())
    # Stages that process more than what moves.
    parts = {"mj_step": whole, "mj_collision": (model.nbody, min(world_geoms + 1, model.ngeom))}
    if moving == whole:
        step = ("mj_step",)
        last_step = ("mj_step",)
    else:
        step = (*POSITION, *CONTACTS, *SENSORLESS_STAGES, INTEGRATORS[model.opt.integrator])
        # Sensors are computed in the last step alone.
        last_step = (*POSITION, *CONTACTS, *SENSOR_STAGES, "mj_step2")
    if driven:
        step = (DRIVE, *step)
        last_step = (DRIVE, *last_step)
    functions = step * (steps - 1) + last_step
    if derive:
        functions += DERIVE
    return [Stage(name, *parts.get(name, moving)) for name in functions]


def moving_part(model: mujoco.MjModel) -> tuple[int, int]:
    """Count the bodies and the geoms up to the last one that moves.

    The counts are those of the whole model if a sensor may read the terrain, or if the model has
    features of MuJoCo whose stages are not among those above.
    """
    sums = _is_sensor(model, SUMS) & (model.sensor_objid <= 0)
    reads_terrain = (_is_sensor(model, UNBOUND) | sums).any()
    has_other_stages = (
        model.nflex or model.opt.enableflags or model.opt.integrator not in INTEGRATORS
    )
    if has_other_stages or reads_terrain:
        return model.nbody, model.ngeom
    bodies = int(np.flatnonzero(moving_bodies(model)).max(initial=0)) + 1
    geoms = int((model.geom_bodyid < bodies).sum())
    return bodies, geoms


def _is_sensor(model: mujoco.MjModel, names: tuple[str, ...]) -> np.ndarray:
    """Return a mask of the sensors of some types, [nsensor] bool."""
    types = [getattr(mujoco.mjtSensor, f"mjSENS_{name}") for name in names]
    return np.isin(model.sensor_type, types)


def moving_bodies(model: mujoco.MjModel) -> np.ndarray:
    """Return a mask of the bodies that can move, mocap bodies among them, [nbody] bool."""
    return (model.body_weldid != 0) | (model.body_mocapid[model.body_rootid] >= 0)


@cache
def check_mujoco() -> None:
    """Check the version of MuJoCo, the layout of its structs, and its stages against `mj_step`.

    Raises:
        RenetError: The installed MuJoCo cannot be stepped stage by stage.
    """
    try:
        _check_stages()
    except (LookupError, AttributeError, OSError) as error:
        raise RenetError(
            f"the native engine cannot step MuJoCo {mujoco.__version__}: {error}. Install "
            f"mujoco~={mujoco_memory.VERSION}0, or use --engine warp"
        ) from error


def _check_stages() -> None:
    """Raise LookupError, AttributeError or OSError if a step cannot be split into stages."""
    if not mujoco.__version__.startswith(mujoco_memory.VERSION):
        raise LookupError(f"it knows versions {mujoco_memory.VERSION}*")
    model = mujoco.MjModel.from_xml_string(SELF_CHECK)
    expected = mujoco.MjData(model)
    data = mujoco.MjData(model)
    num_bodies = mujoco_memory.model_size(model, "nbody")
    num_geoms = mujoco_memory.model_size(model, "ngeom")
    library = mujoco_memory.mujoco_library()
    time = mujoco_memory.time(data)

    # Take two steps stage by stage, each with its part of the model.
    mujoco.mj_forward(model, data)  # Poses of bodies that never move.
    bodies = model.nbody
    geoms = model.ngeom
    for stage in stages_of(model, 2, derive=False):
        num_bodies.value = stage.bodies
        num_geoms.value = stage.geoms
        function = getattr(library, stage.function)
        function.argtypes = [c_void_p] * 2
        function.restype = None
        function(model._address, data._address)
    num_bodies.value = bodies
    num_geoms.value = geoms

    # Compare with MuJoCo's own steps.
    mujoco.mj_step(model, expected, 2)
    for name in ("qpos", "qvel", "sensordata", "qfrc_constraint"):
        if not np.array_equal(getattr(expected, name), getattr(data, name)):
            raise LookupError("its stages do not make its step")
    if time[0] != expected.time:
        raise LookupError("its stages do not make its step")
