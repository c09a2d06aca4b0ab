"""Actor, reward critic and one critic per constraint cost."""

import math
from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.distributions import Normal

from renet.interface import ACTION_SIZE, CONSTRAINTS, LATENT, PROPRIOCEPTION_SIZE
from renet.models.config import ModelCfg


def mlp(sizes: Sequence[int]) -> nn.Sequential:
    """Build linear layers with ELU between them; `sizes` are widths from input to output."""
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(sizes):
        layers += [nn.Linear(inputs, outputs), nn.ELU(inplace=True)]
    return nn.Sequential(*layers[:-1])


class Actor(nn.Module):
    """Gaussian policy over joint positions, whose deviation does not depend on the state."""

    def __init__(self, cfg: ModelCfg) -> None:
        super().__init__()
        self.mean = mlp((PROPRIOCEPTION_SIZE + 2 * LATENT, *cfg.actor_hidden, ACTION_SIZE))
        self.log_std = nn.Parameter(torch.full((ACTION_SIZE,), cfg.initial_std).log())
        # A small last layer starts the policy at the default pose.
        with torch.no_grad():
            self.mean[-1].weight.mul_(0.1)  # type: ignore[operator]

    def forward(self, proprioception: Tensor, latent: Tensor) -> Tensor:
        """Compute the mean action [B, 12] from o_t [B, 45] and h [B, 128]."""
        return self.mean(torch.cat((proprioception, latent), dim=-1))

    def distribution(self, proprioception: Tensor, latent: Tensor) -> Normal:
        """Compute the action distribution, which is independent over joints."""
        return self._around(self(proprioception, latent))

    def log_prob(self, mean: Tensor, action: Tensor) -> Tensor:
        """Compute log-probabilities [...] of actions [..., 12], given the policy's means."""
        return self._around(mean).log_prob(action).sum(-1)

    def limit_std(self, smallest: float, largest: float) -> None:
        """Clamp the standard deviations; where the limits contradict, the largest one holds."""
        low = math.log(smallest) if smallest > 0.0 else -math.inf
        with torch.no_grad():
            self.log_std.clamp_(low, math.log(largest))

    def _around(self, mean: Tensor) -> Normal:
        """Return the action distribution with a mean."""
        return Normal(mean, self.log_std.exp(), validate_args=False)


class Critics(nn.Module):
    """Values of the reward and of every constraint cost: [B, inputs] to [B, 1 + constraints]."""

    def __init__(self, cfg: ModelCfg, inputs: int) -> None:
        super().__init__()
        self.reward = mlp((inputs, *cfg.critic_hidden, 1))
        self.costs = nn.ModuleList(mlp((inputs, *cfg.cost_critic_hidden, 1)) for _ in CONSTRAINTS)

    def forward(self, observation: Tensor) -> Tensor:
        """Compute values; column 0 is the reward's, the others those of interface.CONSTRAINTS."""
        values = [self.reward(observation)]
        for critic in self.costs:
            values.append(critic(observation))
        return torch.cat(values, dim=-1)
