"""What happens to robots during an episode: pushes, and the clipping of their rewards."""

import pytest
import torch

from renet.tasks import env_cfg, make_env


@pytest.fixture(scope="module")
def pushed():
    """64 robots that are pushed every 0.1 to 0.2 s."""
    cfg = env_cfg("Renet-Go1-Flat")
    assert cfg.events["push"].interval_range_s == (6.0, 10.0)
    cfg.events["push"].interval_range_s = (0.1, 0.2)
    env = make_env(cfg, 64)
    yield env
    env.close()


def push(env, steps: int) -> torch.Tensor:
    """Changes of the bases' velocities by pushes alone, [steps, N, 6] m/s and rad/s."""
    changes = []
    for _ in range(steps):
        env.sim.forward()
        before = env.sim.data.qvel[:].clone()
        env.event_manager.apply(mode="interval", dt=0.02)
        changes.append((env.sim.data.qvel[:] - before)[:, :6])
    return torch.stack(changes)


def test_each_robot_is_pushed_sideways_at_its_own_time(pushed):
    pushed.reset(seed=1)
    changes = push(pushed, 10)
    assert 0.4 < changes[..., :2].abs().max() <= 0.5 + 1e-5
    assert changes[..., 2:].abs().max() < 1e-4, "only along x and y"
    hit = changes[..., :2].abs().amax(-1) > 1e-4
    assert hit.any(0).all()
    assert not hit[:4].any(), "an episode begins without a push"
    assert len(set(hit.int().argmax(0).tolist())) > 3


def test_a_step_never_pays_less_than_nothing_and_how_often_it_would_is_logged():
    cfg = env_cfg("Renet-Go1-Flat")
    cfg.events.pop("push")
    for name, term in cfg.rewards.items():
        term.weight = {"linear_velocity": 1.5, "action_rate": -100.0}.get(name, 0.0)
    envs = [make_env(cfg, 3, seed=2)]
    cfg.events.pop("clip_reward")
    envs.append(make_env(cfg, 3, seed=2))
    for env in envs:
        env.reset(seed=3)
    for action in (torch.ones(3, 12), torch.ones(3, 12), torch.zeros(3, 12)):
        clipped, summed = (env.step(action)[1] for env in envs)
        torch.testing.assert_close(clipped, summed.clamp_min(0.0))
        if action[0, 0] == 0.0 or envs[0].common_step_counter == 1:
            assert (summed < 0.0).all(), "actions changed"
    logged = envs[0].metrics_manager.reset()
    negative = envs[1].metrics_manager.reset()["Episode_Metrics/reward_clipped"]
    assert logged["Episode_Metrics/reward_clipped"] == negative
    assert negative >= 2 / 3
