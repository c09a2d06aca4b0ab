"""The native engine in contact: randomised friction, touch, pushes, stock Rough."""

import numpy as np
import pytest
import torch
from mjlab.envs import ManagerBasedRlEnvCfg
from mjlab.sim.sim import MujocoCfg, Simulation, SimulationCfg
from tests.sim.scenes import make_both, scene

from renet.errors import RenetError
from renet.sim.native.engine import NativeSimulation

NUM_ENVS = 3
ROUGH = "Mjlab-Velocity-Rough-Unitree-Go1"
CRATE = """<geom name="floor" type="plane" size="0 0 1"/>
<body name="crate" pos="0 0 0.1"><freejoint/>
  <geom name="crate" type="box" size="0.15 0.15 0.1" mass="2" priority="1"/></body>"""
TOUCH = """<sensor><contact geom1="crate" geom2="floor" data="found force" reduce="netforce"/>
</sensor>"""


def crates(crate: str = CRATE) -> list[Simulation]:
    """The same crates on a floor under Warp and under the native engine."""
    cfg, model = SimulationCfg(mujoco=MujocoCfg(timestep=0.005)), scene(crate, extra=TOUCH)
    return [kind(NUM_ENVS, cfg, model, "cpu") for kind in (Simulation, NativeSimulation)]


def run(sims: list[Simulation], steps: int) -> None:
    for sim in sims:
        for _ in range(steps):
            sim.step()
        sim.forward()


def both(sims: list[Simulation], name: str) -> tuple[np.ndarray, np.ndarray]:
    warp, native = (getattr(sim.data, name)[:].numpy().copy() for sim in sims)
    return warp, native


def test_a_pushed_crate_slides_as_far_as_its_own_friction_lets_it():
    """A push is a written velocity. Coulomb: the crate stops after v² / (2 mu g)."""
    sims, friction, speed = crates(), [0.2, 0.4, 0.8], 1.0
    for sim in sims:
        sim.expand_model_fields(("geom_friction",))
        sim.model.geom_friction[:, 1, 0] = torch.tensor(friction)
    run(sims, 40)
    for sim in sims:
        sim.data.qvel[:, 0] = speed
    start = both(sims, "qpos")
    run(sims, 160)
    warp, native = np.subtract(both(sims, "qpos"), start)[..., 0]
    np.testing.assert_allclose(native, warp, atol=2e-3)
    expected = [speed**2 / (2 * mu * 9.81) for mu in friction]
    np.testing.assert_allclose(native, expected, rtol=0.15)


def test_a_resting_crate_presses_with_its_randomised_weight():
    # Off its frame's centre: MuJoCo compiles the inertia of a lone body that is not.
    sims, mass = crates(CRATE.replace('type="box"', 'type="box" pos="0.001 0 0"')), [1.0, 2.0, 4.0]
    for sim in sims:
        sim.expand_model_fields(("body_mass",))
        sim.model.body_mass[:, 1] = torch.tensor(mass)
    run(sims, 160)
    warp, native = both(sims, "sensordata")
    np.testing.assert_array_equal(native[:, 0], warp[:, 0])
    force = np.linalg.norm(native[:, 1:], axis=1)
    np.testing.assert_allclose(force, 9.81 * np.array(mass), rtol=0.02)
    np.testing.assert_allclose(force, np.linalg.norm(warp[:, 1:], axis=1), rtol=0.02)


def test_inertia_that_mujoco_compiled_cannot_be_randomised():
    _, native = crates()
    native.expand_model_fields(("body_mass",))
    for _ in range(2):  # Once refused, it neither hangs nor goes on.
        with pytest.raises(RenetError, match="lone free"):
            native.step()


def test_a_lifted_crate_is_not_touching():
    sims = crates()
    run(sims, 40)
    for sim in sims:
        sim.data.qpos[1, 2] = 1.0
        sim.forward()
    for touching in both(sims, "sensordata"):
        np.testing.assert_array_equal(touching[:, 0] > 0, [True, False, True])
        assert not touching[1].any()


@pytest.mark.parametrize(
    ("field", "bad"), [("qpos", np.nan), ("qvel", np.nan), ("qvel", np.inf), ("qvel", 1e30)]
)
def test_an_exploding_neighbour_does_not_change_a_sliding_crate(field, bad):
    broken, whole = (crates()[1] for _ in range(2))
    for sim in (broken, whole):
        sim.data.qvel[:, 0] = 0.5
    getattr(broken.data, field)[1, 4] = bad
    run([broken, whole], 20)
    for name in ("qpos", "qvel", "sensordata"):
        healthy, reference = both([broken, whole], name)
        np.testing.assert_array_equal(healthy[[0, 2]], reference[[0, 2]], err_msg=name)
    # The task must see that it diverged: MuJoCo would put it back at its start by itself.
    state = torch.cat([broken.data.qpos[1], broken.data.qvel[1]])
    assert not (state.abs() < 1e10).all()
    broken.reset(torch.tensor([1]))
    broken.step()
    for name in ("qpos", "qvel"):
        assert torch.isfinite(getattr(broken.data, name)[:]).all()


def use_two_tiles(cfg: ManagerBasedRlEnvCfg) -> None:
    generator = cfg.scene.terrain.terrain_generator
    generator.num_rows, generator.num_cols = 1, 2


def test_the_stock_rough_task_runs_and_scans_the_same_heights():
    """The scan is compared in one and the same state: it must not depend on who stepped."""
    envs = make_both(ROUGH, use_two_tiles)
    for _ in range(3):
        observation, *_ = envs[1].step(torch.zeros(NUM_ENVS, 12))
    assert all(torch.isfinite(value).all() for value in observation.values())
    for name in ("qpos", "qvel"):
        getattr(envs[0].sim.data, name)[:] = getattr(envs[1].sim.data, name)[:]
    scans = []
    for env in envs:
        env.sim.forward()
        env.sim.sense()
        env.scene.update(0.0)
        scans.append(env.scene["terrain_scan"].data.distances.clone())
    assert (scans[0] >= 0).any()
    torch.testing.assert_close(scans[1], scans[0], atol=1e-4, rtol=1e-4)
