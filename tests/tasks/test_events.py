"""Pushes: whom, when, and how hard."""

from __future__ import annotations

from itertools import pairwise

import pytest
import torch

from renet.tasks.events import Push

from .conftest import build


@pytest.fixture
def pushed():
    """Robots on a plane, and their pushes: every 0.1 to 0.2 s, up to 0.5 m/s."""
    env = build("Renet-Go1-Flat", 64)
    env.reset()
    (term,) = env.event_manager._mode_term_cfgs["step"]
    assert isinstance(term.func, Push)
    yield env, lambda: term.func(env, None, 0.5, (0.1, 0.2))
    env.close()


def test_each_robot_is_pushed_sideways_at_its_own_time(pushed):
    env, push = pushed
    velocity, times = env.sim.data.qvel, [[] for _ in range(64)]
    for step in range(40):
        before = velocity[:].clone()
        push()
        change = velocity[:] - before
        assert (change[:, 2:] == 0.0).all(), "only along x and y"
        assert change.abs().max() <= 0.5
        for robot in change[:, 0].nonzero().flatten().tolist():
            times[robot].append(step)
    waits = [b - a for steps in times for a, b in pairwise(steps)]
    # 0.1 to 0.2 s end within the sixth to tenth step, at a start as later.
    assert {6, 10} <= set(waits) <= set(range(6, 12))
    assert {6, 10} <= {steps[0] for steps in times} <= set(range(6, 12))
    assert len({steps[0] for steps in times}) > 3


def test_an_episode_begins_without_a_push(pushed):
    env, push = pushed
    for _ in range(4):
        push()
    env.event_manager.reset(torch.arange(32))
    before = env.sim.data.qvel[:].clone()
    for _ in range(5):
        push()
    changed = (env.sim.data.qvel[:] != before).any(-1)
    assert not changed[:32].any()
    assert changed[32:].any()
