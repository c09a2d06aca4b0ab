"""N-P3O: first-order constrained policy optimisation (Lee et al. 2023, arXiv 2309.15430).

The reward part is PPO. Each constraint i adds a penalty kappa * relu(L_i + V_i), in which L_i is
the clipped surrogate of its normalised cost advantage and V_i the distance of its cost return from
its budget, on the same scale. A constraint that is kept adds nothing.
"""

import math
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor, nn
from torch.distributions import Normal, kl_divergence

from renet.models.actor_critic import Actor, Critics
from renet.models.symmetry import Mirror
from renet.tasks.schedule import value_at
from renet.training import distributed
from renet.training.config import NP3OCfg
from renet.training.precision import compute_in, side_by_side
from renet.training.storage import PolicyRollout

STD_FLOOR = 1e-3
"""Smallest standard deviation by which an advantage is divided. Below it, a cost advantage is noise
of the critic, which must not be amplified."""
LEARNING_RATES = (1e-5, 1e-2)
"""Smallest and largest learning rate of the actor."""


def advantages(
    rewards_and_costs: Tensor,
    value: Tensor,
    last_value: Tensor,
    done: Tensor,
    gamma: float,
    lam: float,
) -> Tensor:
    """Compute generalised advantage estimates of each column (Schulman et al. 2016).

    Args:
        rewards_and_costs: Reward and costs of each step, [T, N, K].
        value: Values of the states before each step, [T, N, K].
        last_value: Values of the states after the last step, [N, K].
        done: True where a step ended its episode, [T, N] bool. No value is carried across such a
            step.
        gamma: Discount per step.
        lam: Lambda of the estimator.

    Returns:
        Advantages, [T, N, K]. Returns are the sum of these and `value`.
    """
    result = torch.empty_like(rewards_and_costs)
    advantage = torch.zeros_like(last_value)
    next_value = last_value
    for step in reversed(range(rewards_and_costs.shape[0])):
        # 1 where the episode goes on after this step, 0 where it ends with it.
        alive = (~done[step]).unsqueeze(-1).to(rewards_and_costs.dtype)
        # TD error: r_t + gamma * V(s_{t+1}) - V(s_t).
        delta = rewards_and_costs[step] + gamma * alive * next_value - value[step]
        # Advantage: delta_t + gamma * lambda * A_{t+1}.
        advantage = delta + gamma * lam * alive * advantage
        result[step] = advantage
        next_value = value[step]
    return result


def reward_surrogate(ratio: Tensor, advantage: Tensor, clip: float) -> Tensor:
    """Compute PPO's clipped loss, a scalar to be minimised; ratio and advantage are [B]."""
    clipped_ratio = ratio.clamp(1.0 - clip, 1.0 + clip)
    return -torch.min(ratio * advantage, clipped_ratio * advantage).mean()


def cost_surrogate(ratio: Tensor, advantage: Tensor, clip: float) -> Tensor:
    """Compute L_i of each constraint, [K], from ratio [B] and normalised advantages [B, K]."""
    ratio = ratio.unsqueeze(-1)
    clipped_ratio = ratio.clamp(1.0 - clip, 1.0 + clip)
    return torch.max(ratio * advantage, clipped_ratio * advantage).mean(0)


def violation(
    cost_return: Tensor, budget: Tensor, mean: Tensor, std: Tensor, gamma: float
) -> Tensor:
    """Compute V_i = ((1 - gamma)(J_i - d_i) + mu_i) / sigma_i; all tensors are [K]."""
    return ((1.0 - gamma) * (cost_return - budget) + mean) / std


def clipped_value_loss(value: Tensor, old: Tensor, target: Tensor, clip: float) -> Tensor:
    """Compute PPO's clipped value loss, summed over columns; all tensors are [B, K]."""
    clipped_value = old + (value - old).clamp(-clip, clip)
    return torch.max((value - target) ** 2, (clipped_value - target) ** 2).mean(0).sum()


@dataclass
class Targets:
    """Targets of the networks in one rollout of B = T * N transitions."""

    reward_advantage: Tensor
    """Normalised advantages of the reward, [B]."""
    cost_advantage: Tensor
    """Normalised advantages of the costs, [B, K]."""
    violation: Tensor
    """V_i of each constraint, [K]."""
    value_target: Tensor
    """Returns of the reward and of the costs, [B, 1 + K]."""


def make_targets(
    rollout: PolicyRollout, last_value: Tensor, cfg: NP3OCfg, steps: float = 0.0
) -> Targets:
    """Compute the targets of a rollout; means and deviations span all ranks.

    Args:
        rollout: The transitions.
        last_value: Values of the states after the last step, [N, 1 + K].
        cfg: Discount, lambda and budgets.
        steps: Environment steps taken before the rollout, for budgets that follow a schedule.
    """
    advantage = advantages(
        rollout.rewards_and_costs, rollout.value, last_value, rollout.done, cfg.gamma, cfg.lam
    ).flatten(0, 1)
    value_target = advantage + rollout.value.flatten(0, 1)

    # Means and deviations with which the advantages are normalised; column 0 is the reward's.
    mean, variance = distributed.moments(advantage)
    std = variance.sqrt().clamp_min(STD_FLOOR)

    # The costs' returns are compared with their budgets.
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
    """Optimisation of actor and critics; holds their optimizer, learning rate and penalty."""

    def __init__(
        self, actor: Actor, critics: Critics, cfg: NP3OCfg, dtype: torch.dtype = torch.float32
    ) -> None:
        """Initialize the optimizer.

        Args:
            actor: The policy, on the device where it learns.
            critics: The value functions, on the same device.
            cfg: Settings of the algorithm.
            dtype: Type in which the critics compute while they learn.
        """
        self.actor = actor
        self.critics = critics
        self.cfg = cfg
        self.dtype = dtype
        self.parameters = [*actor.parameters(), *critics.parameters()]
        self._mirror = Mirror(self.parameters[0].device)
        self.cost_weight = cfg.cost_weight
        # Values of schedules, set at the beginning of each update.
        self._entropy = 0.0
        self._desired_kl = 0.0
        # A tensor, so that adapting it on a GPU does not wait for the divergence on the host.
        rate = torch.tensor(cfg.learning_rate, device=self.parameters[0].device)
        groups = [
            {"params": list(actor.parameters()), "lr": rate},
            {"params": list(critics.parameters()), "lr": cfg.critic_learning_rate},
        ]
        self.optimizer = torch.optim.Adam(groups, fused=True)

    @property
    def learning_rate(self) -> float:
        """Current learning rate of the actor."""
        return self._rate.item()

    @learning_rate.setter
    def learning_rate(self, rate: float) -> None:
        self._rate.fill_(rate)

    @property
    def _rate(self) -> Tensor:
        """Learning rate of the actor as the optimizer holds it, a scalar."""
        return self.optimizer.param_groups[0]["lr"]

    def draw_orders(self, rollout: PolicyRollout) -> list[Tensor]:
        """Draw the order of a rollout's transitions in each epoch, each [T * N]."""
        transitions = rollout.log_prob.numel()
        device = rollout.log_prob.device
        epochs = self.cfg.num_learning_epochs
        return [torch.randperm(transitions, device=device) for _ in range(epochs)]

    def update(
        self,
        rollout: PolicyRollout,
        last_value: Tensor,
        orders: list[Tensor],
        iteration: int,
        steps: float = 0.0,
    ) -> dict[str, Tensor]:
        """Learn from one rollout. On a GPU nothing here waits for the device.

        This method draws no random numbers: on a CPU supervision draws its own at the same time.

        Args:
            rollout: The transitions.
            last_value: Values of the states after the last step, [N, 1 + K].
            orders: Order of the transitions in each epoch (see `draw_orders`).
            iteration: Number of updates before this one, with which the penalty grows.
            steps: Environment steps taken before the rollout, for settings that follow a schedule.

        Returns:
            Mean losses over all gradient steps, by name.
        """
        self._entropy = value_at(self.cfg.entropy, steps)
        self._desired_kl = value_at(self.cfg.desired_kl, steps)
        self._grow_penalty(iteration)
        targets = make_targets(rollout, last_value, self.cfg, steps)
        batch = rollout.flatten()
        # The deviation is no function of the state: all transitions were drawn with the same one.
        old_std = self.actor.log_std.detach().exp()

        # Take one gradient step for each mini-batch of each epoch.
        history: list[dict[str, Tensor]] = []
        with compute_in(self.dtype, self.critics):
            for order in orders:
                for index in order.chunk(self.cfg.num_mini_batches):
                    history.append(self._step(batch, targets, index, old_std))
        # Only now: until here the ratios compare with the deviation of the rollout.
        largest = math.inf if self.cfg.max_std is None else value_at(self.cfg.max_std, steps)
        self.actor.limit_std(value_at(self.cfg.min_std, steps), largest)

        # Average the losses over gradient steps.
        losses = {}
        for name in history[0]:
            losses[name] = torch.stack([step[name] for step in history]).mean()
        weight = torch.full((), self.cost_weight, dtype=torch.float64, device=old_std.device)
        losses["cost_weight"] = weight
        return losses

    def _grow_penalty(self, iteration: int) -> None:
        """Multiply the penalty by a factor that grows with the iteration, up to a weight of 1."""
        limit = max(self.cfg.cost_weight, 1.0)
        growth = self.cfg.cost_weight_growth**iteration
        self.cost_weight = min(limit, self.cost_weight * growth)

    def _step(
        self, batch: PolicyRollout, targets: Targets, index: Tensor, old_std: Tensor
    ) -> dict[str, Tensor]:
        """Take one gradient step on the transitions in `index`; returns losses by name."""
        # Compute the gradients of actor and critics, which share no parameter.
        self.optimizer.zero_grad()
        policy_losses, value_losses = side_by_side(
            partial(self._policy_gradient, batch, targets, index, old_std),
            partial(self._value_gradient, batch, targets, index),
        )

        # Average them over ranks, and clip each network's on its own.
        distributed.average_gradients(self.parameters)
        limit = self.cfg.max_grad_norm
        actor_norm = nn.utils.clip_grad_norm_(self.actor.parameters(), limit)
        critics_norm = nn.utils.clip_grad_norm_(self.critics.parameters(), limit)

        # Adapt the learning rate before the step, as rsl_rl does.
        kl = distributed.mean(policy_losses.pop("kl"))
        self._adapt_rate(kl)
        self.optimizer.step()
        return {
            **policy_losses,
            **value_losses,
            "actor_grad_norm": actor_norm,
            "critics_grad_norm": critics_norm,
            "kl": kl,
            # A copy: the next gradient step changes the rate in place.
            "learning_rate": self._rate.clone(),
        }

    def _policy_gradient(
        self, batch: PolicyRollout, targets: Targets, index: Tensor, old_std: Tensor
    ) -> dict[str, Tensor]:
        """Compute the actor's gradients; returns losses, and the divergence from the old policy."""
        # Compare the probabilities of the actions with those at collection.
        distribution = self.actor.distribution(batch.proprioception[index], batch.latent[index])
        log_prob = distribution.log_prob(batch.action[index]).sum(-1)
        ratio = torch.exp(log_prob - batch.log_prob[index])

        # Reward: PPO's clipped surrogate.
        surrogate = reward_surrogate(ratio, targets.reward_advantage[index], self.cfg.clip)

        # Costs: relu(L_i + V_i). Its sign is that of all ranks' mean, so that a constraint is
        # active on all ranks or on none.
        cost = cost_surrogate(ratio, targets.cost_advantage[index], self.cfg.clip)
        excess = cost + targets.violation
        active = distributed.mean(cost.detach()) + targets.violation > 0
        penalty = self.cost_weight * (active * excess).sum()

        # Entropy bonus.
        entropy = distribution.entropy().sum(-1).mean()

        losses = {"surrogate": surrogate, "cost": penalty, "entropy": entropy}
        loss = surrogate + penalty - self._entropy * entropy
        if self.cfg.mirror_loss > 0.0:
            losses["mirror"] = self._mirror_loss(batch, index, distribution.mean)
            loss = loss + self.cfg.mirror_loss * losses["mirror"]

        loss.backward()
        with torch.no_grad():
            old = Normal(batch.mean[index], old_std, validate_args=False)
            losses["kl"] = kl_divergence(old, distribution).sum(-1).mean()
        return {name: value.detach() for name, value in losses.items()}

    def _mirror_loss(self, batch: PolicyRollout, index: Tensor, mean: Tensor) -> Tensor:
        """Compute the mean square by which actions in the mirror differ from mirrored actions.

        Args:
            batch: The transitions.
            index: Those of the mini-batch, [B].
            mean: Mean actions of the mini-batch, [B, 12].
        """
        proprioception = self._mirror.proprioception(batch.proprioception[index])
        in_mirror = self.actor(proprioception, batch.mirrored_latent[index])
        # The mirrored action is the target, to which no gradient goes back: each side learns from
        # the other in turn.
        return (in_mirror - self._mirror.action(mean.detach())).square().mean()

    def _value_gradient(
        self, batch: PolicyRollout, targets: Targets, index: Tensor
    ) -> dict[str, Tensor]:
        """Compute the critics' gradients; returns their loss."""
        value = self.critics(batch.critic_observation[index])
        old = batch.value[index]
        target = targets.value_target[index]
        loss = clipped_value_loss(value, old, target, self.cfg.clip)
        (self.cfg.value_loss * loss).backward()
        return {"value": loss.detach()}

    def _adapt_rate(self, kl: Tensor) -> None:
        """Adapt the actor's learning rate to the KL divergence of a step, as rsl_rl does.

        The rate falls where the divergence is more than twice the desired one, and rises where it
        is less than half of it.
        """
        if self._desired_kl <= 0:
            return
        low, high = LEARNING_RATES
        rate = self._rate
        lower = (rate / 1.5).clamp_min(low)
        higher = (rate * 1.5).clamp_max(high)
        small = (kl > 0.0) & (kl < 0.5 * self._desired_kl)
        large = kl > 2.0 * self._desired_kl
        # In place and without branches, so that the host does not wait for a GPU.
        rate.copy_(torch.where(large, lower, torch.where(small, higher, rate)))
