"""Reward, cost and curriculum maths against hand-computed numbers."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest
import torch

from renet.errors import RenetError
from renet.tasks import env_cfg, observations, rewards, terminations
from renet.tasks.constraints import excess, outside
from renet.tasks.curriculum import asked_distance, level_change
from renet.training.train import tuned

from .conftest import build


def test_goal_velocity_is_equation_6():
    velocity = torch.tensor([[0.3, 0.0], [2.0, 0.0], [-0.5, 0.0], [0.0, 0.0], [3.0, 4.0]])
    direction = torch.tensor([[1.0, 0.0]]).repeat(5, 1)
    speed = torch.tensor([0.6, 0.6, 0.5, 0.0, 0.0])
    got = rewards.goal_velocity(velocity, direction, speed)
    expected = torch.tensor([0.5, 1.0, -1.0, 1.0, 1.0 / 6.0])
    torch.testing.assert_close(got, expected, atol=1e-4, rtol=0)


def test_collision_counts_bodies_not_geoms():
    thigh_trunk, calf = torch.zeros(2, 5, 3), torch.zeros(2, 8, 3)
    thigh_trunk[0, 4, 2] = 5.0
    calf[0, 0, 2] = calf[0, 1, 2] = 3.0  # Both geoms of one calf.
    calf[0, 6, 0] = 0.2
    thigh_trunk[1, 0, 1] = 0.05  # Below 0.1 N.
    assert rewards.collision_count(thigh_trunk, calf).tolist() == [3.0, 0.0]


def test_costs_by_hand():
    low, high = torch.tensor([[-1.0, -1.0]]), torch.tensor([[1.0, 1.0]])
    assert outside(torch.tensor([[1.5, -1.25]]), low, high).item() == 0.75
    assert excess(torch.tensor([[-12.0, 9.0]]), torch.tensor([10.0, 10.0])).item() == 2.0


def test_who_falls_owes_the_whole_episode(parkour):
    parkour.reset()
    goal, done = parkour.command_manager.get_term("goal"), torch.zeros(12, dtype=torch.bool)
    goal.asked[:], goal.speed[:] = 0.5, 0.8
    parkour.episode_length_buf[:] = parkour.max_episode_length - 100
    done[3] = True
    parkour.termination_manager._terminated_buf[:] = done
    owed = asked_distance(parkour)
    # 100 steps of 0.02 s at 0.8 m/s remained.
    assert owed[3].item() == pytest.approx(0.5 + 1.6)
    assert (owed[~done] == 0.5).all()


def test_asked_distance_is_the_integral_of_the_command(flat):
    flat.reset()
    goal = flat.command_manager.get_term("goal")
    goal.speed[:] = torch.tensor([0.0, 0.25, 0.5, 1.0])
    for _ in range(5):
        flat.step(torch.zeros(4, 12))
    torch.testing.assert_close(goal.asked, 0.1 * goal.speed)
    flat.reset(env_ids=torch.tensor([2]))
    assert goal.asked.tolist() == pytest.approx([0.0, 0.025, 0.0, 0.1])


def test_penalties_by_hand(flat):
    flat.reset()
    data, robot = flat.sim.data, flat.scene["robot"]
    angle = 0.3
    data.qpos[:, 3:7] = torch.tensor([math.cos(angle / 2), math.sin(angle / 2), 0.0, 0.0])
    data.qpos[:, 7:] = robot.data.default_joint_pos
    data.qpos[:, 7] += 0.2  # Front right hip.
    data.qpos[:, 8] -= 0.1  # Front right thigh.
    data.qvel[:] = 0.0
    data.qvel[:, 6] = 2.0
    flat.sim.forward()
    flat.scene.update(0.0)
    goal = flat.command_manager.get_term("goal")
    goal.yaw[:] = 0.5

    def weigh(name: str) -> float:
        term = flat.reward_manager.get_term_cfg(name)
        return term.weight * term.func(flat, **term.params)[0].item()

    assert weigh("orientation") == pytest.approx(-(math.sin(angle) ** 2), rel=1e-4)
    assert weigh("yaw") == pytest.approx(0.5 * math.exp(-0.5), rel=1e-4)
    assert weigh("default_position") == pytest.approx(-0.04 * 0.05, rel=1e-3)
    assert weigh("hip_position") == pytest.approx(-0.5 * 0.04, rel=1e-3)
    power = abs(robot.data.qfrc_actuator[0, 0].item() * 2.0)
    assert power > 1.0
    assert weigh("joint_energy") == pytest.approx(-1e-5 * power, rel=1e-4)
    flat.action_manager.process_action(torch.zeros(4, 12))
    flat.action_manager.process_action(torch.full((4, 12), 0.5))
    assert weigh("action_rate") == pytest.approx(-0.1 * 0.5 * math.sqrt(12), rel=1e-4)


def test_torque_is_judged_before_the_motor_saturates(flat):
    flat.reset()
    data, robot = flat.sim.data, flat.scene["robot"]
    data.qpos[:, 7:] = robot.data.default_joint_pos
    data.qvel[:] = 0.0
    flat.sim.forward()
    target = robot.data.default_joint_pos.clone()
    robot.set_joint_position_target(target)
    assert (flat.constraints() == 0.0).all()
    target[:, 2] += 1.0
    robot.set_joint_position_target(target)
    # 40 N m/rad x 1 rad on a calf whose motor gives 35.55 N m at most.
    expected = torch.tensor([0.0, 0.0, 40.0 - 0.8 * 35.55])
    torch.testing.assert_close(flat.constraints()[0], expected, atol=1e-3, rtol=0)
    data.qvel[:, 6] = -25.0
    flat.sim.forward()
    robot.set_joint_position_target(robot.data.default_joint_pos)
    # Hip: 25 - 0.8 * 30.1 = 0.92 rad/s too fast; damping asks for 25 - 0.8 * 23.7 N m too much.
    expected = torch.tensor([0.0, 0.92, 25.0 - 0.8 * 23.7])
    torch.testing.assert_close(flat.constraints()[0], expected, atol=1e-2, rtol=0)


def test_a_standing_robot_costs_nothing_and_a_lying_one_collides(flat):
    flat.reset()
    for _ in range(50):
        *_, extras = flat.step(torch.zeros(4, 12))
    assert (extras["costs"] == 0.0).all()
    assert (rewards.collision(flat) == 0.0).all()
    assert observations.feet_contact(flat).all()
    flat.sim.data.qpos[0, 2] = 0.1
    flat.sim.data.qpos[0, 3:7] = torch.tensor([0.0, 1.0, 0.0, 0.0])
    for _ in range(10):  # On its back before the environment would reset it.
        flat.sim.step()
    flat.scene.update(0.2)
    assert rewards.collision(flat)[0] >= 1.0
    assert (rewards.collision(flat)[1:] == 0.0).all()


def test_violation_rates_are_logged(flat):
    flat.reset()
    flat.step(torch.full((4, 12), 4.8))
    flat.episode_length_buf[:] = flat.max_episode_length
    *_, extras = flat.step(torch.zeros(4, 12))
    log = extras["log"]
    assert log["Episode_Metrics/violated_torque"] >= 0.5
    assert log["Episode_Metrics/violated_joint_position"] >= 0.0


def test_walk_in_minutes_rule():
    distance = torch.tensor([4.1, 3.0, 1.5, 1.5, 0.1])
    asked = torch.tensor([4.0, 20.0, 20.0, 2.0, 0.0])
    up, down = level_change(distance, asked)
    # Below half of what was asked, at most half of 4 m, means down.
    assert up.tolist() == [True, False, False, False, False]
    assert down.tolist() == [False, False, True, False, False]


def test_goals_are_drawn_and_the_second_level_asks_for_standing():
    env = build("Renet-Go1-Flat", 256)
    env.reset()
    goal = env.command_manager.get_term("goal")
    assert 0.2 <= goal.speed.min() <= goal.speed.max() <= 1.0
    assert goal.heading_error.abs().max() <= math.pi / 2 + 1e-3
    goal.stage = 1
    env.reset()
    # A tenth by choice, a tenth of the rest because it is too slow to be walking.
    assert 0.1 < (goal.speed == 0.0).float().mean() < 0.3
    walking = goal.speed[goal.speed > 0.0]
    assert 0.1 <= walking.min() < 0.2 < walking.max() <= 1.0
    command = goal.command
    torch.testing.assert_close(command[:, 1] ** 2 + command[:, 2] ** 2, torch.ones(256))


def test_a_fixed_goal_is_kept():
    from renet.tasks import env_cfg

    cfg = env_cfg("Renet-Go1-Flat", play=True)
    cfg.commands["goal"].fixed = (0.6, None)
    env = build(cfg, 8)
    env.reset()
    goal = env.command_manager.get_term("goal")
    assert (goal.speed == 0.6).all()
    assert goal.heading_error.abs().max() < 1e-3


def test_joint_acceleration_starts_each_episode_at_rest():
    env = build("Renet-Go1-Flat", 2)
    env.reset()
    env.step(torch.full((2, 12), 1.0))
    term = rewards.JointAcceleration(None, env)
    velocity = env.scene["robot"].data.joint_vel
    expected = (velocity / 0.02).square().sum(-1)
    torch.testing.assert_close(term(env), expected)
    assert (term(env) == 0.0).all()
    term.reset(torch.tensor([0]))
    again = term(env)
    torch.testing.assert_close(again[0], expected[0])
    assert again[1] == 0.0


def test_foot_clearance_by_hand():
    class Robot:
        data = SimpleNamespace(root_link_pos_w=torch.tensor([[0.0, 0.0, 0.30]]))
        indexing = SimpleNamespace(site_ids=torch.tensor([1, 2, 3]))  # Of the whole scene.

        def find_sites(self, names, preserve_order):
            assert preserve_order
            return list(range(len(names))), list(names)

    feet = [[9.0, 9.0, 9.0], [0.0, 0.0, 0.05], [0.0, 0.0, 0.30], [0.0, 0.0, 0.0]]
    env = SimpleNamespace(scene={"robot": Robot()}, num_envs=1, device="cpu", step_dt=0.02)
    env.sim = SimpleNamespace(data=SimpleNamespace(site_xpos=torch.tensor([feet])))
    params = {"feet": ("FR", "FL", "RR"), "height": 0.30, "lift": 0.09}
    term = rewards.FootClearance(SimpleNamespace(params=params), env)
    assert term(env, **params).item() == 0.0  # No speed is known yet.
    env.sim.data.site_xpos = env.sim.data.site_xpos + torch.tensor([0.003, 0.004, 0.0])
    # 0.25 m/s; lifted by 5 cm of 9, high up, and not at all.
    expected = 0.25 * (0.04**2 + 0.0 + 0.09**2)
    assert term(env, **params).item() == pytest.approx(expected, rel=1e-4)
    term.reset(torch.tensor([0]))
    assert term(env, **params).item() == 0.0


def test_standing_motion_is_smoothed_and_counts_only_where_standing_is_asked_for():
    data = SimpleNamespace(joint_vel=torch.tensor([[1.0, -2.0], [1.0, -2.0]]))
    env = SimpleNamespace(
        scene={"robot": SimpleNamespace(data=data)},
        command_manager=SimpleNamespace(
            get_term=lambda name: SimpleNamespace(speed=torch.tensor([0.0, 0.3]))
        ),
        step_dt=0.02,
    )
    term = rewards.StandingMotion(None, env)
    first = term(env, time_constant=0.2)
    torch.testing.assert_close(first, torch.tensor([0.05, 0.0]))  # A tenth of each velocity.
    data.joint_vel = -data.joint_vel  # Shaking: 0.9 * 0.1 - 0.1 of each is left.
    torch.testing.assert_close(term(env, time_constant=0.2), torch.tensor([0.0005, 0.0]))
    term.reset(torch.tensor([0]))
    torch.testing.assert_close(term(env, time_constant=0.2), first)


def test_rewards_beyond_the_papers_are_paid_only_on_request():
    extra = ("foot_clearance", "standing_motion")
    assert all(env_cfg("Renet-Go1-Flat").rewards[name].weight == 0.0 for name in extra)
    terms = tuned("Renet-Go1-Flat", {"foot_clearance": -15.0}, {}).rewards
    assert (terms["foot_clearance"].weight, terms["collision"].weight) == (-15.0, -10.0)
    with pytest.raises(RenetError, match="no reward 'lift': choose of linear_velocity"):
        tuned("Renet-Go1-Flat", {"lift": 1.0}, {})


def test_tiles_are_shared_out_as_asked():
    env = build(tuned("Renet-Go1-Parkour", {}, {"rough": 1.0, "gap": 3.0}), 14)
    assert torch.bincount(env.scene.terrain.terrain_types).tolist() == [2, 2, 2, 2, 4, 2]
    for share, problem in (
        ({"moat": 1.0}, "no tile 'moat': choose of rough"),
        ({"gap": -1.0}, "0"),
    ):
        with pytest.raises(RenetError, match=problem):
            tuned("Renet-Go1-Parkour", {}, share)
    with pytest.raises(RenetError, match="no tile 'gap': it is flat"):
        tuned("Renet-Go1-Flat", {}, {"gap": 1.0})


def test_a_robot_that_gives_up_has_stalled():
    data = SimpleNamespace(root_link_pos_w=torch.zeros(3, 3))
    speed = torch.tensor([0.5, 0.5, 0.0])  # Walks, gives up, was told to stand.
    env = SimpleNamespace(
        scene={"robot": SimpleNamespace(data=data)},
        command_manager=SimpleNamespace(get_term=lambda name: SimpleNamespace(speed=speed)),
        num_envs=3,
        device="cpu",
        step_dt=0.02,
    )
    term = terminations.Stalled(None, env)
    seen = []
    for step in range(60):
        data.root_link_pos_w[0, 0] = 0.01 * step
        seen.append(term(env, window=1.0, progress=0.15))
    stalled = torch.stack(seen)
    # Its first step marks where it stands, then 1 s and a step must pass.
    assert stalled.int().argmax(0).tolist() == [0, 51, 0]
    assert stalled.any(0).tolist() == [False, True, False]
    term.reset(torch.tensor([1]))
    assert not term(env, window=1.0, progress=0.15).any()
