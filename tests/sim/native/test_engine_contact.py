"""The native engine in contact: randomised friction, touch, pushes, stock Rough."""

import mujoco
import numpy as np
import pytest
import torch
from mjlab.envs import ManagerBasedRlEnvCfg
from tests.sim.scenes import make, mujoco_rays, scene, simulate

from renet.errors import RenetError
from renet.sim.native.engine import NativeSimulation

CRATE = """<geom name="floor" type="plane" size="0 0 1"/>
<body name="crate" pos="0 0 0.1"><freejoint/>
  <geom name="crate" type="box" size="0.15 0.15 0.1" mass="2" priority="1"/></body>"""
TOUCH = """<sensor><contact geom1="crate" geom2="floor" data="found force" reduce="netforce"/>
</sensor>"""


def crates(crate: str = CRATE) -> NativeSimulation:
    """The same crates on floors."""
    return simulate(scene(crate, extra=TOUCH))


def run(sim: NativeSimulation, steps: int) -> None:
    for _ in range(steps):
        sim.step()
    sim.forward()


def read(sim: NativeSimulation, name: str) -> np.ndarray:
    return getattr(sim.data, name)[:].numpy().copy()


def test_a_pushed_crate_slides_as_far_as_its_own_friction_lets_it():
    """A push is a written velocity. Coulomb: the crate stops after v² / (2 mu g)."""
    sim, friction, speed = crates(), [0.2, 0.4, 0.8], 1.0
    sim.expand_model_fields(("geom_friction",))
    sim.model.geom_friction[:, 1, 0] = torch.tensor(friction)
    run(sim, 40)
    sim.data.qvel[:, 0] = speed
    start = read(sim, "qpos")
    run(sim, 160)
    distance = (read(sim, "qpos") - start)[:, 0]
    expected = [speed**2 / (2 * mu * 9.81) for mu in friction]
    np.testing.assert_allclose(distance, expected, rtol=0.15)
    for mu, slid in zip(friction, distance, strict=True):  # MuJoCo itself, in 64 bits.
        model = sim.mj_model.__copy__()
        model.geom_friction[1, 0] = mu
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, 40)
        begin, data.qvel[0] = data.qpos[0], speed
        mujoco.mj_step(model, data, 160)
        assert slid == pytest.approx(data.qpos[0] - begin, abs=1e-3)


def test_a_resting_crate_presses_with_its_randomised_weight():
    # Off its frame's centre: MuJoCo compiles the inertia of a lone body that is not.
    sim, mass = crates(CRATE.replace('type="box"', 'type="box" pos="0.001 0 0"')), [1.0, 2.0, 4.0]
    sim.expand_model_fields(("body_mass",))
    sim.model.body_mass[:, 1] = torch.tensor(mass)
    run(sim, 160)
    touch = read(sim, "sensordata")
    np.testing.assert_array_equal(touch[:, 0], 4)  # Contacts: the corners.
    force = np.linalg.norm(touch[:, 1:], axis=1)
    np.testing.assert_allclose(force, 9.81 * np.array(mass), rtol=0.02)


def test_inertia_that_mujoco_compiled_cannot_be_randomised():
    sim = crates()
    sim.expand_model_fields(("body_mass",))
    for _ in range(2):  # Once refused, it neither hangs nor goes on.
        with pytest.raises(RenetError, match="lone free"):
            sim.step()


def test_a_lifted_crate_is_not_touching():
    sim = crates()
    run(sim, 40)
    sim.data.qpos[1, 2] = 1.0
    sim.forward()
    touch = read(sim, "sensordata")
    np.testing.assert_array_equal(touch[:, 0] > 0, [True, False, True])
    assert not touch[1].any()


@pytest.mark.parametrize(
    ("field", "bad"), [("qpos", np.nan), ("qvel", np.nan), ("qvel", np.inf), ("qvel", 1e30)]
)
def test_an_exploding_neighbour_does_not_change_a_sliding_crate(field, bad):
    broken, whole = crates(), crates()
    for sim in (broken, whole):
        sim.data.qvel[:, 0] = 0.5
    getattr(broken.data, field)[1, 4] = bad
    for sim in (broken, whole):
        run(sim, 20)
    for name in ("qpos", "qvel", "sensordata"):
        healthy, reference = read(broken, name), read(whole, name)
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


def test_the_stock_rough_task_runs_and_scans_the_ground_that_mujocos_rays_find():
    """From where robots are: Warp's rays read what the native engine has written."""
    env = make("Mjlab-Velocity-Rough-Unitree-Go1", use_two_tiles, "native")
    for _ in range(3):
        observation, *_ = env.step(torch.zeros(3, 12))
    assert all(torch.isfinite(value).all() for value in observation.values())
    env.sim.forward()
    env.sim.sense()
    env.scene.update(0.0)
    scan, base = env.scene["terrain_scan"].data, env.scene["robot"].data.root_link_pos_w
    start = scan.hit_pos_w + scan.distances[..., None] * torch.tensor([0.0, 0.0, 1.0])
    torch.testing.assert_close(start.mean(1), base, atol=1e-3, rtol=0)
    env.sim.mj_model.qpos0[2] = 100.0  # The robot is out of the rays' way.
    expected = mujoco_rays(env.sim.mj_model, start.flatten(0, 1).double().numpy(), (0, 0, -1))
    differs = np.abs(scan.distances.flatten().numpy() - expected) > 1e-3
    assert differs.mean() < 0.02  # Rays that graze an edge.
