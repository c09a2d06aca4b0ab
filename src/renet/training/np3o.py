"""N-P3O: first-order constrained policy optimisation (Lee et al. 2023, arXiv 2309.15430).

The reward part is PPO. Each constraint adds kappa_i * relu(L_i + V_i): L_i is the clipped surrogate
of its normalised cost advantage, V_i how far its cost return is above budget in the same scale.
A satisfied constraint contributes nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.distributions import Normal, kl_divergence

from renet.models.actor_critic import Actor, Critics
from renet.training import distributed
from renet.training.config import NP3OCfg
from renet.training.returns import advantages
from renet.training.storage import PolicyRollout

STD_FLOOR = 1e-3
"""Below this spread a cost advantage is critic noise, not evidence, and is not amplified."""
LEARNING_RATES = (1e-5, 1e-2)


def reward_surrogate(ratio: Tensor, advantage: Tensor, clip: float) -> Tensor:
    """PPO's clipped loss, to be minimised; ratio and advantage are [B]."""
    clipped = ratio.clamp(1.0 - clip, 1.0 + clip)
    return -torch.min(ratio * advantage, clipped * advantage).mean()


def cost_surrogate(ratio: Tensor, advantage: Tensor, clip: float) -> Tensor:
    """L_i of each constraint, [K], from ratio [B] and normalised cost advantages [B, K]."""
    ratio = ratio.unsqueeze(-1)
    clipped = ratio.clamp(1.0 - clip, 1.0 + clip)
    return torch.max(ratio * advantage, clipped * advantage).mean(0)


def violation(
    cost_return: Tensor, budget: Tensor, mean: Tensor, std: Tensor, gamma: float
) -> Tensor:
    """V_i = ((1 - gamma)(J_i - d_i) + mu_i) / sigma_i, all [K]."""
    return ((1.0 - gamma) * (cost_return - budget) + mean) / std


def clipped_value_loss(value: Tensor, old: Tensor, target: Tensor, clip: float) -> Tensor:
    """Sum over columns of PPO's clipped value loss; all [B, K]."""
    clipped = old + (value - old).clamp(-clip, clip)
    return torch.max((value - target) ** 2, (clipped - target) ** 2).mean(0).sum()


@dataclass
class Targets:
    """What one rollout asks of the networks; rows are [T * N]."""

    reward_advantage: Tensor
    """[B], normalised."""
    cost_advantage: Tensor
    """[B, K], normalised."""
    violation: Tensor
    """[K]."""
    value_target: Tensor
    """[B, 1 + K]."""


def make_targets(rollout: PolicyRollout, last_value: Tensor, cfg: NP3OCfg) -> Targets:
    """Advantages, violations and returns of a rollout; statistics span all ranks."""
    advantage = advantages(
        rollout.payoff, rollout.value, last_value, rollout.done, cfg.gamma, cfg.lam
    ).flatten(0, 1)
    value_target = advantage + rollout.value.flatten(0, 1)
    mean, std = distributed.moments(advantage)
    std = std.clamp_min(STD_FLOOR)
    cost_return = distributed.mean(value_target[:, 1:].mean(0))
    budget = torch.tensor(cfg.cost_budget, device=advantage.device)
    return Targets(
        reward_advantage=(advantage[:, 0] - mean[0]) / std[0],
        cost_advantage=(advantage[:, 1:] - mean[1:]) / std[1:],
        violation=violation(cost_return, budget, mean[1:], std[1:], cfg.gamma),
        value_target=value_target,
    )


class NP3O:
    """Optimises actor and critics on rollouts; owns their optimiser, rate and penalties."""

    def __init__(self, actor: Actor, critics: Critics, cfg: NP3OCfg) -> None:
        self.actor, self.critics, self.cfg = actor, critics, cfg
        self.parameters = [*actor.parameters(), *critics.parameters()]
        self.learning_rate = cfg.learning_rate
        self.cost_weight = cfg.cost_weight
        self.optimizer = torch.optim.Adam(self.parameters, lr=cfg.learning_rate)

    def update(
        self, rollout: PolicyRollout, last_value: Tensor, iteration: int
    ) -> dict[str, float]:
        """Learn from one rollout; returns mean losses by name."""
        targets = make_targets(rollout, last_value, self.cfg)
        batch = rollout.flatten()
        growth = self.cfg.cost_weight_growth**iteration
        self.cost_weight = min(max(self.cfg.cost_weight, 1.0), self.cost_weight * growth)
        # Every transition of a rollout was drawn with the same deviation.
        old_std = self.actor.log_std.detach().exp()
        totals: dict[str, Tensor] = {}
        steps = 0
        for _ in range(self.cfg.num_learning_epochs):
            order = torch.randperm(batch.log_prob.shape[0], device=batch.log_prob.device)
            for index in order.chunk(self.cfg.num_mini_batches):
                for name, value in self._step(batch, targets, index, old_std).items():
                    totals[name] = totals.get(name, 0.0) + value
                steps += 1
        losses = {name: float(total / steps) for name, total in totals.items()}
        return losses | {"cost_weight": self.cost_weight}

    def _step(
        self, batch: PolicyRollout, targets: Targets, index: Tensor, old_std: Tensor
    ) -> dict[str, Tensor]:
        """One gradient step on the rows in `index`."""
        distribution = self.actor.distribution(batch.proprioception[index], batch.latent[index])
        log_prob = distribution.log_prob(batch.action[index]).sum(-1)
        ratio = torch.exp(log_prob - batch.log_prob[index])
        surrogate = reward_surrogate(ratio, targets.reward_advantage[index], self.cfg.clip)
        cost = cost_surrogate(ratio, targets.cost_advantage[index], self.cfg.clip)
        penalty = self.cost_weight * torch.relu(cost + targets.violation).sum()
        value_loss = clipped_value_loss(
            self.critics(batch.critic_observation[index]),
            batch.value[index],
            targets.value_target[index],
            self.cfg.clip,
        )
        entropy = distribution.entropy().sum(-1).mean()
        kl = self._adapt_rate(Normal(batch.mean[index], old_std, validate_args=False), distribution)
        loss = surrogate + penalty + self.cfg.value_loss * value_loss - self.cfg.entropy * entropy
        self.optimizer.zero_grad()
        loss.backward()
        distributed.average_gradients(self.parameters)
        nn.utils.clip_grad_norm_(self.parameters, self.cfg.max_grad_norm)
        self.optimizer.step()
        losses = {"surrogate": surrogate, "cost": penalty, "value": value_loss, "entropy": entropy}
        return {name: value.detach() for name, value in losses.items()} | {"kl": kl}

    @torch.no_grad()
    def _adapt_rate(self, old: Normal, new: Normal) -> Tensor:
        """Keep the KL divergence per step near its target, as rsl_rl does."""
        kl = distributed.mean(kl_divergence(old, new).sum(-1).mean())
        if self.cfg.desired_kl > 0:
            if kl > 2.0 * self.cfg.desired_kl:
                self.learning_rate = max(LEARNING_RATES[0], self.learning_rate / 1.5)
            elif 0.0 < kl < 0.5 * self.cfg.desired_kl:
                self.learning_rate = min(LEARNING_RATES[1], self.learning_rate * 1.5)
            for group in self.optimizer.param_groups:
                group["lr"] = self.learning_rate
        return kl
