"""What happens to robots during an episode."""

import torch


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
