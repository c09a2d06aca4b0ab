"""What is read off MuJoCo's arrays is what mjlab derives from quaternions."""

import pytest
import torch

from renet.tasks import mdp
from renet.tasks.mdp.base_state import base_heading, base_position, base_velocity


def check(env) -> None:
    data = env.scene["robot"].data
    for got, expected in (
        (base_position(env), data.root_link_pos_w),
        (base_velocity(env), data.root_link_lin_vel_w),
        (base_heading(env), data.heading_w),
        (mdp.velocity(env), data.root_link_lin_vel_b),
    ):
        torch.testing.assert_close(got, expected, atol=2e-5, rtol=1e-5)


@pytest.mark.parametrize("engine", ["native", "warp"])
def test_base_state_matches_mjlab(build, engine):
    env, random = build("Renet-Go1-Flat", 3, engine=engine), torch.Generator().manual_seed(0)
    check(env)
    for _ in range(3):
        env.step(torch.randn(3, 12, generator=random))
        check(env)
    state = torch.randn(3, 13, generator=random)
    state[:, 3:7] /= state[:, 3:7].norm(dim=-1, keepdim=True)
    env.scene["robot"].write_root_state_to_sim(state)
    env.sim.forward()
    check(env)
    env.reset(env_ids=torch.tensor([1]))
    check(env)
