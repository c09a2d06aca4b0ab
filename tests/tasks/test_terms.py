"""Reward, cost and curriculum maths against hand-computed numbers."""

import math

import pytest
import torch

from renet.tasks import env_cfg, mdp

from .conftest import evaluate


def test_goal_velocity_is_equation_6(flat, goal):
    velocity = torch.tensor([[0.3, 0.0], [2.0, 0.0], [-0.5, 0.0], [0.0, 0.0]])
    flat.sim.data.qvel[:, :2], goal.yaw[:] = velocity, 0.0
    goal.speed[:] = torch.tensor([0.6, 0.6, 0.5, 0.0])
    expected = torch.tensor([0.5, 1.0, -1.0, 1.0])
    got = evaluate(flat, "linear_velocity")
    torch.testing.assert_close(got, expected, atol=1e-4, rtol=0)
    flat.sim.data.qvel[3, :2] = torch.tensor([3.0, 4.0])
    assert evaluate(flat, "linear_velocity")[3].item() == pytest.approx(1.0 / 6.0)


def test_collision_counts_bodies_not_geoms(flat):
    flat.sim.data.sensordata[:] = 0.0
    bodies, calves = flat.scene["thigh_trunk_contact"], flat.scene["calf_contact"]
    views = [slot.data_view for slot in calves._slots]
    assert len(views) == 8
    bodies._slots[4].data_view[0, 2] = 5.0
    views[0][0, 2] = views[1][0, 2] = 3.0  # Both geoms of one calf.
    views[6][0, 0] = 0.2
    bodies._slots[0].data_view[1, 1] = 0.05  # Below 0.1 N.
    flat.scene.update(0.0)
    assert evaluate(flat, "collision").tolist() == [3.0, 0.0, 0.0, 0.0]


def test_penalties_by_hand(flat, goal):
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
    goal.yaw[:] = 0.5
    flat.action_manager.process_action(torch.zeros(4, 12))
    flat.action_manager.process_action(torch.full((4, 12), 0.5))
    expected = {
        "orientation": math.sin(angle) ** 2,
        "yaw": math.exp(-0.5),
        "default_position": 0.05,
        "hip_position": 0.04,
        "joint_energy": abs(robot.data.qfrc_actuator[0, 0].item() * 2.0),
        "action_rate": 0.5 * math.sqrt(12),
    }
    assert expected["joint_energy"] > 1.0
    got = {name: evaluate(flat, name)[0].item() for name in expected}
    assert got == pytest.approx(expected, rel=1e-4)


def test_paper_rewards_have_its_scales():
    terms = ("linear_velocity", "yaw", "collision", "joint_energy", "action_rate")
    terms += ("default_position", "hip_position", "joint_acceleration", "orientation")
    scales = (1.5, 0.5, -10.0, -1e-5, -0.1, -0.04, -0.5, -2.5e-7, -1.0)
    rewards = env_cfg("Renet-Go1-Parkour-Paper").rewards.items()
    assert {name: term.weight for name, term in rewards} == dict(zip(terms, scales, strict=True))


def test_torque_is_judged_before_the_motor_saturates(flat):
    flat.step(torch.zeros(4, 12))
    data, robot = flat.sim.data, flat.scene["robot"]
    data.qpos[:, 7:] = robot.data.default_joint_pos
    data.qvel[:] = 0.0
    flat.sim.forward()
    target = robot.data.default_joint_pos.clone()
    robot.set_joint_position_target(target)

    def costs() -> torch.Tensor:
        flat.metrics_manager.compute()
        return mdp.constraint_costs(flat)[0] / 0.02

    assert (costs() == 0.0).all()
    target[:, 2] += 1.0
    robot.set_joint_position_target(target)
    # 40 N m/rad x 1 rad on a calf whose motor gives 35.55 N m at most.
    expected = torch.tensor([0.0, 0.0, 40.0 - 0.8 * 35.55])
    torch.testing.assert_close(costs(), expected, atol=1e-3, rtol=0)
    data.qvel[:, 6] = -25.0
    flat.sim.forward()
    robot.set_joint_position_target(robot.data.default_joint_pos)
    # Hip: 25 - 0.8 * 30.1 = 0.92 rad/s too fast; damping asks for 25 - 0.8 * 23.7 N m too much.
    expected = torch.tensor([0.0, 0.92, 25.0 - 0.8 * 23.7])
    torch.testing.assert_close(costs(), expected, atol=1e-2, rtol=0)


def test_standing_is_free_lying_collides(flat):
    for _ in range(50):
        flat.step(torch.zeros(4, 12))
    assert (mdp.constraint_costs(flat) == 0.0).all()
    assert (mdp.collision(flat) == 0.0).all()
    assert mdp.feet_contact(flat).all()
    flat.sim.data.qpos[0, 2] = 0.15
    flat.sim.data.qpos[0, 3:7] = torch.tensor([0.7071, 0.7071, 0.0, 0.0])
    for _ in range(10):  # On its side before the environment would reset it.
        flat.sim.step()
    flat.scene.update(0.2)
    assert mdp.collision(flat)[0] >= 1.0
    assert (mdp.collision(flat)[1:] == 0.0).all()


def test_joint_acceleration_starts_each_episode_at_rest(flat):
    flat.sim.data.qvel[:, 6:] = 1.5
    expected = 12 * (1.5 / 0.02) ** 2
    assert evaluate(flat, "joint_acceleration").tolist() == pytest.approx([expected] * 4)
    assert (evaluate(flat, "joint_acceleration") == 0.0).all()
    flat.reward_manager.reset(torch.tensor([0]))
    again = evaluate(flat, "joint_acceleration")
    assert again.tolist() == pytest.approx([expected, 0.0, 0.0, 0.0])


def test_foot_clearance_by_hand(flat):
    data, kind = flat.sim.data, flat.cfg.robot
    sites, _ = flat.scene["robot"].find_sites(("FR", "FL", "RR", "RL"), preserve_order=True)
    columns = flat.scene["robot"].indexing.site_ids[sites]
    base = flat.scene["robot"].indexing.root_body_id
    standing = data.xpos[:, base, 2] - (kind.map_height - kind.foot_radius)
    feet = torch.zeros(4, 4, 3)
    feet[..., 2] = standing[:, None] + torch.tensor([0.05, 0.30, 0.0, 0.12])
    data.site_xpos[:, columns] = feet
    assert (evaluate(flat, "foot_clearance") == 0.0).all()  # No speed is known yet.
    data.site_xpos[:, columns] = feet + torch.tensor([0.003, 0.004, 0.0])
    # 0.25 m/s; lifted by 5 cm of 12, high up, not at all, just enough.
    expected = 0.25 * (0.07**2 + 0.12**2)
    assert evaluate(flat, "foot_clearance").tolist() == pytest.approx([expected] * 4, rel=1e-3)
    flat.reward_manager.reset(torch.arange(4))
    assert (evaluate(flat, "foot_clearance") == 0.0).all()


def test_upright_tracking_needs_height(flat, goal):
    data, kind, robot = flat.sim.data, flat.cfg.robot, flat.scene["robot"].indexing
    goal.yaw[:], goal.speed[:] = 0.0, torch.tensor([0.6, 0.6, 0.6, 0.0])
    data.qvel[:, :2] = 0.0
    data.qvel[:3, 0] = torch.tensor([0.3, 0.99, -0.3])  # The last stands still, as it was told.
    standing = kind.map_height - kind.foot_radius
    below = standing * torch.tensor([1.1, 0.8, 1.0, 0.6])  # Crouching, it earns nothing.
    feet = data.xpos[:, robot.root_body_id, 2, None] - below[:, None] + torch.zeros(4, 4)
    feet[:, 1:] += 0.2
    ids = flat.scene["robot"].find_sites(("FR", "FL", "RR", "RL"), preserve_order=True)[0]
    data.site_xpos[:, robot.site_ids[ids], 2] = feet
    got = evaluate(flat, "upright_tracking").tolist()
    assert got == pytest.approx([0.5, 0.75 * 0.5, 0.0, 0.0], abs=1e-3)


def test_standing_motion_counts_when_standing(flat, goal):
    data = flat.sim.data
    goal.speed[:] = torch.tensor([0.0, 0.3, 0.0, 0.3])
    data.qvel[:] = 0.0
    data.qvel[:, 6], data.qvel[:, 8] = 1.0, -2.0
    # A tenth of each velocity.
    assert evaluate(flat, "standing_motion").tolist() == pytest.approx([0.05, 0.0, 0.05, 0.0])
    data.qvel[:] = -data.qvel[:]  # Shaking: 0.9 * 0.1 - 0.1 of each is left.
    left = evaluate(flat, "standing_motion").tolist()
    assert left == pytest.approx([0.0005, 0.0, 0.0005, 0.0], rel=1e-4)
    flat.reward_manager.reset(torch.tensor([0]))
    assert evaluate(flat, "standing_motion")[0].item() == pytest.approx(0.05)


def test_extra_rewards_are_the_recipes():
    paper, ours = (env_cfg(f"Renet-Go1-{task}").rewards for task in ("Parkour-Paper", "Parkour"))
    extra = ours.keys() - paper.keys()
    ours_alone = {"foot_clearance", "standing_motion", "stepping", "upright_tracking"}
    assert extra == ours_alone
    changed = [name for name, term in paper.items() if ours[name].weight != term.weight]
    assert changed == ["collision"]


def test_critics_observe_stalls_and_motion(flat, goal):
    goal.speed[:], goal.time_left[:] = torch.tensor([0.5, 0.5, 0.0, 0.0]), 10.0
    smooth = torch.zeros(4, 12)
    for step in range(6):
        if step == 3:
            flat.reset(env_ids=torch.tensor([0]))
            goal.speed[0], smooth[0] = 0.5, 0.0
        seen = flat.step(torch.full((4, 12), 0.3))[0]["privileged"]
        smooth = smooth + 0.1 * (flat.sim.data.qvel[:, 6:] - smooth)
        torch.testing.assert_close(seen[:, 5:17], smooth, atol=1e-4, rtol=1e-4)
    # The first step of an episode marks where it stands.
    assert seen[:, 4].tolist() == pytest.approx([0.04, 0.1, 0.0, 0.0])


def test_a_robot_that_gives_up_has_stalled(flat, goal):
    base = int(flat.scene["robot"].indexing.root_body_id)
    # Walks, gives up, was told to stand, gives up but is set down anew.
    goal.speed[:] = torch.tensor([0.5, 0.5, 0.0, 0.5])
    ends = flat.termination_manager
    seen = []
    for step in range(170):
        flat.sim.data.xpos[0, base, 0] = 0.01 * step
        if step == 100:
            ends.reset(torch.tensor([3]))
        ends.compute()
        seen.append(ends.get_term("stalled").clone())
    # Its first step marks where it stands, then 3 s and a step must pass.
    assert torch.stack(seen).int().argmax(0).tolist() == [0, 151, 0, 0]
    assert torch.stack(seen).any(0).tolist() == [False, True, False, False]
