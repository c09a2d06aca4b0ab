"""Every term gives what an independent implementation gave for the same states.

`recorded_terms.npz` was written by the same terms as Warp kernels, one robot at a time (commit
708420f): four scattered states of twelve robots, three of which begin an episode before the last.
"""

from pathlib import Path

import numpy as np
import pytest
import torch

from renet.interface import PROPRIOCEPTION
from renet.tasks import env_cfg, make_env, mdp

from .conftest import scatter

RECORDED = np.load(Path(__file__).with_name("recorded_terms.npz"))


@pytest.fixture(scope="module")
def evaluated() -> dict[str, np.ndarray]:
    """All terms in all states, by the names of the recording."""
    cfg = env_cfg("Renet-Go1-Parkour-Paper")
    cfg.rewards = env_cfg("Renet-Go1-Parkour").rewards | {"yaw": cfg.rewards["yaw"]}
    env = make_env(cfg, 12)
    env.reset()
    terrain = env.scene.terrain
    terrain.terrain_levels[:] = torch.arange(12) % 10
    terrain.env_origins[:] = terrain.terrain_origins[terrain.terrain_levels, terrain.terrain_types]
    for cfg in env.reward_manager._term_cfgs:
        cfg.weight = 1.0
    generator = torch.Generator().manual_seed(0)
    states = []
    for state in range(4):
        if state == 3:
            for manager in (env.termination_manager, env.reward_manager):
                manager.reset(torch.tensor([0, 5, 6]))
        scatter(env, generator)
        env.episode_length_buf[:] = torch.arange(12) + env.max_episode_length - 5
        states.append({name: value.numpy().copy() for name, value in terms(env).items()})
    env.close()
    return {name: np.stack([state[name] for state in states]) for name in states[0]}


def terms(env) -> dict[str, torch.Tensor]:
    """All terms in the present state."""
    ends, rewards, metrics = env.termination_manager, env.reward_manager, env.metrics_manager
    ends.compute()
    env.reward_buf = rewards.compute(dt=env.step_dt)
    metrics.compute()
    goal = env.command_manager.get_term("goal")
    goal.time_left[:] = 10.0
    goal.compute(dt=0.0)
    seen = env.observation_manager.compute(update_history=True)
    scale = torch.tensor([term.scale for term in PROPRIOCEPTION for _ in range(term.size)])
    values = {"reward": (rewards, rewards._step_reward), "metric": (metrics, metrics._step_values)}
    return {
        **{f"termination/{name}": ends.get_term(name) for name in ends.active_terms},
        **{
            f"{kind}/{name}": columns[:, number]
            for kind, (manager, columns) in values.items()
            for number, name in enumerate(manager.active_terms)
        },
        "costs": mdp.constraint_costs(env),
        "observation/proprioception": seen["proprioception_clean"] / scale,
        "observation/velocity": seen["velocity"],
        "observation/feet_contact": seen["privileged"][:, :4],
        "observation/difficult": seen["difficult"],
    }


@pytest.mark.parametrize("name", [name for name in RECORDED.files if "violated" not in name])
def test_terms_give_what_was_recorded(evaluated, name):
    np.testing.assert_allclose(
        evaluated[name].astype(float), RECORDED[name].astype(float), rtol=1e-5, atol=1e-5
    )
