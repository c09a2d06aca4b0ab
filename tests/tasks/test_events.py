"""What happens to robots during an episode: pushes, and the clipping of their rewards."""

import torch

from renet.tasks import env_cfg, make_env


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
