"""Stages shown a part of the model, against MuJoCo's own step on all of it."""

from __future__ import annotations

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from mjlab.sim.sim import MujocoCfg, SimulationCfg

from renet.errors import RenetError
from renet.sim import pipeline
from renet.sim.native.engine import NativeSimulation
from renet.sim.native.stages import moving_part

NUM_ENVS = 2
STEPS = 300
WALKER = """
<body name="trunk" pos="0.3 0.2 0.35"><freejoint/>
  <geom type="box" size=".2 .1 .05" mass="4"/><site name="imu"/>
  <body pos="0.2 0.1 0"><joint name="hip" axis="0 1 0" damping=".1"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".5"/>
    <geom name="foot" type="sphere" pos="0 0 -.3" size=".03" mass=".1"/></body>
  <body pos="-0.2 -0.1 0"><joint name="knee" axis="0 1 0" damping=".1"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".5"/></body>
</body>
"""
TILES = "".join(
    f'<body name="tile_{x}{y}" pos="{x} {y} 0" euler="0 0 {10 * x}">'
    f'<geom type="box" size=".5 .5 {0.05 + 0.03 * x}"/>'
    f'<geom type="box" pos=".2 0 .1" size=".1 .5 .1"/></body>'
    for x in range(3)
    for y in range(2)
)
PLANE = '<geom type="plane" size="9 9 1"/>'
SENSORS = """
<accelerometer site="imu"/><gyro site="imu"/><framezaxis objtype="site" objname="imu"/>
<subtreeangmom body="trunk"/><framepos objtype="body" objname="tile_21"/>
<contact geom1="foot" data="found force" num="1"/>
"""


def scene(*bodies: str, sensors: str = SENSORS) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(
        '<mujoco><option integrator="implicitfast"/>'
        f"<worldbody>{''.join(bodies)}</worldbody>"
        '<actuator><position joint="hip" kp="20"/><position joint="knee" kp="20"/></actuator>'
        f"<sensor>{sensors}</sensor></mujoco>"
    )


@pytest.mark.parametrize("order", [(PLANE, WALKER, TILES), (WALKER, TILES), (TILES, WALKER)])
@pytest.mark.parametrize("integrator", ["implicitfast", "euler"])
def test_steps_are_mujocos_own(order, integrator):
    """Also while limbs touch the tiles; state, forces and every sensor."""
    cfg = SimulationCfg(mujoco=MujocoCfg(timestep=0.005, integrator=integrator))
    simulation = NativeSimulation(NUM_ENVS, cfg, scene(*order), "cpu")
    model = simulation.mj_model
    assert (moving_part(model)[0] < model.nbody) == (order[-1] is TILES)
    simulation.data.ctrl[:, 0], simulation.data.ctrl[:, 1] = 0.5, -0.5
    simulation._run("step", STEPS)
    assert all(worker.model.nbody == model.nbody for worker in simulation._workers)

    reference = model.__copy__()
    reference.opt.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
    data = mujoco.MjData(reference)
    data.qpos[:] = np.float32(data.qpos)
    data.ctrl[:] = 0.5, -0.5
    mujoco.mj_step(reference, data, STEPS)
    assert data.ncon > 2
    assert data.sensordata[-4] > 0.0  # The foot touches something.
    for name in ("qpos", "qvel", "qacc", "qfrc_constraint", "sensordata", "xpos", "geom_xpos"):
        mine, own = getattr(simulation.data, name)[:].numpy(), getattr(data, name)
        np.testing.assert_array_equal(mine, np.float32(np.stack([own] * NUM_ENVS)), err_msg=name)


ENERGY, SUM, RAY = "<e_potential/>", '<subtreecom body="world"/>', '<rangefinder site="imu"/>'


@pytest.mark.parametrize(
    ("sensors", "trimmed"),
    [(SENSORS, True), (SENSORS + SUM, False), (SENSORS + ENERGY, False), (SENSORS + RAY, False)],
)
def test_what_looks_at_the_whole_world_is_shown_all_of_it(sensors, trimmed):
    model = scene(WALKER, TILES, sensors=sensors)
    bodies, geoms = moving_part(model)
    assert (bodies, geoms) == ((4, 4) if trimmed else (model.nbody, model.ngeom))


@pytest.mark.parametrize("feature", ["RK4", "energy"])
def test_rare_features_are_left_to_mujocos_step(feature):
    model = scene(WALKER, TILES)
    if feature == "RK4":
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    else:
        model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    assert moving_part(model) == [model.nbody, model.ngeom]


def test_bodies_moved_by_hand_are_among_what_moves():
    moved = '<body name="moved" mocap="true"><geom size=".1"/></body>'
    assert moving_part(scene(WALKER, TILES, moved))[0] == scene(WALKER, TILES, moved).nbody


def test_a_model_laid_out_otherwise_is_refused():
    model = scene(WALKER, TILES)
    constant = SimpleNamespace(_address=model._address, nbody=model.nbody)
    with pytest.raises(RenetError, match="does not know mjModel"):
        pipeline._count(constant, "nbody")  # Its number of bodies does not change when written.
    assert model.nbody == 10


def test_a_platform_without_a_known_library_is_refused(monkeypatch, tmp_path):
    monkeypatch.setattr(mujoco, "__file__", str(tmp_path / "__init__.py"))
    with pytest.raises(RenetError, match="Linux and macOS"):
        pipeline._library()
    (tmp_path / "libmujoco.9.dylib").touch()
    with pytest.raises(OSError, match="dylib"):  # Found, but empty.
        pipeline._library()
