"""What is read off MuJoCo's arrays is what mjlab derives from quaternions."""

from __future__ import annotations

import pytest
import torch
from mjlab.entity import EntityData

from renet.tasks.env_data import FloatingBase

from .conftest import build

READ = [
    name
    for name, value in vars(FloatingBase).items()
    if isinstance(value, property) and not name.startswith("_")
]


@pytest.fixture(scope="module", params=["native", "warp"])
def env(request):
    made = build("Renet-Go1-Flat", 3, seed=2, engine=request.param)
    yield made
    made.close()


def check(data: FloatingBase) -> None:
    for name in READ:
        expected = getattr(EntityData, name).fget(data)
        torch.testing.assert_close(getattr(data, name), expected, atol=2e-5, rtol=1e-5)


def test_each_quantity_is_mjlabs_after_steps_resets_and_states_written(env):
    robot = env.scene["robot"]
    assert len(READ) == 6
    assert isinstance(robot.data, FloatingBase)
    random = torch.Generator().manual_seed(0)
    env.reset()
    check(robot.data)
    for _ in range(3):
        env.step(torch.randn(3, 12, generator=random))
        check(robot.data)
    state = torch.randn(3, 13, generator=random)
    state[:, 3:7] /= state[:, 3:7].norm(dim=-1, keepdim=True)
    robot.write_root_state_to_sim(state)
    env.sim.forward()
    check(robot.data)
    env.reset(env_ids=torch.tensor([1]))
    check(robot.data)


def test_what_was_read_stays_when_the_engine_runs_on(env):
    data = env.scene["robot"].data
    env.reset()
    before = {name: getattr(data, name) for name in READ}
    copies = {name: value.clone() for name, value in before.items()}
    for _ in range(3):
        env.step(torch.ones(3, 12))
    for name in READ:
        assert torch.equal(before[name], copies[name])
        assert not torch.equal(before[name], getattr(data, name))
