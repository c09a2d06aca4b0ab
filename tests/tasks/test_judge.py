"""Terms in Warp against the same formulas in torch, on states that no physics led to."""

from __future__ import annotations

import math

import pytest
import torch
from mjlab.managers.observation_manager import ObservationManager
from mjlab.managers.reward_manager import RewardTermCfg
from mjlab.managers.termination_manager import TerminationTermCfg

from renet.interface import JOINTS, LEGS, PROPRIOCEPTION, proprioception_slices
from renet.tasks import env_cfg, observations, rewards
from renet.tasks.config import NOISE
from renet.tasks.constraints import VIOLATED
from renet.tasks.step import Step, offset
from renet.tasks.terminations import left_tile
from renet.tasks.terms import per_robot

from .conftest import build


def scatter(env, generator: torch.Generator) -> None:
    """Put robots anywhere, in any motion, touching anything, under any command."""

    def draw(*shape: int) -> torch.Tensor:
        return torch.randn(shape, generator=generator)

    count, data, goal = env.num_envs, env.sim.data, env.command_manager.get_term("goal")
    data.qpos[:] = data.qpos[:] + 0.4 * draw(*data.qpos.shape)
    data.qpos[:, 2] += 1.0
    data.qpos[:, 3:7] = torch.nn.functional.normalize(data.qpos[:, 3:7], dim=-1)
    data.qvel[:] = 12.0 * draw(*data.qvel.shape)
    env.sim.forward()
    env.scene.update(0.02)
    data.sensordata[:] = draw(*data.sensordata.shape).clamp_min(0.0).floor()
    data.qfrc_actuator[:] = draw(*data.qfrc_actuator.shape)
    env.action_manager.process_action(draw(count, 12))
    env.scene["robot"].set_joint_position_target(draw(count, 12))
    goal.speed[:] = draw(count).clamp(0.0, 1.0)
    goal.yaw[:] = draw(count).clamp(-math.pi, math.pi)


class Reference:
    """The formulas, for an environment whose robots are all observed from their first step."""

    def __init__(self, env) -> None:
        self.env, self.robot = env, env.scene["robot"]
        self.goal = env.command_manager.get_term("goal")
        count = env.num_envs
        self.velocity_before, self.smooth = torch.zeros(count, 12), torch.zeros(count, 12)
        self.feet_before = torch.full((count, 4, 3), torch.nan)

    def rewards(self) -> dict[str, torch.Tensor]:
        data, goal, actions = self.robot.data, self.goal, self.env.action_manager
        velocity, offset = data.root_link_lin_vel_w[:, :2], data.joint_pos - data.default_joint_pos
        along = (velocity * goal.direction).sum(-1)
        moving = torch.minimum(along, goal.speed) / (goal.speed + 1e-5)
        standing = 1.0 / (1.0 + velocity.norm(dim=-1))
        hips = [name.endswith("hip_joint") for name in self.robot.joint_names]
        acceleration = (data.joint_vel - self.velocity_before) / 0.02
        self.velocity_before = data.joint_vel
        self.smooth = self.smooth.lerp(data.joint_vel, 0.02 / 0.2)
        return {
            "linear_velocity": torch.where(goal.speed > 0, moving, standing),
            "yaw": (-goal.heading_error.abs()).exp(),
            "collision": self._collisions(),
            "joint_energy": (data.qfrc_actuator * data.joint_vel).abs().sum(-1),
            "action_rate": (actions.action - actions.prev_action).norm(dim=-1),
            "default_position": offset.square().sum(-1),
            "hip_position": offset[:, hips].square().sum(-1),
            "joint_acceleration": acceleration.square().sum(-1),
            "orientation": data.projected_gravity_b[:, :2].square().sum(-1),
            "standing_motion": torch.where(goal.speed > 0, 0.0, self.smooth.square().sum(-1)),
            "foot_clearance": self._clearance(),
        }

    def _collisions(self) -> torch.Tensor:
        scene = self.env.scene
        bodies = scene["thigh_trunk_contact"].data.force.norm(dim=-1) > 0.1
        calves = scene["calf_contact"].data.force.norm(dim=-1).unflatten(-1, (4, -1)) > 0.1
        return (bodies.sum(-1) + calves.any(-1).sum(-1)).float()

    def _clearance(self) -> torch.Tensor:
        sites, _ = self.robot.find_sites(LEGS, preserve_order=True)
        feet = self.robot.data.site_pos_w[:, sites]
        kind = self.env.cfg.robot
        ground = self.robot.data.root_link_pos_w[:, None, 2] - (kind.map_height - kind.foot_radius)
        lack = (0.12 - (feet[..., 2] - ground)).clamp(0.0, 0.12)
        speed = (feet - self.feet_before)[..., :2].norm(dim=-1).nan_to_num() / 0.02
        self.feet_before = feet.clone()
        return (lack.square() * speed).sum(-1)

    def ends(self) -> dict[str, torch.Tensor]:
        env, data = self.env, self.robot.data
        kinds = list(env.scene.terrain.cfg.terrain_generator.sub_terrains)
        height = data.root_link_pos_w[:, 2] - env.scene.env_origins[:, 2]
        return {
            "time_out": env.episode_length_buf >= env.max_episode_length,
            "fallen": data.projected_gravity_b[:, 2] > -0.17,
            "in_gap": (env.scene.terrain.terrain_types == kinds.index("gap")) & (height < -0.25),
            "below_map": height < -3.0,
            "left_tile": (data.root_link_pos_w - env.scene.env_origins)[:, :2].abs().amax(-1) > 4.0,
        }

    def costs(self) -> torch.Tensor:
        data, kind = self.robot.data, self.env.cfg.robot
        motors = [kind.motor(name) for name in self.robot.joint_names]
        speed, torque = torch.tensor([(m.velocity, m.torque) for m in motors]).T
        low, high = data.joint_pos_limits.unbind(-1)
        soft = 0.9 * (high - low) / 2
        outside = (data.joint_pos - (low + high) / 2).abs() - soft
        asked = kind.stiffness * (data.joint_pos_target - data.joint_pos)
        asked = asked - kind.damping * data.joint_vel
        parts = (
            outside.relu(),
            (data.joint_vel.abs() - 0.8 * speed).clamp(0.0, 1.0),
            (asked.abs() - 0.8 * torque).relu(),
        )
        return torch.stack([part.sum(-1) for part in parts], dim=-1)


def test_a_step_is_judged_as_torch_would(parkour):
    generator = torch.Generator().manual_seed(0)
    parkour.reset()
    reference, judge = Reference(parkour), parkour.judge
    for seen in range(4):
        scatter(parkour, generator)
        parkour.episode_length_buf[:] = torch.arange(12) + parkour.max_episode_length - 5
        judge()
        for name, expected in reference.rewards().items():
            got = judge.value(parkour.reward_manager.get_term_cfg(name).func)
            torch.testing.assert_close(got, expected, rtol=1e-4, atol=1e-5, msg=f"{name} {seen}")
        for name, expected in reference.ends().items():
            got = judge.value(parkour.termination_manager.get_term_cfg(name).func)
            assert torch.equal(got, expected), name
        costs = reference.costs()
        torch.testing.assert_close(judge.costs, costs * 0.02, rtol=1e-4, atol=1e-5)
        violated = [judge.value(term) for term in VIOLATED.values()]
        assert torch.equal(torch.stack(violated, dim=-1), (costs > 0.0).float())


def test_proprioception_is_in_the_vocabularys_order(flat):
    flat.reset()
    scatter(flat, torch.Generator().manual_seed(1))
    flat.command_manager.compute(dt=0.0)
    robot = flat.scene["robot"]
    order, _ = robot.find_joints(JOINTS, preserve_order=True)
    expected = {
        "base_angular_velocity": robot.data.root_link_ang_vel_b,
        "projected_gravity": robot.data.projected_gravity_b,
        "command": flat.command_manager.get_command("goal"),
        "joint_position": (robot.data.joint_pos - robot.data.default_joint_pos)[:, order],
        "joint_velocity": robot.data.joint_vel[:, order],
        "last_action": flat.action_manager.action,
    }
    got = observations.proprioception(flat)
    for name, columns in proprioception_slices().items():
        assert torch.equal(got[:, columns], expected[name]), name
    velocity = observations.velocity(flat)
    torch.testing.assert_close(velocity, robot.data.root_link_lin_vel_b)
    found = flat.scene["feet_contact"].data.found > 0
    assert torch.equal(observations.feet_contact(flat), found.float())


@pytest.mark.parametrize("delayed", [False, True])
def test_observations_are_mjlabs(delayed):
    cfg = env_cfg("Renet-Go1-Parkour")
    if delayed:  # Left to mjlab.
        term = cfg.observations["proprioception_clean"].terms["value"]
        term.delay_min_lag = term.delay_max_lag = 1
    env = build(cfg, 6)
    mjlab = ObservationManager(env.cfg.observations, env)
    env.reset()
    mjlab.compute(update_history=True, env_ids=torch.arange(6))
    for _ in range(3):
        ours = env.step(torch.randn(6, 12))[0]
        theirs = mjlab.compute(update_history=True)
        assert ours.keys() == theirs.keys()
        for name in ours.keys() - {"proprioception"}:
            assert torch.equal(ours[name], theirs[name]), name
    kept = {name: value.clone() for name, value in ours.items()}
    env.step(torch.zeros(6, 12))
    assert all(torch.equal(ours[name], kept[name]) for name in ours)
    env.close()


def test_a_task_may_observe_by_torch_alone():
    cfg = env_cfg("Renet-Go1-Flat")
    cfg.observations = {"feet_height": cfg.observations["feet_height"]}
    env = build(cfg, 2)
    env.reset()
    assert env.step(torch.zeros(2, 12))[0]["feet_height"].shape == (2, 4)
    env.close()


def test_noise_is_within_its_bounds_and_scaled_with_what_it_is_added_to(parkour):
    parkour.reset()
    most = torch.zeros(45)
    columns = proprioception_slices()
    for term in PROPRIOCEPTION:
        most[columns[term.name]] = term.scale * NOISE.get(term.name, 0.0)
    seen = []
    for _ in range(20):
        now = parkour.step(torch.zeros(12, 12))[0]
        seen.append(now["proprioception"] - now["proprioception_clean"])
    error = torch.cat(seen)
    assert (error.abs() <= most + 1e-6).all()
    for side in (error, -error):
        assert (side[:, most > 0.0].amax(0) > 0.8 * most[most > 0.0]).all()


@per_robot
def calf_position(step: Step, robot: int) -> float:
    """The example of docs/robots.md."""
    return offset(step, robot, 2) * offset(step, robot, 2)


def test_a_task_adds_a_term_of_its_own_in_warp():
    cfg = env_cfg("Renet-Go1-Flat")
    cfg.rewards = {"calf_position": RewardTermCfg(func=calf_position, weight=-0.5)}
    cfg.clip_reward = False
    env = build(cfg, 3)
    env.reset()
    _, reward, *_ = env.step(torch.ones(3, 12))
    data = env.scene["robot"].data
    squares = (data.joint_pos - data.default_joint_pos)[:, 2].square()
    assert (squares > 0.0).all()
    torch.testing.assert_close(calf_position(env), squares)
    torch.testing.assert_close(reward, -0.5 * 0.02 * squares)
    env.close()


def test_torchs_terms_stand_beside_warps():
    cfg = env_cfg("Renet-Go1-Flat")
    cfg.terminations["third"] = TerminationTermCfg(
        func=lambda env: torch.arange(env.num_envs) == 2, time_out=True
    )
    env = build(cfg, 4)
    env.reset()
    _, _, terminated, truncated, extras = env.step(torch.zeros(4, 12))
    assert truncated.tolist() == [False, False, True, False]
    assert not terminated.any()
    assert extras["log"]["Episode_Termination/third"] == 1
    env.close()


def test_a_term_the_task_lacks_is_named(flat):
    with pytest.raises(ValueError, match="the task has no term left_tile"):
        left_tile(flat)


def test_broken_physics_ends_the_episode_and_pays_nothing(parkour):
    parkour.reset()
    parkour.sim.data.qvel[3, 1] = torch.nan
    _, reward, terminated, _, extras = parkour.step(torch.zeros(12, 12))
    assert terminated.tolist() == [robot == 3 for robot in range(12)]
    assert reward.isfinite().all()
    assert extras["costs"].isfinite().all()
    assert rewards.collision(parkour).isfinite().all()


def test_a_runner_may_assign_episode_lengths(parkour):
    parkour.reset()
    parkour.episode_length_buf = torch.full((12,), parkour.max_episode_length - 1)
    *_, truncated, _ = parkour.step(torch.zeros(12, 12))
    assert truncated.all()
