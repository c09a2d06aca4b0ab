"""The environment's contract: observations, costs, resets, checkpoints, errors."""

from __future__ import annotations

import pytest
import torch
from mjlab.managers.metrics_manager import MetricsTermCfg
from torch.utils._python_dispatch import TorchDispatchMode

from renet.errors import RenetError
from renet.interface import (
    JOINTS,
    PROPRIOCEPTION_SIZE,
    STEPS_PER_TICK,
    proprioception_slices,
)
from renet.sim.native.stages import moving_part
from renet.tasks import env_cfg, make_env, observations

from .conftest import build


def test_observation_groups(parkour):
    obs, _ = parkour.reset()
    shapes = {name: tuple(value.shape[1:]) for name, value in obs.items()}
    privileged = shapes.pop("privileged")
    assert shapes == {
        "proprioception": (PROPRIOCEPTION_SIZE,),
        "proprioception_clean": (PROPRIOCEPTION_SIZE,),
        "velocity": (3,),
        "feet_height": (4,),
        "height_map": (132,),
        "depth": (48, 64),
        "difficult": (1,),
    }
    assert privileged[0] == 4 + 1 + 3 + 1 + 24
    assert obs["depth"].dtype == torch.float16
    kinds = list(parkour.scene.terrain.cfg.terrain_generator.sub_terrains)
    hard = [kinds[k] in ("gap", "platform") for k in parkour.scene.terrain.terrain_types]
    assert obs["difficult"].flatten().bool().tolist() == hard


def test_proprioception_follows_the_vocabulary(flat):
    obs, *_ = flat.step(torch.full((4, 12), 0.1))
    where = proprioception_slices()
    clean, data = obs["proprioception_clean"], flat.scene["robot"].data
    ids, _ = flat.scene["robot"].find_joints(JOINTS, preserve_order=True)
    expected = {
        "base_angular_velocity": 0.25 * data.root_link_ang_vel_b,
        "projected_gravity": data.projected_gravity_b,
        "joint_position": (data.joint_pos - data.default_joint_pos)[:, ids],
        "joint_velocity": 0.05 * data.joint_vel[:, ids],
        "last_action": torch.full((4, 12), 0.1),
    }
    for name, value in expected.items():
        torch.testing.assert_close(clean[:, where[name]], value, atol=1e-5, rtol=1e-4, msg=name)
    noise = (obs["proprioception"] - clean).abs().amax(0)
    assert noise[where["base_angular_velocity"]].max() <= 0.25 * 0.2 + 1e-5
    assert noise[where["joint_velocity"]].max() <= 0.05 * 1.5 + 1e-5
    for name in ("command", "last_action"):
        assert noise[where[name]].max() < 1e-6


def test_action_order_is_joint_order(flat):
    assert tuple(flat.action_manager.get_term("joint_pos").target_names) == JOINTS
    assert tuple(flat.scene["robot"].joint_names) == JOINTS


def test_depth_changes_at_the_global_tick_only(flat):
    flat.reset()
    held = flat.obs_buf["depth"].clone()
    for step in range(1, 2 * STEPS_PER_TICK + 1):
        obs, *_ = flat.step(torch.zeros(4, 12))
        same = torch.equal(obs["depth"], held)
        assert same == (step % STEPS_PER_TICK != 0)
        held = obs["depth"].clone()


class Waits(TorchDispatchMode):
    """Notes what makes a GPU's host wait: results that it needs, and copies of its own data."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        name = func.overloadpacket.__name__
        masks = args[1] if name in ("index", "index_put_") else ()
        by_mask = any(m is not None and m.dtype == torch.bool for m in masks)
        of_list = name == "lift_fresh" and args[0].ndim > 0
        if by_mask or of_list or name in ("_local_scalar_dense", "nonzero", "equal"):
            self.found.append(name)
        return func(*args, **(kwargs or {}))


def test_a_control_step_waits_for_a_gpu_only_where_mjlab_does(parkour):
    parkour.reset()
    parkour.step(torch.zeros(12, 12))  # At first use Warp's arrays are wrapped.
    with Waits() as watch:
        for _ in range(STEPS_PER_TICK):
            parkour.step(torch.zeros(12, 12))
        # Whom to reset.
        assert watch.found == STEPS_PER_TICK * ["nonzero"]
        parkour._reset_idx(torch.arange(3))
        assert watch.found == STEPS_PER_TICK * ["nonzero"], "a reset waits for nothing"
        torch.ones(2)[[0]]
    assert watch.found[-1] == "lift_fresh"


def test_reward_is_clipped_and_costs_come_along(flat):
    flat.reset()
    _, reward, *_, extras = flat.step(torch.full((4, 12), 4.8))
    assert (reward >= 0.0).all()
    assert extras["costs"].shape == (4, 3)
    # 1.2 rad of error at Kp 40 asks for 48 N m, far beyond 0.8 of any motor's limit.
    assert (extras["costs"][:, 2] > 0.0).all()
    _, _, *_, extras = flat.step(torch.zeros(4, 12))
    assert torch.isfinite(extras["costs"]).all()


def test_a_robot_that_is_not_finite_is_reset_alone(flat):
    flat.reset()
    flat.step(torch.zeros(4, 12))
    flat.sim.data.qpos[2, 7] = float("nan")
    obs, reward, terminated, _, _ = flat.step(torch.zeros(4, 12))
    assert terminated.tolist() == [False, False, True, False]
    assert all(torch.isfinite(value).all() for value in obs.values())
    assert torch.isfinite(reward).all()
    assert flat.episode_length_buf.tolist() == [2, 2, 0, 2]


def test_critics_see_what_randomisation_drew_and_draws_again(flat):
    trunk = flat.scene["robot"].indexing.body_ids[:1]

    def payload() -> torch.Tensor:
        return flat.sim.model.body_mass[:, trunk] - flat.sim.get_default_field("body_mass")[trunk]

    obs, _ = flat.reset()
    drawn = payload().clone()
    assert drawn.unique().numel() > 1
    torch.testing.assert_close(obs["privileged"][:, 4:5], drawn)
    flat.sim.model.body_mass[:, trunk] += 1.0
    obs, _ = flat.reset()
    flat.sim.model.body_mass[:, trunk] -= 1.0
    torch.testing.assert_close(obs["privileged"][:, 4:5], drawn + 1.0)


def test_fallen_robot_terminates(flat):
    flat.reset()
    flat.sim.data.qpos[1, 3:7] = torch.tensor([0.0, 1.0, 0.0, 0.0])
    _, _, terminated, truncated, _ = flat.step(torch.zeros(4, 12))
    assert terminated.tolist() == [False, True, False, False]
    assert not truncated.any()


def test_same_seed_same_rollout():
    results = []
    for _ in range(2):
        env = build("Renet-Go1-Flat", 2, seed=5)
        obs, _ = env.reset()
        for _ in range(6):
            obs, reward, *_ = env.step(torch.full((2, 12), 0.2))
        results.append((obs["proprioception"], obs["depth"], reward))
    for first, second in zip(*results, strict=True):
        assert torch.equal(first, second)


def test_curriculum_state_round_trips_and_survives_another_size(parkour):
    terrain = parkour.scene.terrain
    terrain.terrain_levels[:] = torch.arange(12) % 10
    parkour.common_step_counter = 77
    state = {name: value.clone() for name, value in parkour.curriculum_state().items()}
    terrain.terrain_levels[:] = 0
    parkour.common_step_counter = 0
    parkour.load_curriculum_state(state)
    assert torch.equal(terrain.terrain_levels, torch.arange(12) % 10)
    assert parkour.common_step_counter == 77
    origins = terrain.terrain_origins[terrain.terrain_levels, terrain.terrain_types]
    assert torch.equal(terrain.env_origins, origins)
    smaller = build("Renet-Go1-Parkour", 6)
    smaller.load_curriculum_state(state)
    for kind, level in zip(
        smaller.scene.terrain.terrain_types, smaller.scene.terrain.terrain_levels, strict=True
    ):
        assert level in state["levels"][state["kinds"] == kind]


def test_resuming_keeps_levels_through_the_reset_that_follows():
    first, second = (build("Renet-Go1-Parkour", 12, seed=s) for s in (1, 2))
    for env in (first, second):
        env.reset()
    first.scene.terrain.terrain_levels[:] = torch.tensor([0, 3, 6, 9]).repeat(3)
    first.common_step_counter = 5000
    second.load_curriculum_state(first.curriculum_state())
    second.reset()
    assert second.scene.terrain.terrain_levels.tolist() == [0, 3, 6, 9] * 3
    offset = second.scene["robot"].data.root_link_pos_w - second.scene.env_origins
    assert offset[:, :2].abs().max() < 0.31


def test_a_configuration_can_be_used_twice():
    cfg = env_cfg("Renet-Go1-Flat", play=True)
    steps = [build(cfg, n).step_dt for n in (1, 2)]
    assert steps == [pytest.approx(0.02)] * 2
    assert (cfg.decimation, cfg.scene.num_envs) == (4, 1)


def test_fused_substeps_are_the_same_physics():
    fused, watched = (env_cfg("Renet-Go1-Flat", play=True) for _ in range(2))
    watched.metrics["watch"] = MetricsTermCfg(
        func=lambda env: env.sim.data.qpos[:, 2], per_substep=True
    )
    envs = [build(cfg, 2, seed=3) for cfg in (fused, watched)]
    assert [env.cfg.decimation for env in envs] == [1, 4]
    for env in envs:
        env.reset(seed=4)
        for k in range(25):
            env.step(torch.full((2, 12), 0.3 * (-1) ** k))
    assert observations.feet_contact(envs[0]).any()
    # Between substeps the state is stored in 32 bits; contact magnifies the rounding.
    for name, tolerance in (("qpos", 1e-4), ("qvel", 1e-2)):
        first, second = (getattr(env.sim.data, name)[:] for env in envs)
        torch.testing.assert_close(first, second, atol=tolerance, rtol=0)


def test_leaving_the_tile_is_a_time_out_and_a_gap_is_not(parkour):
    kinds = list(parkour.scene.terrain.cfg.terrain_generator.sub_terrains)
    gap = int((parkour.scene.terrain.terrain_types == kinds.index("gap")).nonzero()[0])
    parkour.reset()
    parkour.sim.data.qpos[0, 1] += 4.5
    parkour.sim.data.qpos[gap, :3] = parkour.scene.env_origins[gap] + torch.tensor([1.25, 0, -0.4])
    _, _, terminated, truncated, extras = parkour.step(torch.zeros(12, 12))
    assert (terminated[0], truncated[0]) == (False, True)
    assert (terminated[gap], truncated[gap]) == (True, False)
    assert extras["log"]["Episode_Termination/left_tile"] == 1
    assert extras["log"]["Episode_Termination/in_gap"] == 1


def test_play_shows_every_level():
    env = build("Renet-Go1-Parkour", 200, play=True)
    env.reset()
    assert set(env.scene.terrain.terrain_levels.tolist()) == set(range(10))


def test_errors_name_what_is_wrong():
    with pytest.raises(RenetError, match="Renet-Go1-Flat, Renet-Go1-Parkour"):
        make_env("Renet-Go1-Moon", 1)
    with pytest.raises(RenetError, match="at least 1"):
        make_env("Renet-Go1-Flat", 0)
    with pytest.raises(RenetError, match="not a RENet task"):
        make_env("Mjlab-Velocity-Flat-Unitree-Go1", 1)


def test_stages_of_a_step_are_spared_the_terrain(parkour):
    model = parkour.sim.mj_model
    bodies, geoms = moving_part(model)
    assert bodies == model.body("robot/trunk").id + 13
    assert geoms < 0.1 * model.ngeom
