"""Stages shown a part of the model, against MuJoCo's own step on all of it."""

import mujoco
import numpy as np
import pytest
from tests.sim.scenes import PLANE, scene, simulate

from renet.errors import RenetError
from renet.sim.native import engine, mujoco_memory, stages
from renet.sim.native.stages import moving_part

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
SENSORS = """
<accelerometer site="imu"/><gyro site="imu"/><framezaxis objtype="site" objname="imu"/>
<subtreeangmom body="trunk"/><framepos objtype="body" objname="tile_21"/>
<contact geom1="foot" data="found force" num="1"/>
"""


MOTORS = '<actuator><position joint="hip" kp="20"/><position joint="knee" kp="20"/></actuator>'


def robots(*bodies: str, sensors: str = SENSORS) -> mujoco.MjModel:
    return scene(*bodies, extra=f"{MOTORS}<sensor>{sensors}</sensor>")


@pytest.mark.parametrize("order", [(PLANE, WALKER, TILES), (WALKER, TILES), (TILES, WALKER)])
@pytest.mark.parametrize("integrator", ["implicitfast", "euler"])
def test_steps_are_mujocos_own(order, integrator, monkeypatch):
    """Also while limbs touch the tiles; state, forces and every sensor."""
    monkeypatch.setattr(engine, "THREADS", 64)
    simulation = simulate(robots(*order), integrator=integrator)
    model = simulation.mj_model
    assert (moving_part(model)[0] < model.nbody) == (order[-1] is TILES)
    simulation.data.ctrl[:, 0], simulation.data.ctrl[:, 1] = 0.5, -0.5
    simulation._advance(300)
    assert [worker.model.nbody for worker in simulation._workers] == [model.nbody] * 3

    reference = model.__copy__()
    data = mujoco.MjData(reference)
    data.qpos[:] = np.float32(data.qpos)
    data.ctrl[:] = 0.5, -0.5
    mujoco.mj_step(reference, data, 300)
    assert data.ncon > 2
    assert data.sensordata[-4] > 0.0  # The foot touches something.
    poses = ("xpos", "xquat", "cvel", "geom_xpos", "site_xpos")
    for name in ("time", "qpos", "qvel", "qacc", "qfrc_constraint", "sensordata", *poses):
        expected = np.float32(np.stack([getattr(data, name)] * 3))
        values = getattr(simulation.data, name)[:].numpy()
        np.testing.assert_array_equal(values, expected, err_msg=name)


WHOLE_WORLD = ("<e_potential/>", '<subtreecom body="world"/>', '<rangefinder site="imu"/>')


def test_world_sensors_get_whole_model():
    assert moving_part(robots(WALKER, TILES)) == (4, 4)
    by_hand = robots(WALKER, TILES, '<body mocap="true"><geom size=".1"/></body>')
    assert moving_part(by_hand)[0] == by_hand.nbody
    rare = [robots(WALKER, TILES, sensors=SENSORS + sensor) for sensor in WHOLE_WORLD]
    rare += [robots(WALKER, TILES), robots(WALKER, TILES)]
    rare[-2].opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    rare[-1].opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    for model in rare:
        assert moving_part(model) == (model.nbody, model.ngeom)


@pytest.mark.parametrize(
    ("module", "name", "value", "message"),
    [
        (mujoco, "__version__", "3.99.1", r"3\.99\.1: it knows versions 3\.11"),
        (mujoco, "__file__", "empty/__init__.py", "no MuJoCo library in"),
        (mujoco, "__file__", "broken/__init__.py", "dylib"),
        (mujoco_memory, "NUM_SIZES", 1, "mjModel.nbody is not among"),
        (stages, "CONTACTS", stages.CONTACTS[:2], "its stages do not make its step"),
    ],
)
def test_unknown_mujoco_is_refused(monkeypatch, tmp_path, module, name, value, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "libmujoco.9.dylib").touch()
    monkeypatch.setattr(module, name, value)
    for check in (stages.check_mujoco, mujoco_memory.mujoco_library):
        check.cache_clear()
    with pytest.raises(RenetError, match=rf"{message}.*mujoco~=3\.11\.0, or use --engine warp"):
        simulate(robots(WALKER, TILES))
    mujoco_memory.mujoco_library.cache_clear()


def test_time_is_found_unchanged():
    data = mujoco.MjData(robots(WALKER, TILES))
    data.time = 2.5
    assert mujoco_memory.time(data) == [2.5]
    data.time = 3.0
    assert mujoco_memory.time(data) == [3.0]
