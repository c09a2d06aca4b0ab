"""Actor, reward critic and one critic per constraint cost."""

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.distributions import Normal

from renet.interface import ACTION_SIZE, CONSTRAINTS, LATENT, PROPRIOCEPTION_SIZE
from renet.models.config import ModelCfg


def mlp(sizes: Sequence[int]) -> nn.Sequential:
    """Linear layers with ELU between them."""
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(sizes):
        layers += [nn.Linear(inputs, outputs), nn.ELU(inplace=True)]
    return nn.Sequential(*layers[:-1])


class Actor(nn.Module):
    """Gaussian policy over joint-position actions with a state-independent deviation."""

    def __init__(self, cfg: ModelCfg) -> None:
        super().__init__()
        self.mean = mlp((PROPRIOCEPTION_SIZE + 2 * LATENT, *cfg.actor_hidden, ACTION_SIZE))
        self.log_std = nn.Parameter(torch.full((ACTION_SIZE,), cfg.initial_std).log())
        # A small last layer starts the policy at the default pose.
        with torch.no_grad():
            self.mean[-1].weight.mul_(0.1)  # type: ignore[operator]

    def forward(self, proprioception: Tensor, latent: Tensor) -> Tensor:
        """Mean action [B, 12] from o_t [B, 45] and h [B, 128]."""
        return self.mean(torch.cat((proprioception, latent), dim=-1))

    def distribution(self, proprioception: Tensor, latent: Tensor) -> Normal:
        """Action distribution; independent over joints."""
        return self._around(self(proprioception, latent))

    def log_prob(self, mean: Tensor, action: Tensor) -> Tensor:
        """Log density [...] of actions [..., 12] drawn around a mean."""
        return self._around(mean).log_prob(action).sum(-1)

    def _around(self, mean: Tensor) -> Normal:
        return Normal(mean, self.log_std.exp(), validate_args=False)


class Critics(nn.Module):
    """Values of the reward and of every constraint cost: [B, inputs] to [B, 1 + constraints]."""

    def __init__(self, cfg: ModelCfg, inputs: int) -> None:
        super().__init__()
        self.reward = mlp((inputs, *cfg.critic_hidden, 1))
        self.costs = nn.ModuleList(mlp((inputs, *cfg.cost_critic_hidden, 1)) for _ in CONSTRAINTS)

    def forward(self, observation: Tensor) -> Tensor:
        """Column 0 is the reward's value, then interface.CONSTRAINTS in order."""
        values = [self.reward(observation), *(critic(observation) for critic in self.costs)]
        return torch.cat(values, dim=-1)
