"""A tiny environment with RENet's observation groups, and runners that learn in it."""

from dataclasses import asdict
from types import SimpleNamespace

import pytest
import torch
from tensordict import TensorDict

from renet.interface import ACTION_SIZE, CONSTRAINTS
from renet.training import precision
from renet.training.algorithm import RenetAlgorithm
from renet.training.config import NP3OCfg, RenetRunnerCfg
from renet.training.runner import RenetRunner


@pytest.fixture(autouse=True)
def single_precision(monkeypatch):
    """Unless a test asks for bfloat16, results are the same on every machine."""
    monkeypatch.setattr(precision, "has_bfloat16", lambda device: False)


ONE_EPOCH = NP3OCfg(num_learning_epochs=1)


class ToyEnv:
    """Random observations; the reward asks for zero action, episodes end at random."""

    def __init__(self, num_envs: int = 8, seed: int = 0) -> None:
        self.num_envs, self.num_actions, self.device = num_envs, ACTION_SIZE, torch.device("cpu")
        self.max_episode_length = 50
        self.episode_length_buf = torch.zeros(num_envs, dtype=torch.long)
        self.cfg = {}
        self.random = torch.Generator().manual_seed(seed)
        self.time_outs = torch.zeros(num_envs)
        self.common_step_counter = 0
        # As far as runners ask mjlab's managers.
        self.costs, names = torch.zeros(num_envs, 3), [f"cost_{name}" for name in CONSTRAINTS]
        self.metrics_manager = SimpleNamespace(active_terms=names, _step_values=self.costs)
        self.goal = SimpleNamespace(stage=0)
        self.command_manager = SimpleNamespace(get_term=lambda _: self.goal)
        self.curriculum_manager = SimpleNamespace(active_terms=[])

    @property
    def unwrapped(self) -> "ToyEnv":
        return self

    def get_observations(self) -> TensorDict:
        def draw(*shape):
            return torch.rand(self.num_envs, *shape, generator=self.random)

        return TensorDict(
            {
                "proprioception": draw(45) - 0.5,
                "proprioception_clean": draw(45) - 0.5,
                "velocity": draw(3),
                "feet_height": draw(4),
                "height_map": draw(132),
                "far_map": draw(30),
                "privileged": draw(6),
                "depth": draw(48, 64).half(),
                "difficult": (torch.arange(self.num_envs) % 2).float().unsqueeze(-1),
            },
            batch_size=[self.num_envs],
        )

    def reset(self):
        return self.get_observations(), {}

    def step(self, actions):
        done = torch.rand(self.num_envs, generator=self.random) < 0.05
        reward = torch.exp(-actions.square().mean(-1))
        self.costs[:] = torch.relu(actions[:, : len(CONSTRAINTS)])
        self.common_step_counter += 1
        self.time_outs[:] = done  # Written anew each step, as mjlab does.
        extras = {"costs": self.costs.clone(), "time_outs": self.time_outs, "log": {}}
        return self.get_observations(), reward, done.long(), extras


def make_runner(env, folder=None, seed: int = 0, **settings) -> RenetRunner:
    """Untrained, with the same weights each time; curves and checkpoints go to `folder`."""
    torch.manual_seed(seed)
    short = {"num_steps_per_env": 10, "save_interval": 2, "algorithm": ONE_EPOCH}
    cfg = RenetRunnerCfg(**(short | settings))
    return RenetRunner(env, asdict(cfg), str(folder) if folder else None, "cpu")


def collect(alg: RenetAlgorithm, env, steps: int = 10) -> torch.Tensor:
    """Record a rollout; returns its rewards [T, N]."""
    rewards, obs = [], env.get_observations()
    for _ in range(steps):
        obs, reward, done, extras = env.step(alg.act(obs))
        alg.process_env_step(obs, reward, done, extras)
        rewards.append(reward)
    alg.compute_returns(obs)
    return torch.stack(rewards)
