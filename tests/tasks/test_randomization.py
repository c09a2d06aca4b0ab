"""Pushes, and randomisation that is off by default: what they change, and by how much."""

import math
from itertools import pairwise

import pytest
import torch

from renet.errors import RenetError
from renet.interface import proprioception_slices
from renet.tasks import env_cfg, make_env
from renet.tasks.parkour_env_cfg import flat_env_cfg, randomize
from renet.tasks.sensors import depth_camera


@pytest.fixture
def randomized(build):
    """Makes robots that stand still on a plane unless randomisation moves them."""

    def make(robots: int, **ranges):
        cfg = env_cfg("Renet-Go1-Flat", play=True)
        randomize(cfg, **ranges)
        return build(cfg, robots)

    return make


def test_only_what_is_asked_for_is_randomised():
    plain, cfg = flat_env_cfg(), flat_env_cfg()
    randomize(cfg, motor_strength=0.2, action_delay=0.02, camera_delay=0.1, joint_offset=0.03)
    assert cfg.events.keys() - plain.events.keys() == {"motor_strength", "joint_offset"}
    for task, age, steps in ((plain, 0.0, 0), (cfg, 0.1, 4)):  # Of 5 ms.
        camera = depth_camera(task)
        assert camera.delay == (0.0, age)
        assert (camera.mount.position_error, camera.mount.angle_error) == (0.01, math.radians(5.0))
        assert task.motors.max_lag == steps
        assert task.motors.no_load_speed is None
    randomize(
        cfg, damping=(0.7, 2.2), armature=(0.5, 2.0), joint_friction=0.3, no_load_speed=(0.8, 1.2)
    )
    more = {"damping", "armature", "joint_friction"}
    assert cfg.events.keys() - plain.events.keys() == {"motor_strength", "joint_offset", *more}
    assert cfg.motors.no_load_speed == (0.8, 1.2)


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


def test_joint_offset_acts_on_both_sides(randomized):
    env = randomized(16, joint_offset=0.03)
    offset = env.scene["robot"].data.encoder_bias
    assert 0.02 < offset.abs().max() <= 0.03
    seen = env.step(torch.zeros(16, 12))[0]["proprioception"]
    data = env.scene["robot"].data
    true = data.joint_pos - data.default_joint_pos
    torch.testing.assert_close(seen[:, proprioception_slices()["joint_position"]], true + offset)
    torch.testing.assert_close(data.joint_pos_target, data.default_joint_pos - offset)


def drawn(env, field: str, part: int | slice = slice(None)) -> torch.Tensor:
    """A field of the model in multiples of its nominal value, for every robot."""
    return getattr(env.sim.model, field)[..., part] / env.sim.get_default_field(field)[..., part]


def test_motors_of_a_robot_share_damping(randomized):
    env = randomized(512, damping=(0.7, 2.2))
    damping = drawn(env, "actuator_biasprm", 2)
    torch.testing.assert_close(damping, damping[:, :1].expand(-1, 12))
    assert 0.7 - 1e-4 <= damping.min() < 0.72
    assert 2.15 < damping.max() <= 2.2 + 1e-4
    # Half of the robots are below the geometric mean.
    below = (damping[:, 0] < math.sqrt(0.7 * 2.2)).float().mean()
    assert 0.42 < below < 0.58
    stiffness = drawn(env, "actuator_gainprm", 0)
    assert 0.8 - 1e-4 <= stiffness.min() < 0.82 < 1.18 < stiffness.max() <= 1.2 + 1e-4
    assert stiffness.std(dim=1).min() > 0.01, "each motor has its own, as before"


def test_rotors_and_friction_differ(randomized):
    env = randomized(64, armature=(0.5, 2.0), joint_friction=0.3)
    joints = slice(6, None)  # After the free joint.
    armature = drawn(env, "dof_armature", joints)
    torch.testing.assert_close(armature, armature[:, :1].expand(-1, 12))
    assert 0.5 - 1e-4 <= armature.min() < 0.6 < 1.8 < armature.max() <= 2.0 + 1e-4
    friction = env.sim.model.dof_frictionloss[:, joints]
    assert 0.0 <= friction.min() < 0.01 < 0.29 < friction.max() <= 0.3
    assert friction.std(dim=1).min() > 0.01, "each joint has its own"
    assert (env.sim.model.dof_frictionloss[:, :6] == 0.0).all()


def test_torque_follows_each_robots_curve(randomized):
    env = randomized(64, no_load_speed=(0.5, 1.5))
    nominal = torch.tensor([30.1, 30.1, 20.06]).repeat(4)  # The vendor's.
    order = env.sim.mj_model.actuator_trnid[:, 0] - 1
    multiple = env.motors.no_load_speed / nominal[order]
    torch.testing.assert_close(multiple, multiple[:, :1].expand(-1, 12))
    assert 0.5 <= multiple.min() < 0.6 < 1.4 < multiple.max() <= 1.5


def test_weak_motors_are_slower(randomized):
    speeds = []
    for ranges in ({}, {"no_load_speed": (0.3, 0.3)}):
        env = randomized(8, **ranges)
        env.sim.data.qpos[:, 2] += 1.0  # In the air, where nothing but motors moves joints.
        env.step(torch.full((8, 12), 4.8))
        speeds.append(env.sim.data.qvel[:, 6:].abs().mean())
    assert speeds[1] < 0.8 * speeds[0]


@pytest.mark.parametrize("fused", [True, False])
def test_delay_is_constant_in_an_episode(fused, build):
    cfg = flat_env_cfg(play=True)
    # A metric that is looked at between physics steps keeps them apart.
    cfg.metrics["lin_vel_reward"].per_substep = not fused
    randomize(cfg, action_delay=0.02)
    cfg.terminations = {"time_out": cfg.terminations["time_out"]}
    cfg.episode_length_s = 0.2
    env = build(cfg, 64)
    assert (env.cfg.decimation == 1) == fused
    episodes = []
    for step in range(30):  # Three episodes.
        if step % 10 == 0:
            episodes.append(env.motors.lag.clone())
        assert torch.equal(env.motors.lag, episodes[-1])
        env.step(torch.zeros(64, 12))
    for lag in episodes:
        assert set(lag.unique().tolist()) == {0, 1, 2, 3, 4}
        assert (lag == lag[:, :1]).all(), "all joints of a robot alike"
    assert not torch.equal(episodes[0], episodes[1])
    assert not torch.equal(episodes[1], episodes[2])


def test_delay_shifts_motion(randomized):
    """A step of targets that comes four physics steps late is the one of 20 ms before."""
    env = randomized(2, action_delay=0.02)
    env.motors.lag[:] = torch.tensor([[0], [4]])
    for field in env.sim.expanded_fields:
        values = getattr(env.sim.model, field)
        if values.numel():
            values[:] = values[:1].clone()
    env.sim.data.qpos[:, 2] += 1.0  # In the air, where nobody touches anything.
    env.sim.data.qpos[1] = env.sim.data.qpos[0]
    env.sim.data.qvel[:] = 0.0
    joints = []
    for action in (*[0.0] * 8, 1.0, 1.0):  # They come to rest first.
        env.step(torch.full((2, 12), action))
        joints.append(env.sim.data.qpos[:, 7:].clone())
    *_, first, second = [after - before for before, after in pairwise(joints)]
    assert first[0].abs().min() > 0.05
    assert first[1].abs().max() < 0.02
    torch.testing.assert_close(second[1], first[0], atol=0.02, rtol=0.1)


@pytest.mark.parametrize(
    "motors", [{"target_delay": (0.02, 0.01)}, {"no_load_speed": (0.0, 1.0)}], ids=str
)
def test_empty_ranges_are_refused(motors):
    cfg = flat_env_cfg()
    for name, value in motors.items():
        setattr(cfg.motors, name, value)
    with pytest.raises(RenetError, match=next(iter(motors))):
        make_env(cfg, 1)
