"""The native engine behind mjlab's Simulation: poses, resets, contact, the stock tasks."""

import mujoco
import numpy as np
import pytest
import torch
from mjlab.envs import ManagerBasedRlEnvCfg
from tests.sim.scenes import make, mujoco_rays, scene, simulate

from renet.errors import RenetError
from renet.sim.native import engine
from renet.sim.native.engine import NativeSimulation, use_engine

FLAT = "Mjlab-Velocity-Flat-Unitree-Go1"
FREE_BODY = """<body name="top" pos="0 0 50"><freejoint/>
  <inertial pos="0.01 0 0" mass="1" diaginertia="0.01 0.02 0.03"/>
  <body pos="0.1 0 0"><joint name="hinge" axis="0 1 0"/>
    <site name="s"/><geom type="capsule" size="0.02 0.1" contype="0" conaffinity="0"/></body>
</body>"""
MOTOR = """<actuator><motor joint="hinge" ctrlrange="-1 1"/></actuator>
<sensor><gyro site="s"/><jointpos joint="hinge"/></sensor>"""
CRATE = """<geom name="floor" type="plane" size="0 0 1"/>
<body name="crate" pos="0 0 0.1"><freejoint/>
  <geom name="crate" type="box" size="0.15 0.15 0.1" mass="2" priority="1"/></body>"""
TOUCH = """<sensor><contact geom1="crate" geom2="floor" data="found force" reduce="netforce"/>
</sensor>"""


def spun(substeps: int, *expanded: str) -> NativeSimulation:
    """Free bodies after some substeps, with fields of the model of their own."""
    sim = simulate(scene(FREE_BODY, extra=MOTOR))
    sim.expand_model_fields(expanded)
    sim.data.qvel[:] = torch.linspace(-0.5, 0.5, 7).repeat(3, 1)
    sim.data.ctrl[:] = torch.tensor([[0.02], [-0.01], [0.0]])
    sim.step_n(substeps)
    return sim


def read(sim: NativeSimulation, *names: str) -> dict[str, torch.Tensor]:
    return {name: getattr(sim.data, name)[:].clone() for name in names}


def test_control_step_ends_with_new_poses():
    sim = spun(4)
    derived = read(sim, "xpos", "xquat", "xmat", "site_xpos", "cvel", "subtree_com", "sensordata")
    sim.forward()
    torch.testing.assert_close(read(sim, *derived), derived)


def test_only_what_was_written_is_derived_anew():
    sim = spun(4)
    sim.data.xpos[:] = 7.0
    sim.forward_written()
    assert (sim.data.xpos[:] == 7.0).all()
    sim.data.qpos[1, 2] = 3.0
    sim.data.qvel[2, 0] = 5.0
    sim.forward_written()
    assert (sim.data.xpos[0] == 7.0).all()
    assert sim.data.xpos[1, 1, 2] == 3.0
    assert sim.data.cvel[2, 1, 3] == pytest.approx(5.0, abs=0.1)
    sim.forward()
    assert (sim.data.xpos[0, 1:] != 7.0).all()


@pytest.mark.parametrize("lost", ["a physics step", "other fields"])
def test_poses_are_derived_anew_after(lost):
    sim = spun(4)
    sim.step() if lost == "a physics step" else sim.expand_model_fields(("body_pos",))
    sim.data.xpos[:] = 7.0
    sim.forward_written()
    assert (sim.data.xpos[:, 1] != 7.0).any(-1).all()


def test_bodies_moved_by_hand_count_as_written():
    sim = simulate(scene('<body mocap="true"><geom size=".1"/></body>'))
    sim.step_n(4)
    sim.data.mocap_pos[1, 0] = torch.tensor([1.0, 2.0, 3.0])
    sim.forward_written()
    assert sim.data.xpos[:, 1].tolist() == [[0, 0, 0], [1, 2, 3], [0, 0, 0]]


def test_randomised_colours_are_left_to_viewers():
    assert torch.equal(spun(1).data.qpos[:], spun(1, "geom_rgba").data.qpos[:])


def test_reset_touches_only_its_environments():
    new, sim = simulate(scene(FREE_BODY, extra=MOTOR)), spun(10)
    before = read(sim, "qpos", "qvel", "ctrl", "time", "sensordata")
    sim.reset(torch.tensor([1]))
    for name, now in read(sim, *before).items():
        assert torch.equal(now[1], getattr(new.data, name)[1]), name
        assert torch.equal(now[[0, 2]], before[name][[0, 2]]), name


def stand_on_flat_ground(cfg: ManagerBasedRlEnvCfg) -> None:
    cfg.terminations, cfg.curriculum = {}, {}
    cfg.observations["actor"].enable_corruption = False
    del cfg.events["push_robot"]


def test_stock_go1_matches_on_both_engines():
    """50 control steps of small actions under randomised friction and centre of mass.

    Contact makes trajectories diverge from rounding: single against double precision, and solvers
    that stop at the same tolerance but not at the same iterate. The robots stand and sway, so
    5 mm and 0.03 rad bound the difference; contact forces agree on the robot's weight.
    """
    envs = [make(FLAT, stand_on_flat_ground, engine) for engine in ("warp", "native")]
    for part, names in (("data", ("qpos", "qvel")), ("model", ("geom_friction", "body_ipos"))):
        for name in names:
            warp, native = (getattr(getattr(env.sim, part), name) for env in envs)
            native[:] = warp[:]
    for env in envs:
        env.sim.forward()
    actions = torch.Generator().manual_seed(0)
    for _ in range(50):
        action = 0.1 * torch.randn(3, 12, generator=actions)
        for env in envs:
            env.step(action)
    warp, native = (env.scene["robot"].data for env in envs)
    assert (warp.root_link_pos_w - native.root_link_pos_w).abs().max() < 5e-3
    assert (warp.joint_pos - native.joint_pos).abs().max() < 3e-2
    force = [env.scene["feet_ground_contact"].data.force[..., 2].abs().sum(1) for env in envs]
    weight = envs[0].sim.mj_model.body_mass.sum() * 9.81
    for value in force:
        assert (value - weight).abs().max() < 0.35 * weight
    warp, native = (env.scene["feet_ground_contact"].data.found > 0 for env in envs)
    assert (warp == native).float().mean() > 0.7


def test_unknown_or_impossible_engine_is_refused():
    with pytest.raises(RenetError, match="auto, native, warp"), use_engine("fast", "cpu"):
        pass
    with pytest.raises(RenetError, match="runs on the CPU"), use_engine("native", "cuda:0"):
        pass


FRAMES = """<body name="moved" pos="0 0 1"><freejoint/>
  <inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.02 0.03"/>
  <geom name="turned" type="box" size=".1 .2 .3" pos="0.2 0 0" euler="0 0 30"/>
  <geom name="shifted" type="box" size=".1 .2 .3" pos="0.2 0 0"/>
  <geom name="inertial" type="box" size=".1 .2 .3" pos="0.1 0 0"/>
  <geom name="same" type="box" size=".1 .2 .3"/>
</body>"""


@pytest.mark.parametrize(
    ("field", "value"),
    [("", 0), ("body_ipos", (0, 0.3, 0)), ("geom_quat", (0.6, 0, 0.8, 0)), ("geom_pos", (0, 0, 1))],
)
def test_frames_that_randomisation_parts_are_computed(field, value):
    """A compiled model with fields written afterwards moves as one compiled with them."""
    model = scene(FRAMES)
    compiled = model.geom_sameframe.copy()
    assert np.count_nonzero(compiled) >= 2
    engine.clear_frame_flags(model, {field})
    if field:
        getattr(model, field)[:] = value
    else:
        assert (model.geom_sameframe == compiled).all()
    data = mujoco.MjData(model)
    data.qpos[3:7] = 0.5, 0.5, -0.5, 0.5
    mujoco.mj_kinematics(model, data)
    base = data.xmat[1].reshape(3, 3)
    for geom in range(model.ngeom):
        turn, at = np.zeros(9), data.xpos[1] + base @ model.geom_pos[geom]
        mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
        expected = (base @ turn.reshape(3, 3)).ravel()
        np.testing.assert_allclose(data.geom_xmat[geom], expected, atol=1e-12)
        np.testing.assert_allclose(data.geom_xpos[geom], at, atol=1e-12)
    np.testing.assert_allclose(data.xipos[1], data.xpos[1] + base @ model.body_ipos[1], atol=1e-12)


def crates(crate: str = CRATE) -> NativeSimulation:
    """The same crates on floors."""
    return simulate(scene(crate, extra=TOUCH))


def run(sim: NativeSimulation, steps: int) -> None:
    for _ in range(steps):
        sim.step()
    sim.forward()


def test_crate_slides_by_its_own_friction():
    """A push is a written velocity. Coulomb: the crate stops after v² / (2 mu g)."""
    sim, friction, speed = crates(), [0.2, 0.4, 0.8], 1.0
    sim.expand_model_fields(("geom_friction",))
    sim.model.geom_friction[:, 1, 0] = torch.tensor(friction)
    run(sim, 40)
    sim.data.qvel[:, 0] = speed
    start = sim.data.qpos[:, 0].clone()
    run(sim, 160)
    distance = sim.data.qpos[:, 0] - start
    expected = [speed**2 / (2 * mu * 9.81) for mu in friction]
    np.testing.assert_allclose(distance, expected, rtol=0.15)
    for mu, slid in zip(friction, distance.tolist(), strict=True):  # MuJoCo itself, in 64 bits.
        model = sim.mj_model.__copy__()
        model.geom_friction[1, 0] = mu
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, 40)
        begin, data.qvel[0] = data.qpos[0], speed
        mujoco.mj_step(model, data, 160)
        assert slid == pytest.approx(data.qpos[0] - begin, abs=1e-3)


def test_crate_presses_with_randomised_weight():
    # Off its frame's centre: MuJoCo compiles the inertia of a lone body that is not.
    sim, mass = crates(CRATE.replace('type="box"', 'type="box" pos="0.001 0 0"')), [1.0, 2.0, 4.0]
    sim.expand_model_fields(("body_mass",))
    sim.model.body_mass[:, 1] = torch.tensor(mass)
    run(sim, 160)
    touch = sim.data.sensordata[:]
    assert (touch[:, 0] == 4).all(), "contacts: the corners"
    np.testing.assert_allclose(touch[:, 1:].norm(dim=1), 9.81 * np.array(mass), rtol=0.02)


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
    touch = sim.data.sensordata[:]
    assert (touch[:, 0] > 0).tolist() == [True, False, True]
    assert not touch[1].any()


@pytest.mark.parametrize(
    ("field", "bad"), [("qpos", np.nan), ("qvel", np.nan), ("qvel", np.inf), ("qvel", 1e30)]
)
def test_exploding_neighbour_changes_nothing(field, bad):
    broken, whole = crates(), crates()
    for sim in (broken, whole):
        sim.data.qvel[:, 0] = 0.5
    getattr(broken.data, field)[1, 4] = bad
    for sim in (broken, whole):
        run(sim, 20)
    names = ("qpos", "qvel", "sensordata")
    for name, reference in read(whole, *names).items():
        assert torch.equal(getattr(broken.data, name)[[0, 2]], reference[[0, 2]]), name
    # The task must see that it diverged: MuJoCo would put it back at its start by itself.
    state = torch.cat([broken.data.qpos[1], broken.data.qvel[1]])
    assert not (state.abs() < 1e10).all()
    broken.reset(torch.tensor([1]))
    broken.step()
    assert all(value.isfinite().all() for value in read(broken, *names).values())


def use_two_tiles(cfg: ManagerBasedRlEnvCfg) -> None:
    generator = cfg.scene.terrain.terrain_generator
    generator.num_rows, generator.num_cols = 1, 2


def test_rough_task_scans_mujocos_ground():
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
