"""Pushes, and randomisation that is off by default: what they change, and by how much."""

import math

import pytest
import torch

from renet.interface import proprioception_slices
from renet.tasks import env_cfg
from renet.tasks.parkour_env_cfg import flat_env_cfg, randomize
from renet.tasks.sensors import depth_camera


@pytest.fixture
def randomized(build):
    """Makes robots that stand still on a plane unless randomisation moves them."""

    def make(robots: int, **ranges: float):
        cfg = env_cfg("Renet-Go1-Flat", play=True)
        randomize(cfg, **ranges)
        return build(cfg, robots)

    return make


def test_only_what_is_asked_for_is_randomised():
    plain, cfg = flat_env_cfg(), flat_env_cfg()
    randomize(cfg, motor_strength=0.2, action_delay=0.02, camera_delay=0.1, joint_offset=0.03)
    assert cfg.events.keys() - plain.events.keys() == {"motor_strength", "joint_offset"}
    for task, age, steps in ((plain, 0.0, 0), (cfg, 0.1, 4)):  # Of 5 ms.
        camera, robot = depth_camera(task), task.scene.entities["robot"]
        assert camera.delay == (0.0, age)
        assert (camera.mount.position_error, camera.mount.angle_error) == (0.01, math.radians(5.0))
        assert {actuator.delay_max_lag for actuator in robot.articulation.actuators} == {steps}


def test_each_robot_is_pushed_sideways(flat):
    flat.reset(seed=1)
    before = flat.sim.data.qvel[:].clone()
    push = flat.event_manager.get_term_cfg("push")
    push.func(flat, torch.arange(4), **push.params)
    change = (flat.sim.data.qvel[:] - before)[:, :6]
    assert 0.2 < change[:, :2].abs().max() <= 0.5 + 1e-5
    assert change[:, 2:].abs().max() < 1e-4, "only along x and y"
    assert len(change[:, 0].unique()) == 4
    assert push.interval_range_s == (6.0, 10.0)


def test_motors_differ_in_strength(randomized):
    env = randomized(64, motor_strength=0.2)
    limits = env.sim.model.actuator_forcerange[:, :, 1]
    ratio = limits / env.sim.get_default_field("actuator_forcerange")[:, 1]
    assert 0.8 - 1e-4 <= ratio.min() < 0.82 < 1.18 < ratio.max() <= 1.2 + 1e-4
    # The strongest command is cut off at each motor's own limit.
    env.step(torch.full((64, 12), 20.0))
    force = env.sim.data.actuator_force[:].abs()
    assert (force - limits).max().abs() < 1e-3


def test_joint_zeros_are_off_in_what_is_seen_and_in_what_is_done(randomized):
    env = randomized(16, joint_offset=0.03)
    offset = env.scene["robot"].data.encoder_bias
    assert 0.02 < offset.abs().max() <= 0.03
    seen = env.step(torch.zeros(16, 12))[0]["proprioception"]
    data = env.scene["robot"].data
    true = data.joint_pos - data.default_joint_pos
    torch.testing.assert_close(seen[:, proprioception_slices()["joint_position"]], true + offset)
    torch.testing.assert_close(data.joint_pos_target, data.default_joint_pos - offset)


def test_some_actions_arrive_late(randomized):
    env, late = randomized(32, action_delay=0.02), []
    moved = env.sim.mj_model.actuator_trnid[:, 0] - 1  # After the free joint.
    for step in range(20):
        env.step(torch.full((32, 12), 1.0 if step % 2 else -1.0))
        target = env.scene["robot"].data.joint_pos_target[:, moved]
        late.append(((env.sim.data.ctrl[:] - target).abs() > 1e-5).any(dim=1))
    assert 0.0 < torch.stack(late[3:]).float().mean() < 1.0
