"""The environment's contract: observations, costs, resets, checkpoints, errors."""

import sys
from copy import deepcopy
from dataclasses import replace

import pytest
import torch
from mjlab.envs import ManagerBasedRlEnv
from mjlab.managers.metrics_manager import MetricsTermCfg

from renet.errors import RenetError
from renet.interface import JOINTS, PROPRIOCEPTION, STEPS_PER_TICK, proprioception_slices
from renet.sim.native.stages import moving_part
from renet.tasks import env_cfg, make_env, mdp
from renet.tasks.parkour_env_cfg import NOISE, flat_env_cfg

from ..waits import Waits


def test_observation_groups(parkour):
    obs, _ = parkour.reset()
    shapes = {name: tuple(value.shape[1:]) for name, value in obs.items()}
    privileged = shapes.pop("privileged")
    assert shapes.pop("depth") == (48, 64)
    sizes = {"velocity": 3, "feet_height": 4, "height_map": 132, "far_map": 30}
    sizes |= {"difficult": 1, "easier": 1}
    assert not obs["easier"].any()
    sizes |= {"proprioception": 45, "proprioception_clean": 45}
    assert shapes == {name: (size,) for name, size in sizes.items()}
    assert privileged[0] == 4 + 1 + 12 + 1 + 3 + 1 + 24
    assert obs["depth"].dtype == torch.float16
    kinds = list(parkour.scene.terrain.cfg.terrain_generator.sub_terrains)
    hard = [kinds[k] in ("gap", "platform") for k in parkour.scene.terrain.terrain_types]
    assert obs["difficult"].flatten().bool().tolist() == hard


def test_action_order_is_joint_order(flat):
    assert tuple(flat.action_manager.get_term("joint_pos").target_names) == JOINTS
    assert tuple(flat.scene["robot"].joint_names) == JOINTS


def test_depth_changes_at_the_global_tick_only(flat):
    held = flat.obs_buf["depth"].clone()
    for step in range(1, 2 * STEPS_PER_TICK + 1):
        obs, *_ = flat.step(torch.zeros(4, 12))
        same = torch.equal(obs["depth"], held)
        assert same == (step % STEPS_PER_TICK != 0)
        held = obs["depth"].clone()


def test_control_step_waits_as_mjlab(build):
    parkour = build("Renet-Go1-Parkour", 12)
    parkour.step(torch.zeros(12, 12))  # At first use Warp's arrays are wrapped.
    with Waits() as watch:
        for _ in range(STEPS_PER_TICK):
            parkour.step(torch.zeros(12, 12))
        parkour._reset_idx(torch.arange(3))
        parkour.step(torch.zeros(12, 12))
    # The rasterizer draws on a CPU alone; a GPU casts rays.
    assert set(watch.files) - {"rasterizer.py"} == {"mjlab"}


def test_costs_follow_interface_order(build):
    cfg = flat_env_cfg()
    cfg.metrics = dict(reversed(cfg.metrics.items()))
    env = build(cfg, 4)
    env.step(torch.full((4, 12), 4.8))
    costs = mdp.constraint_costs(env)
    assert costs.shape == (4, 3)
    # 1.2 rad of error at Kp 40 asks for 48 N m, far beyond 0.8 of any motor's limit.
    assert (costs[:, 2] > costs[:, :2].amax(-1)).all()
    env.step(torch.zeros(4, 12))
    assert mdp.constraint_costs(env).isfinite().all()
    del cfg.metrics["cost_torque"]
    with pytest.raises(RenetError, match="lacks the metrics cost_torque"):
        mdp.constraint_costs(make_env(cfg, 1))


def test_only_failed_robots_are_reset(flat):
    flat.step(torch.zeros(4, 12))
    flat.sim.data.qpos[1, 3:7] = torch.tensor([0.0, 1.0, 0.0, 0.0])
    flat.sim.data.qpos[2, 7] = flat.sim.data.qvel[3, 1] = torch.nan
    obs, reward, terminated, truncated, _ = flat.step(torch.zeros(4, 12))
    assert terminated.tolist() == [False, True, True, True]
    assert not truncated.any()
    for value in (*obs.values(), reward, mdp.constraint_costs(flat)):
        assert value.isfinite().all()
    assert flat.episode_length_buf.tolist() == [2, 0, 0, 0]


def test_critics_observe_randomisation(flat):
    trunk = flat.scene["robot"].indexing.body_ids[:1]
    obs, _ = flat.reset()
    drawn = flat.sim.model.body_mass[:, trunk] - flat.sim.get_default_field("body_mass")[trunk]
    assert drawn.unique().numel() > 1
    torch.testing.assert_close(obs["privileged"][:, 17:18], drawn)
    flat.sim.model.body_mass[:, trunk] += 1.0
    obs, _ = flat.reset()
    flat.sim.model.body_mass[:, trunk] -= 1.0
    torch.testing.assert_close(obs["privileged"][:, 17:18], drawn + 1.0)


def test_curriculum_state_survives_another_size(parkour):
    terrain = parkour.scene.terrain
    term = parkour.curriculum_manager.get_term_cfg("level").func
    levels = torch.arange(12) % 10
    term.levels[:], term.passed[:], parkour.common_step_counter = levels, levels < 5, 77
    terrain.terrain_levels[:] = 0  # All are on an easier tile.
    state = {name: value.clone() for name, value in mdp.curriculum_state(parkour).items()}
    term.levels[:], term.passed[:], parkour.common_step_counter = 0, False, 0
    mdp.load_curriculum_state(parkour, state, 0)
    assert torch.equal(term.levels, levels)
    assert torch.equal(terrain.terrain_levels, levels)
    assert torch.equal(term.passed, levels < 5)
    assert parkour.common_step_counter == 77
    parkour.reset()
    assert torch.equal(terrain.terrain_levels, levels), "also in the next reset"
    origins = terrain.terrain_origins[levels, terrain.terrain_types]
    assert torch.equal(terrain.env_origins, origins)
    offset = parkour.scene["robot"].data.root_link_pos_w - origins
    assert offset[:, :2].abs().max() < 0.31
    smaller = make_env("Renet-Go1-Parkour-Paper", 6)
    mdp.load_curriculum_state(smaller, state, 0)
    kinds, levels = smaller.scene.terrain.terrain_types, smaller.scene.terrain.terrain_levels
    for kind, level in zip(kinds, levels, strict=True):
        assert level in state["levels"][state["kinds"] == kind]
    passed = smaller.curriculum_manager.get_term_cfg("level").func.passed
    assert torch.equal(passed, levels < 5), "level and mark stay together"
    before, few = levels.clone(), {name: state[name][:1] for name in ("kinds", "passed", "levels")}
    few["levels"] += 3
    mdp.load_curriculum_state(smaller, state | few, 0)
    expected = torch.where(kinds == state["kinds"][0], few["levels"], before)
    assert torch.equal(levels, expected), "others keep theirs"


def test_a_configuration_can_be_used_twice():
    cfg = env_cfg("Renet-Go1-Flat", play=True)
    steps = [make_env(cfg, n).step_dt for n in (1, 2)]
    assert steps == [pytest.approx(0.02)] * 2
    assert (cfg.decimation, cfg.scene.num_envs) == (4, 1)


def test_fused_substeps_are_the_same_physics():
    fused, watched = (env_cfg("Renet-Go1-Flat", play=True) for _ in range(2))
    height = MetricsTermCfg(func=lambda env: env.sim.data.qpos[:, 2], per_substep=True)
    watched.metrics["watch"] = height
    envs = [make_env(cfg, 2, seed=3) for cfg in (fused, watched)]
    assert [env.cfg.decimation for env in envs] == [1, 4]
    for env in envs:
        env.reset(seed=4)
        for k in range(25):
            env.step(torch.full((2, 12), 0.3 * (-1) ** k))
    assert mdp.feet_contact(envs[0]).any()
    # Between substeps the state is stored in 32 bits; contact magnifies the rounding.
    for name, tolerance in (("qpos", 1e-4), ("qvel", 1e-2)):
        first, second = (getattr(env.sim.data, name)[:] for env in envs)
        torch.testing.assert_close(first, second, atol=tolerance, rtol=0)


def test_play_shows_every_level(build):
    env = build(env_cfg("Renet-Go1-Parkour", play=True), 200)
    assert set(env.scene.terrain.terrain_levels.tolist()) == set(range(10))


def test_observations_are_copies(parkour):
    seen = parkour.step(torch.zeros(12, 12))[0]
    kept = {name: value.clone() for name, value in seen.items()}
    for _ in range(STEPS_PER_TICK):
        parkour.step(torch.ones(12, 12))
    assert all(torch.equal(seen[name], kept[name]) for name in seen)


def test_noise_is_bounded_and_scaled(parkour):
    most = torch.zeros(45)
    for term in PROPRIOCEPTION:
        most[proprioception_slices()[term.name]] = term.scale * NOISE.get(term.name, 0.0)
    seen = []
    for _ in range(20):
        now = parkour.step(torch.zeros(12, 12))[0]
        seen.append(now["proprioception"] - now["proprioception_clean"])
    error = torch.cat(seen)
    assert (error.abs() <= most + 1e-6).all()
    for side in (error, -error):
        assert (side[:, most > 0.0].amax(0) > 0.8 * most[most > 0.0]).all()


def test_task_without_rewards_runs(build):
    cfg = flat_env_cfg()
    cfg.rewards, cfg.terminations, cfg.metrics = {}, {}, {}
    _, reward, terminated, truncated, _ = build(cfg, 2).step(torch.zeros(2, 12))
    assert not reward.any()
    assert not (terminated | truncated).any()


def test_mjlab_environment_runs_our_task():
    cfg = env_cfg("Renet-Go1-Flat", play=True)
    cfg.scene.num_envs, cfg.seed = 3, 4
    rollouts = []
    for env in (ManagerBasedRlEnv(deepcopy(cfg), "cpu"), make_env(cfg, 3, seed=4, engine="warp")):
        env.reset(seed=5)
        rewards = []
        for _ in range(8):
            observations, reward, *_ = env.step(torch.full((3, 12), 4.0))
            rewards.append(reward.clone())
        results = {"costs": mdp.constraint_costs(env), "rewards": torch.stack(rewards)}
        rollouts.append(results | observations)
        env.close()
    torch.testing.assert_close(*rollouts)
    assert (rollouts[0]["costs"] > 0.0).any()


@pytest.mark.parametrize("weight", [float("nan"), float("inf")])
def test_nan_weight_is_refused(weight):
    cfg = env_cfg("Renet-Go1-Flat")
    cfg.rewards["yaw"].weight = weight
    with pytest.raises(RenetError, match="weight of the reward yaw is"):
        make_env(cfg, 1)


@pytest.mark.parametrize("seconds", [-1.0, 0.0, float("nan")])
def test_an_episode_without_length_is_refused(seconds):
    with pytest.raises(RenetError, match="episode_length_s must be above 0"):
        replace(flat_env_cfg(), episode_length_s=seconds)


@pytest.mark.parametrize("seed", [-2, 2**32])
def test_a_seed_that_no_generator_takes_is_refused(seed):
    with pytest.raises(RenetError, match=r"seed must be from 0 to 2\^32 - 1, got"):
        make_env("Renet-Go1-Flat", 1, seed=seed)


def test_an_environment_without_robots_is_refused():
    with pytest.raises(RenetError, match="at least 1"):
        make_env("Renet-Go1-Flat", 0)


def test_stages_skip_terrain(parkour):
    model = parkour.sim.mj_model
    bodies, geoms = moving_part(model)
    assert bodies == model.body("robot/trunk").id + 13
    assert geoms < 0.1 * model.ngeom


def test_source_tree_registers_tasks(monkeypatch):
    monkeypatch.setattr("mjlab.tasks.registry._REGISTRY", {})
    monkeypatch.delitem(sys.modules, "renet.registry")  # Nobody's entry point names it.
    assert env_cfg("Renet-Go1-Flat").scene.num_envs
