"""Randomisation that is off by default: what it changes, and by how much."""

import pytest
import torch

from renet.interface import proprioception_slices
from renet.tasks import env_cfg, make_env
from renet.tasks.parkour_env_cfg import RandomizationCfg, randomize


def randomized(robots: int, **ranges: float):
    """Robots that stand still on a plane unless randomisation moves them."""
    cfg = env_cfg("Renet-Go1-Flat", play=True)
    randomize(cfg, RandomizationCfg(**ranges))
    env = make_env(cfg, robots)
    env.reset()
    return env


def test_nothing_is_randomised_by_default():
    plain, same = env_cfg("Renet-Go1-Flat"), env_cfg("Renet-Go1-Flat")
    randomize(same, RandomizationCfg())
    assert plain.events.keys() == same.events.keys()
    assert plain.scene.entities["robot"].articulation == same.scene.entities["robot"].articulation


def test_motors_differ_in_strength():
    env = randomized(64, motor_strength=0.2)
    limits = env.sim.model.actuator_forcerange[:, :, 1]
    ratio = limits / env.sim.get_default_field("actuator_forcerange")[:, 1]
    assert 0.8 - 1e-4 <= ratio.min() < 0.82
    assert 1.18 < ratio.max() <= 1.2 + 1e-4
    # The strongest command is cut off at each motor's own limit.
    env.step(torch.full((64, 12), 20.0))
    force = env.sim.data.actuator_force[:].abs()
    assert (force <= limits + 1e-3).all()
    assert ((force - limits).abs() < 1e-3).any()
    env.close()


def test_joint_zeros_are_off_in_what_is_seen_and_in_what_is_done():
    env = randomized(16, joint_offset=0.03)
    offset = env.scene["robot"].data.encoder_bias
    assert 0.02 < offset.abs().max() <= 0.03
    seen = env.step(torch.zeros(16, 12))[0]["proprioception"]
    data = env.scene["robot"].data
    true = data.joint_pos - data.default_joint_pos
    torch.testing.assert_close(seen[:, proprioception_slices()["joint_position"]], true + offset)
    torch.testing.assert_close(data.joint_pos_target, data.default_joint_pos - offset)
    env.close()


@pytest.mark.parametrize("delay", [0.0, 0.02])
def test_actions_arrive_late(delay):
    env = randomized(32, action_delay=delay)
    for step in range(20):
        env.step(torch.full((32, 12), 1.0 if step % 2 else -1.0))
        moved = env.sim.mj_model.actuator_trnid[:, 0] - 1  # After the free joint.
        target = env.scene["robot"].data.joint_pos_target[:, moved]
        arrived = (env.sim.data.ctrl[:] - target).abs() < 1e-5
        if delay == 0.0:
            assert arrived.all()
        elif step > 2 and not arrived.all():
            assert arrived.any(), "some delays are shorter"
            break
    else:
        assert delay == 0.0, "no action was late"
    env.close()
