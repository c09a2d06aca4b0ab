"""How much of the actor's gradient is signal, for several lambdas of the advantage estimate.

A checkpoint's robots walk on, and the gradients of two random halves of them are compared, scaled
as Adam scales them. Robots are independent, so the halves' scalar product is the signal's squared
length, and what a half's own squared length has beyond it is noise. `signal` is the share of the
signal; `agreement` the cosine between a lambda's signal and that of the first, noise taken out:
below 1 the critics' errors bend the gradient.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

import torch
import tyro
from rich.progress import track
from torch import Tensor

from facts import report
from renet.interface import CONSTRAINTS
from renet.training import checkpoint as checkpoints
from renet.training.np3o import advantages
from renet.training.runner import RenetRunner
from renet.training.storage import PolicyRollout
from renet.training.train import TrainCfg, resolve_resume, restored, train

COLUMNS = ("reward", *CONSTRAINTS)
SPLITS = 3
"""Random halves compared in a rollout."""
CLEAR = 0.05
"""Signal below which an agreement would be noise."""


@dataclass
class Cfg:
    run: tyro.conf.Positional[str]
    """Run folder or checkpoint."""
    lambdas: tuple[float, ...] = (0.95, 0.9, 0.8, 0.7)
    """Compared with the first."""
    steps: int = 100
    """Control steps of each robot in a rollout."""
    rollouts: int = 5
    """After three that let the robots disperse."""
    json: Path | None = None
    """Write the results to this file."""


class Probe(RenetRunner):
    """Collects rollouts in place of learning."""

    cfg_: ClassVar[Cfg]
    results: ClassVar[list[dict[str, Any]]]

    def learn(self, *_: Any, **__: Any) -> None:
        cfg, algorithm = self.cfg_, self.alg
        length = self.env.episode_length_buf
        self.env.episode_length_buf = torch.randint_like(length, int(self.env.max_episode_length))
        obs = self.env.get_observations()
        algorithm.train_mode()
        sums: dict[tuple[str, float], Tensor] = defaultdict(lambda: torch.zeros(3))
        for number in track(range(3 + cfg.rollouts), "rollouts"):
            for _ in range(cfg.steps):
                obs, rewards, dones, extras = self.env.step(algorithm.act(obs))
                algorithm.process_env_step(obs, rewards, dones, extras)
            algorithm.compute_returns(obs)
            algorithm._ticks.stack()  # Forgets them.
            if number >= 3:
                self._compare(algorithm._rollout, sums)
        for name in dict.fromkeys(name for name, _ in sums):
            first, own, _ = sums[name, cfg.lambdas[0]]
            for lam in cfg.lambdas:
                both, mine, cross = sums[name, lam]
                clear = min(both / mine, first / own) > CLEAR
                agreement = round((cross / (both * first).sqrt()).item(), 2) if clear else None
                row = {"of": name, "lambda": lam, "signal": round((both / mine).item(), 3)}
                row["agreement"] = agreement
                Probe.results.append(row)
                print(f"{name:<24} {lam:<6} {row['signal']:>6} {agreement or '-':>6}")

    def _compare(self, rollout: PolicyRollout, sums: dict[tuple[str, float], Tensor]) -> None:
        """Add the halves' products: with one another, themselves, and the first lambda's."""
        np3o, terrain = self.alg.np3o, self.env.unwrapped.scene.terrain
        of = {
            lam: advantages(
                rollout.rewards_and_costs,
                rollout.value,
                self.alg._last_value,
                rollout.done,
                np3o.cfg.gamma,
                lam,
            )
            for lam in self.cfg_.lambdas
        }
        everybody = torch.ones(rollout.done.shape[1])
        parts = [(name, column, everybody) for column, name in enumerate(COLUMNS)]
        for kind, tile in enumerate(terrain.cfg.terrain_generator.sub_terrains):
            parts.append((f"reward on {tile}", 0, (terrain.terrain_types == kind).float()))
        for _ in range(SPLITS):
            halves = torch.randperm(len(everybody)).chunk(2)
            for name, column, chosen in parts:
                reference: list[Tensor] = []
                for lam, advantage in of.items():
                    score = advantage[..., column]
                    score = (score - score.mean()) / score.std() * chosen
                    a, b = (self._gradient(rollout, score, half) for half in halves)
                    reference = reference or [a, b]
                    cross = (a @ reference[1] + b @ reference[0]) / 2
                    sums[name, lam] += torch.stack((a @ b, (a @ a + b @ b) / 2, cross))

    def _gradient(self, rollout: PolicyRollout, score: Tensor, robots: Tensor) -> Tensor:
        """Gradient of the surrogate at the policy that acted, but for the action noise's part."""
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


@dataclass(kw_only=True)
class ProbeCfg(TrainCfg):
    runner: ClassVar[type[RenetRunner]] = Probe


def main(cfg: Cfg) -> None:
    found = resolve_resume(cfg.run, None, "")
    state = checkpoints.load_state(found)
    own = {k: v for k, v in vars(restored(state)).items() if k != "resume"}
    Probe.cfg_, Probe.results = cfg, []
    with TemporaryDirectory() as folder:
        train(replace(ProbeCfg(**own), resume=str(found), log_root=Path(folder)))
    half = cfg.steps * own["num_envs"] // 2
    report({"steps": state["steps"], "half": half, "rows": Probe.results}, cfg.json)


if __name__ == "__main__":
    torch.manual_seed(0)
    main(tyro.cli(Cfg))
