"""N-P3O: first-order constrained policy optimisation (Lee et al. 2023, arXiv 2309.15430).

The reward part is PPO. Each constraint adds kappa_i * relu(L_i + V_i): L_i is the clipped surrogate
of its normalised cost advantage, V_i how far its cost return is above budget in the same scale.
A satisfied constraint contributes nothing.
"""

from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor, nn
from torch.distributions import Normal, kl_divergence

from renet.models.actor_critic import Actor, Critics
from renet.training import distributed
from renet.training.config import NP3OCfg, value_at
from renet.training.precision import computed_in, side_by_side
from renet.training.storage import PolicyRollout

STD_FLOOR = 1e-3
"""Below this spread a cost advantage is critic noise, not evidence, and is not amplified."""
LEARNING_RATES = (1e-5, 1e-2)


def advantages(
    rewards_and_costs: Tensor,
    value: Tensor,
    last_value: Tensor,
    done: Tensor,
    gamma: float,
    lam: float,
) -> Tensor:
    """GAE of each column (Schulman et al. 2016), [T, N, K]; returns are these + value.

    Args:
        rewards_and_costs, value: [T, N, K]. last_value: [N, K], of the state after the last step.
        done: [T, N] bool; nothing is carried over the end of an episode.
    """
    result, running = torch.empty_like(rewards_and_costs), torch.zeros_like(last_value)
    next_value = last_value
    for step in reversed(range(rewards_and_costs.shape[0])):
        alive = (~done[step]).unsqueeze(-1).to(rewards_and_costs.dtype)
        delta = rewards_and_costs[step] + gamma * alive * next_value - value[step]
        running = delta + gamma * lam * alive * running
        result[step] = running
        next_value = value[step]
    return result


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


def make_targets(
    rollout: PolicyRollout, last_value: Tensor, cfg: NP3OCfg, steps: float = 0.0
) -> Targets:
    """Advantages, violations and returns of a rollout; statistics span all ranks."""
    advantage = advantages(
        rollout.rewards_and_costs, rollout.value, last_value, rollout.done, cfg.gamma, cfg.lam
    ).flatten(0, 1)
    value_target = advantage + rollout.value.flatten(0, 1)
    mean, variance = distributed.moments(advantage)
    std = variance.sqrt().clamp_min(STD_FLOOR)
    cost_return = distributed.mean(value_target[:, 1:].mean(0))
    budgets = [value_at(budget, steps) for budget in cfg.cost_budget]
    budget = torch.tensor(budgets, device=advantage.device)
    return Targets(
        reward_advantage=(advantage[:, 0] - mean[0]) / std[0],
        cost_advantage=(advantage[:, 1:] - mean[1:]) / std[1:],
        violation=violation(cost_return, budget, mean[1:], std[1:], cfg.gamma),
        value_target=value_target,
    )


class NP3O:
    """Optimises actor and critics on rollouts; owns their optimiser, rate and penalties."""

    def __init__(
        self, actor: Actor, critics: Critics, cfg: NP3OCfg, dtype: torch.dtype = torch.float32
    ) -> None:
        """Set up for networks that are where they are to stay; critics learn in `dtype`."""
        self.actor, self.critics, self.cfg, self.dtype = actor, critics, cfg, dtype
        self.parameters = [*actor.parameters(), *critics.parameters()]
        self._entropy = self._desired_kl = 0.0
        self.cost_weight = cfg.cost_weight
        # A tensor: adapting it on a GPU must not wait for the divergence to arrive on the host.
        rate = torch.tensor(cfg.learning_rate, device=self.parameters[0].device)
        groups = [
            {"params": list(actor.parameters()), "lr": rate},
            {"params": list(critics.parameters()), "lr": cfg.critic_learning_rate},
        ]
        self.optimizer = torch.optim.Adam(groups, fused=True)

    @property
    def learning_rate(self) -> float:
        """Current rate of the actor's Adam."""
        return self.optimizer.param_groups[0]["lr"].item()

    @learning_rate.setter
    def learning_rate(self, rate: float) -> None:
        self.optimizer.param_groups[0]["lr"].fill_(rate)

    def draw_orders(self, rollout: PolicyRollout) -> list[Tensor]:
        """The order in which each epoch takes a rollout's transitions, [T * N] each."""
        rows, device = rollout.log_prob.numel(), rollout.log_prob.device
        return [torch.randperm(rows, device=device) for _ in range(self.cfg.num_learning_epochs)]

    def update(
        self,
        rollout: PolicyRollout,
        last_value: Tensor,
        orders: list[Tensor],
        iteration: int,
        steps: float = 0.0,
    ) -> dict[str, Tensor]:
        """Learn from one rollout; mean losses by name. On a GPU nothing here waits for the device.

        No random number is drawn here: on a CPU, supervision draws its own meanwhile.

        Args:
            rollout: what the policy did. last_value: of the states after it, [N, 1 + K].
            orders: of its transitions, one for each epoch (`draw_orders`).
            iteration: with which the penalties' weight grows.
            steps: environment steps taken before the rollout, for `Schedule` settings.
        """
        self._entropy = value_at(self.cfg.entropy, steps)
        self._desired_kl = value_at(self.cfg.desired_kl, steps)
        targets = make_targets(rollout, last_value, self.cfg, steps)
        batch = rollout.flatten()
        growth = self.cfg.cost_weight_growth**iteration
        self.cost_weight = min(max(self.cfg.cost_weight, 1.0), self.cost_weight * growth)
        # Every transition of a rollout was drawn with the same deviation.
        old_std = self.actor.log_std.detach().exp()
        taken: list[dict[str, Tensor]] = []
        with computed_in(self.dtype, self.critics):
            for order in orders:
                for index in order.chunk(self.cfg.num_mini_batches):
                    taken.append(self._step(batch, targets, index, old_std))
        losses = {name: torch.stack([step[name] for step in taken]).mean() for name in taken[0]}
        weight = torch.full((), self.cost_weight, dtype=torch.float64, device=old_std.device)
        return losses | {"cost_weight": weight}

    def _step(
        self, batch: PolicyRollout, targets: Targets, index: Tensor, old_std: Tensor
    ) -> dict[str, Tensor]:
        """One gradient step on the rows in `index`."""
        self.optimizer.zero_grad()
        of_policy, of_value = side_by_side(
            partial(self._policy_gradient, batch, targets, index, old_std),
            partial(self._value_gradient, batch, targets, index),
        )
        distributed.average_gradients(self.parameters)
        clip = partial(nn.utils.clip_grad_norm_, max_norm=self.cfg.max_grad_norm)
        actor, critics = clip(self.actor.parameters()), clip(self.critics.parameters())
        kl = distributed.mean(of_policy.pop("kl"))
        self._adapt_rate(kl)
        self.optimizer.step()
        rate = self.optimizer.param_groups[0]["lr"].clone()
        norms = {"actor_grad_norm": actor, "critics_grad_norm": critics}
        return of_policy | of_value | norms | {"kl": kl, "learning_rate": rate}

    def _policy_gradient(
        self, batch: PolicyRollout, targets: Targets, index: Tensor, old_std: Tensor
    ) -> dict[str, Tensor]:
        """The actor's gradients; returns losses and the divergence from the old policy."""
        distribution = self.actor.distribution(batch.proprioception[index], batch.latent[index])
        log_prob = distribution.log_prob(batch.action[index]).sum(-1)
        ratio = torch.exp(log_prob - batch.log_prob[index])
        surrogate = reward_surrogate(ratio, targets.reward_advantage[index], self.cfg.clip)
        cost = cost_surrogate(ratio, targets.cost_advantage[index], self.cfg.clip)
        excess = cost + targets.violation
        exceeded = distributed.mean(cost.detach()) + targets.violation > 0  # On all ranks or none.
        penalty = self.cost_weight * (exceeded * excess).sum()
        entropy = distribution.entropy().sum(-1).mean()
        (surrogate + penalty - self._entropy * entropy).backward()
        losses = {"surrogate": surrogate, "cost": penalty, "entropy": entropy}
        with torch.no_grad():
            old = Normal(batch.mean[index], old_std, validate_args=False)
            losses["kl"] = kl_divergence(old, distribution).sum(-1).mean()
        return {name: value.detach() for name, value in losses.items()}

    def _value_gradient(
        self, batch: PolicyRollout, targets: Targets, index: Tensor
    ) -> dict[str, Tensor]:
        """The critics' gradients; returns their loss."""
        value = self.critics(batch.critic_observation[index])
        old, target = batch.value[index], targets.value_target[index]
        loss = clipped_value_loss(value, old, target, self.cfg.clip)
        (self.cfg.value_loss * loss).backward()
        return {"value": loss.detach()}

    def _adapt_rate(self, kl: Tensor) -> None:
        """Keep the actor's KL divergence per step near its target, as rsl_rl does."""
        if self._desired_kl > 0:
            rate, (low, high) = self.optimizer.param_groups[0]["lr"], LEARNING_RATES
            slower, faster = (rate / 1.5).clamp_min(low), (rate * 1.5).clamp_max(high)
            close = (kl > 0.0) & (kl < 0.5 * self._desired_kl)
            adapted = torch.where(close, faster, rate)
            rate.copy_(torch.where(kl > 2.0 * self._desired_kl, slower, adapted))
