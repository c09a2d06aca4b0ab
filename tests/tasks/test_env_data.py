"""What is derived once is what mjlab derives each time, and never old."""

from __future__ import annotations

from contextlib import redirect_stdout
from io import StringIO

import pytest
import torch
from mjlab.entity import EntityData

from renet.tasks import make_env
from renet.tasks.env_data import DerivedOnce

DERIVED = [name for name, value in vars(DerivedOnce).items() if isinstance(value, property)]


@pytest.fixture(scope="module")
def env():
    with redirect_stdout(StringIO()):
        made = make_env("Renet-Go1-Flat", 3, seed=2)
    yield made
    made.close()


def test_each_quantity_is_mjlabs_after_steps_resets_and_states_written(env):
    robot = env.scene["robot"]
    assert len(DERIVED) == 6
    assert isinstance(robot.data, DerivedOnce)
    random = torch.Generator().manual_seed(0)

    def check() -> None:
        for name in DERIVED:
            assert torch.equal(
                getattr(robot.data, name), getattr(EntityData, name).fget(robot.data)
            )

    env.reset()
    check()
    before = {name: getattr(robot.data, name) for name in DERIVED}
    for _ in range(3):
        env.step(torch.randn(3, 12, generator=random))
        check()
    assert not any(torch.equal(before[name], getattr(robot.data, name)) for name in DERIVED)
    state = torch.cat((robot.data.root_link_pose_w, robot.data.root_link_vel_w), dim=-1).clone()
    state[:, 2] += 1.0
    robot.write_root_state_to_sim(state)
    check()
    env.sim.forward()
    check()
    assert torch.allclose(robot.data.root_link_pose_w[:, 2], state[:, 2])
    env.reset(env_ids=torch.tensor([1]))
    check()


def test_terms_share_what_one_run_of_the_engine_gives(env):
    data = env.scene["robot"].data
    env.step(torch.zeros(3, 12))
    first = data.projected_gravity_b
    assert data.projected_gravity_b is first
    env.step(torch.zeros(3, 12))
    assert data.projected_gravity_b is not first
