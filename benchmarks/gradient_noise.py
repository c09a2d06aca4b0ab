"""What a checkpoint's actor and critics learn from, for several lambdas of the advantage estimate.

Its robots walk on. Gradients of two random halves of them are compared, scaled as Adam scales them:
robots are independent, so the halves' scalar product is the signal's squared length, and what a
half's own squared length has beyond it is noise. `signal` is the share of the signal; `agreement`
the cosine between a lambda's signal and that of the first, noise taken out: below 1 the critics'
errors bend the gradient. `explained` is the share of the returns' variance that a critic explains,
`cost` a constraint's discounted return and `violation` how far it is above its budget (V of N-P3O:
above 0 its penalty is on whatever the policy does).
"""

from __future__ import annotations

from collections import defaultdict
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path

import torch
import tyro
from mjlab.rl import RslRlVecEnvWrapper
from rich.progress import track
from torch import Tensor

from facts import report
from renet.interface import CONSTRAINTS
from renet.tasks import make_env
from renet.tasks.robot_cfg import ACTION_CLIP
from renet.training import checkpoint as checkpoints
from renet.training.np3o import Targets, make_targets
from renet.training.runner import RenetRunner
from renet.training.storage import PolicyRollout
from renet.training.train import resolve_resume, restored, settings, task_cfg

COLUMNS = ("reward", *CONSTRAINTS)
SETTLING = 3
"""Rollouts in which robots disperse, before those that count."""
SPLITS = 3
"""Random halves compared in a rollout."""
CLEAR = 0.05
"""Signal below which an agreement would be noise."""


@dataclass
class Cfg:
    run: tyro.conf.Positional[str]
    """Run folder or checkpoint."""
    lambdas: tuple[float, ...] = (0.95, 0.8)
    """Compared with the first."""
    steps: int = 100
    """Control steps of each robot in a rollout."""
    rollouts: int = 4
    """That count."""
    json: Path | None = None
    """Write the results to this file."""


class Measurement:
    """Sums over rollouts of what every lambda makes of them."""

    def __init__(self, cfg: Cfg, runner: RenetRunner) -> None:
        self.cfg, self.alg = cfg, runner.alg
        terrain = runner.env.unwrapped.scene.terrain
        tiles = terrain.cfg.terrain_generator.sub_terrains
        everybody = torch.ones(runner.env.num_envs)
        self.parts = [(name, column, everybody) for column, name in enumerate(COLUMNS)]
        for kind, tile in enumerate(tiles):
            self.parts.append((f"reward on {tile}", 0, (terrain.terrain_types == kind).float()))
        self.products = defaultdict[tuple[str, float], Tensor](lambda: torch.zeros(3))
        """Of the halves' gradients with one another, themselves, and the first lambda's."""
        self.critics = defaultdict[float, Tensor](lambda: torch.zeros(3, len(COLUMNS)))
        """Explained, return and violation of each column; the reward has no violation."""

    def add(self, rollout: PolicyRollout) -> None:
        np3o, last = self.alg.np3o.cfg, self.alg._last_value
        of = {
            lam: make_targets(rollout, last, replace(np3o, lam=lam), self.alg.steps)
            for lam in self.cfg.lambdas
        }
        for lam, targets in of.items():
            errors = targets.value_target - rollout.value.flatten(0, 1)
            explained = 1.0 - errors.var(0) / targets.value_target.var(0)
            violation = torch.cat((torch.zeros(1), targets.violation))
            self.critics[lam] += torch.stack((explained, targets.value_target.mean(0), violation))
        shape = rollout.done.shape
        for _ in range(SPLITS):
            halves = torch.randperm(shape[1]).chunk(2)
            for name, column, chosen in self.parts:
                reference: list[Tensor] = []
                for lam, targets in of.items():
                    score = normalised(targets, column).view(shape) * chosen
                    a, b = (self._gradient(rollout, score, half) for half in halves)
                    reference = reference or [a, b]
                    cross = (a @ reference[1] + b @ reference[0]) / 2
                    self.products[name, lam] += torch.stack((a @ b, (a @ a + b @ b) / 2, cross))

    def _gradient(self, rollout: PolicyRollout, score: Tensor, robots: Tensor) -> Tensor:
        """Of the surrogate at the policy that acted, without the action noise's deviation."""
        actor, state = self.alg.model.actor, self.alg.np3o.optimizer.state
        of = lambda rows: rows[:, robots].flatten(0, 1)  # noqa: E731
        distribution = actor.distribution(of(rollout.proprioception), of(rollout.latent))
        log_prob = distribution.log_prob(of(rollout.action)).sum(-1)
        weights = [p for p in actor.parameters() if p is not actor.log_std]
        gradients = torch.autograd.grad(-(log_prob * of(score)).mean(), weights)
        scaled = [
            g / (state[p]["exp_avg_sq"].sqrt() + 1e-8)
            for g, p in zip(gradients, weights, strict=True)
        ]
        return torch.cat([g.flatten() for g in scaled])

    def rows(self) -> list[dict[str, float | str | None]]:
        rows = []
        for (name, lam), (both, own, cross) in self.products.items():
            first, its_own, _ = self.products[name, self.cfg.lambdas[0]]
            row = {"of": name, "lambda": lam, "signal": (both / own).item()}
            clear = min(both / own, first / its_own) > CLEAR
            row["agreement"] = (cross / (both * first).sqrt()).item() if clear else None
            if name in COLUMNS:
                means = self.critics[lam][:, COLUMNS.index(name)] / self.cfg.rollouts
                named = zip(("explained", "return", "violation"), means.tolist(), strict=True)
                row |= dict(list(named)[: 2 if name == "reward" else 3])
            rows.append({k: round(v, 3) if isinstance(v, float) else v for k, v in row.items()})
        return rows


def normalised(targets: Targets, column: int) -> Tensor:
    """Advantages of a column as N-P3O takes them, [T * N]."""
    return targets.reward_advantage if column == 0 else targets.cost_advantage[:, column - 1]


def collect(runner: RenetRunner, steps: int) -> PolicyRollout:
    """A rollout of the policy, which learns nothing from it."""
    env, algorithm = runner.env, runner.alg
    obs = env.get_observations()
    for _ in range(steps):
        obs, rewards, dones, extras = env.step(algorithm.act(obs))
        algorithm.process_env_step(obs, rewards, dones, extras)
    algorithm.compute_returns(obs)
    algorithm._ticks.stack()  # Forgets them.
    return algorithm._rollout


def main(cfg: Cfg) -> None:
    found = resolve_resume(cfg.run, None, "")
    recipe = restored(checkpoints.load_state(found))
    with redirect_stdout(StringIO()):
        env = make_env(task_cfg(recipe), recipe.num_envs, "cpu", engine=recipe.engine)
        runner = RenetRunner(RslRlVecEnvWrapper(env, clip_actions=ACTION_CLIP), settings(recipe))
    runner.load(str(found))
    env.episode_length_buf = torch.randint_like(env.episode_length_buf, env.max_episode_length)
    runner.alg.model.train()
    measurement = Measurement(cfg, runner)
    for number in track(range(SETTLING + cfg.rollouts), "rollouts", transient=True):
        rollout = collect(runner, cfg.steps)
        if number >= SETTLING:
            measurement.add(rollout)
    rows = measurement.rows()
    for row in rows:
        print("  ".join(f"{name} {value}" for name, value in row.items()))
    half = cfg.steps * env.num_envs // 2
    report({"steps": runner.alg.steps, "half": half, "rows": rows}, cfg.json)


if __name__ == "__main__":
    torch.manual_seed(0)
    main(tyro.cli(Cfg))
