"""N-P3O against hand-computed numbers and a problem with a known constrained optimum."""

import numpy as np
import pytest
import torch

from renet.errors import RenetError
from renet.models.actor_critic import Actor, Critics
from renet.models.config import ModelCfg
from renet.models.symmetry import Mirror
from renet.training import distributed, np3o
from renet.training.config import NP3OCfg
from renet.training.storage import PolicyRollout


def test_reward_surrogate_by_hand():
    ratio, advantage = torch.tensor([1.5, 0.5, 1.0]), torch.tensor([1.0, -1.0, 2.0])
    # min(1.5, 1.2) + min(-0.5, -0.8) + 2.0
    loss = np3o.reward_surrogate(ratio, advantage, 0.2).item()
    assert loss == pytest.approx(-(1.2 - 0.8 + 2.0) / 3)


def test_cost_surrogate_takes_the_pessimistic_side():
    ratio, advantage = torch.tensor([1.5, 0.5]), torch.tensor([[1.0, -1.0], [-1.0, 1.0]])
    loss = np3o.cost_surrogate(ratio, advantage, 0.2)
    # column 0: max(1.5, 1.2), max(-0.5, -0.8); column 1: max(-1.5, -1.2), max(0.5, 0.8)
    assert loss.tolist() == pytest.approx([(1.5 - 0.5) / 2, (-1.2 + 0.8) / 2])


def test_violation_by_hand():
    value = np3o.violation(*(torch.tensor([x]) for x in (5.0, 1.0, 0.2, 2.0)), gamma=0.9)
    assert value.item() == pytest.approx((0.1 * (5.0 - 1.0) + 0.2) / 2.0)


def test_advantages_match_a_plain_loop():
    random = np.random.default_rng(0)
    rewards_and_costs, value = random.normal(size=(2, 6, 3, 2))
    last, done = random.normal(size=(3, 2)), random.random((6, 3)) < 0.3
    gamma, lam = 0.9, 0.8
    expected = np.zeros_like(rewards_and_costs)
    for env in range(3):
        for column in range(2):
            for start in range(6):
                weight, total = 1.0, 0.0
                for t in range(start, 6):
                    follow = last[env, column] if t == 5 else value[t + 1, env, column]
                    follow = 0.0 if done[t, env] else gamma * follow
                    delta = rewards_and_costs[t, env, column] + follow - value[t, env, column]
                    total += weight * delta
                    if done[t, env]:
                        break
                    weight *= gamma * lam
                expected[start, env, column] = total
    got = np3o.advantages(*map(torch.tensor, (rewards_and_costs, value, last, done)), gamma, lam)
    np.testing.assert_allclose(got, expected, atol=1e-12)


def small(initial_std: float = 1.0, **settings) -> np3o.NP3O:
    """Of networks that learn quickly."""
    hidden = dict.fromkeys(("actor_hidden", "critic_hidden", "cost_critic_hidden"), (16,))
    cfg = ModelCfg(**hidden, initial_std=initial_std)
    return np3o.NP3O(Actor(cfg), Critics(cfg, 4), NP3OCfg(**settings))


def random_rollout(
    algorithm: np3o.NP3O, steps: int = 10, robots: int = 3, noise: float = 1.0
) -> tuple[PolicyRollout, torch.Tensor]:
    """What networks answer to noise of a standard deviation, and values after the last step."""

    def draw(*shape: int) -> torch.Tensor:
        return noise * torch.randn(steps, robots, *shape)

    proprioception, latent, critic_observation = draw(45), draw(128), draw(4)
    with torch.no_grad():
        policy = algorithm.actor.distribution(proprioception, latent)
        action = policy.sample()
        value = algorithm.critics(critic_observation)
    rollout = PolicyRollout(
        proprioception=proprioception,
        latent=latent,
        mirrored_latent=draw(128),
        critic_observation=critic_observation,
        action=action,
        log_prob=policy.log_prob(action).sum(-1),
        mean=policy.mean,
        value=value,
        rewards_and_costs=draw(4),
        done=draw() > 1.5,
    )
    return rollout, noise * torch.randn(robots, 4)


def asymmetry(actor: Actor) -> float:
    """Mean square by which actions in the mirror differ from mirrored actions."""
    mirror, proprioception, latent = Mirror("cpu"), torch.randn(500, 45), torch.zeros(500, 128)
    with torch.no_grad():
        action = actor(proprioception, latent)
        in_mirror = actor(mirror.proprioception(proprioception), latent)
    return (in_mirror - mirror.action(action)).square().mean().item()


@pytest.mark.parametrize(("weight", "most", "least"), [(0.0, 2.0, 0.5), (10.0, 0.2, 0.0)])
def test_mirror_loss_makes_both_sides_alike(weight, most, least):
    torch.manual_seed(0)
    algorithm = small(mirror_loss=weight, learning_rate=1e-2, entropy=0.0, desired_kl=0.0)
    before = asymmetry(algorithm.actor)
    for iteration in range(20):
        rollout, last = random_rollout(algorithm, steps=50)
        # The loss alone moves the policy, of which memory tells nothing.
        for nothing in (rollout.latent, rollout.mirrored_latent, rollout.value, last):
            nothing.zero_()
        rollout.rewards_and_costs.zero_()
        algorithm.update(rollout, last, algorithm.draw_orders(rollout), iteration)
    assert least <= asymmetry(algorithm.actor) / before < most


def bandit(algorithm: np3o.NP3O, iterations: int) -> float:
    """One-step episodes: reward -|a - 2|^2, first cost relu(a0 - 1); returns the final mean a0.

    The unconstrained optimum is a = 2 everywhere; the constraint binds a0 alone, to 1 or less.
    """
    for iteration in range(iterations):
        rollout, last = random_rollout(algorithm, 1, 512, noise=0.0)
        reward = -((rollout.action - 2.0) ** 2).sum(-1)
        rollout.rewards_and_costs[..., 0] = reward
        rollout.rewards_and_costs[..., 1] = torch.relu(rollout.action[..., 0] - 1.0)
        rollout.done[:] = True
        algorithm.update(rollout, last, algorithm.draw_orders(rollout), iteration)
    return random_rollout(algorithm, noise=0.0)[0].mean[0, 0, 0].item()


@pytest.mark.parametrize(("weight", "low", "high"), [(4.0, 0.5, 1.15), (0.0, 1.7, 2.3)])
def test_constraint_binds_unlike_plain_ppo(weight, low, high):
    torch.manual_seed(0)
    steps = {"learning_rate": 1e-2, "num_learning_epochs": 2, "num_mini_batches": 2}
    algorithm = small(initial_std=0.3, cost_weight=weight, entropy=0.0, desired_kl=0.0, **steps)
    assert low < bandit(algorithm, 100) < high


def test_critics_keep_their_rate():
    # Hardly any step is as small as this divergence: the actor's rate falls.
    algorithm = small(desired_kl=1e-9)
    bandit(algorithm, 2)
    actor, critics = (group["lr"] for group in algorithm.optimizer.param_groups)
    assert float(actor) == algorithm.learning_rate < 1e-3
    assert critics == NP3OCfg().critic_learning_rate


def test_a_satisfied_constraint_contributes_nothing():
    torch.manual_seed(0)
    algorithm = small(cost_budget=(1e6, 1e6, 1e6))
    targets = np3o.make_targets(*random_rollout(algorithm), algorithm.cfg)
    cost = np3o.cost_surrogate(torch.full((30,), 1.1), targets.cost_advantage, algorithm.cfg.clip)
    assert torch.relu(cost + targets.violation).sum() == 0.0


def test_noisy_critic_leaves_actor_step():
    moved = []
    for noise in (0.0, 1e4):
        torch.manual_seed(0)
        algorithm = small(num_learning_epochs=1, num_mini_batches=1)
        rollout, last = random_rollout(algorithm)
        targets = np3o.make_targets(rollout, last, algorithm.cfg)
        targets.value_target += noise
        deviation = algorithm.actor.log_std.detach().exp()
        losses = algorithm._step(rollout.flatten(), targets, torch.arange(30), deviation)
        moved.append(list(algorithm.actor.parameters()))
    assert losses["critics_grad_norm"] > 100 * losses["actor_grad_norm"]
    assert all(torch.equal(a, b) for a, b in zip(*moved, strict=True))


def test_entropy_divergence_and_budgets_follow_their_schedules():
    algorithm = small(
        entropy="0.01@0,0.0@10M",
        desired_kl="0.01@0,0.02@10M",
        cost_budget=("0@0,4@10M", 1.0, "2"),
        num_learning_epochs=1,
    )
    rollout, last = random_rollout(algorithm)
    late, early = (np3o.make_targets(rollout, last, algorithm.cfg, steps) for steps in (5e6, 0))
    gap = (early.violation - late.violation) * torch.tensor([1.0, 0.0, 0.0])
    torch.testing.assert_close(early.violation - late.violation, gap)
    assert gap[0] > 0
    algorithm.update(rollout, last, algorithm.draw_orders(rollout), 0, steps=5e6)
    assert algorithm._entropy == pytest.approx(0.005)
    assert algorithm._desired_kl == pytest.approx(0.015)


@pytest.mark.parametrize(
    ("limit", "begun", "free"),
    [
        ({"entropy": 1.0, "max_std": "0.4@0,0.2@10M"}, 0.5, 0.05),
        # A finished policy explores again.
        ({"min_std": "0.4@0,0.2@10M"}, 0.1, 0.6),
    ],
)
def test_deviation_of_actions_keeps_to_its_schedule(limit, begun, free):
    algorithm = small(initial_std=begun, num_learning_epochs=1, **limit)
    rollout, last = random_rollout(algorithm)
    # One joint's deviation is within the limit already: it stays free.
    with torch.no_grad():
        algorithm.actor.log_std[0] = np.log(free)
    algorithm.update(rollout, last, algorithm.draw_orders(rollout), 0, steps=5e6)
    std = algorithm.actor.log_std.detach().exp()
    torch.testing.assert_close(std[1:], torch.full((11,), 0.3))
    assert std[0].item() == pytest.approx(free, rel=0.1)


def test_negative_deviation_is_refused():
    with pytest.raises(RenetError, match=r"min_std must be at least 0"):
        np3o.NP3OCfg(min_std=-0.1)


@pytest.mark.parametrize("limit", [0.0, "-0.1@0,0.2@1M"])
def test_deviation_of_nothing_is_refused(limit):
    with pytest.raises(RenetError, match=r"max_std must be above 0"):
        np3o.NP3OCfg(max_std=limit)


def test_clipped_value_loss_by_hand():
    value, old, target = torch.tensor([[3.0], [1.1]]), torch.zeros(2, 1), torch.tensor([[3.0], [0]])
    # 3 is clipped to 0.2, which is worse: (0.2 - 3)^2; 1.1 to 0.2, which is better: 1.1^2 counts.
    loss = np3o.clipped_value_loss(value, old, target, 0.2)
    assert loss.item() == pytest.approx((2.8**2 + 1.1**2) / 2)


@pytest.mark.parametrize(("weight", "most"), [(0.1, 1.0), (3.0, 3.0)])
def test_penalty_grows_to_one(weight, most):
    algorithm = small(cost_weight=weight, cost_weight_growth=1.5, num_learning_epochs=1)
    rollout, last = random_rollout(algorithm)
    weights = []
    for iteration in range(12):
        algorithm.update(rollout, last, algorithm.draw_orders(rollout), iteration)
        weights.append(algorithm.cost_weight)
    assert weights == sorted(weights)
    assert weights[-1] == most


@pytest.mark.parametrize(
    ("kl", "factor"), [(0.0, 1.0), (-1e-9, 1.0), (0.001, 1.5), (0.01, 1.0), (0.03, 1 / 1.5)]
)
def test_rate_follows_divergence(kl, factor):
    """Zero is that of a first step, whose policy is the old one."""
    algorithm = small(desired_kl=0.01)
    algorithm._desired_kl, before = 0.01, algorithm.learning_rate
    algorithm._adapt_rate(torch.tensor(kl))
    assert algorithm.learning_rate == pytest.approx(factor * before)


def test_a_step_learns_from_its_transitions_alone():
    learnt = []
    for other in (0.0, torch.nan):
        torch.manual_seed(0)
        # Budgets below zero: every constraint pushes.
        algorithm = small(cost_budget=(-10.0, -10.0, -10.0))
        rollout, last = random_rollout(algorithm)
        targets = np3o.make_targets(rollout, last, algorithm.cfg)
        batch = rollout.flatten()
        for tensor in (*vars(batch).values(), targets.reward_advantage, targets.cost_advantage):
            if tensor.is_floating_point():
                tensor[15:] += other
        targets.value_target[15:] += other
        deviation = algorithm.actor.log_std.detach().exp()
        algorithm._step(batch, targets, torch.arange(15), deviation)
        learnt.append(algorithm.parameters)
    assert all(torch.equal(*pair) for pair in zip(*learnt, strict=True))


@pytest.mark.parametrize("kl", [0.0, 0.03])
def test_rate_stays_without_a_desired_divergence(kl):
    algorithm = small(learning_rate=1e-3, desired_kl=0.0)
    algorithm._adapt_rate(torch.tensor(kl))
    assert algorithm.learning_rate == pytest.approx(1e-3)


def test_learns_where_its_networks_are():
    """Not on the default device."""
    algorithm = small()
    rollout, last = random_rollout(algorithm)
    with torch.device("meta"):
        targets = np3o.make_targets(rollout, last, algorithm.cfg)
        orders = algorithm.draw_orders(rollout)
    assert targets.violation.device == rollout.value.device
    assert all(order.device == rollout.value.device for order in orders)


def test_ranks_that_see_alike_learn_as_one_process(monkeypatch):
    def learnt() -> list[torch.nn.Parameter]:
        torch.manual_seed(0)
        algorithm = small(num_learning_epochs=1)
        rollout, last = random_rollout(algorithm)
        algorithm.update(rollout, last, algorithm.draw_orders(rollout), 0)
        return algorithm.parameters

    alone = learnt()
    sums = []

    def add_the_other_rank(total: torch.Tensor) -> None:
        total.mul_(2)
        sums.append(total.numel())

    monkeypatch.setattr(distributed, "world_size", lambda: 2)
    monkeypatch.setattr(distributed.dist, "all_reduce", add_the_other_rank)
    assert all(torch.equal(*pair) for pair in zip(learnt(), alone, strict=True))
    assert sum(parameter.numel() for parameter in alone) in sums, "gradients are averaged"
