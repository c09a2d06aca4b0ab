"""Rivals of renet's selector in the fault benchmark: other judges of the same bundle's camera.

`python benchmarks/judges.py oracle` knows which cameras fail, `gate` is a classifier of failing
cameras, `return` VB-Com's rule; both are trained first, on walks over single obstacles. With
`--withholds` images that the judge objects to are withheld, and VP goes on from memory; without, OP
drives meanwhile. Results are those of `renet evaluate benchmark`.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import torch
import tyro

from baselines.switches import Gate, ReturnSwitch, collect, fit
from baselines.withholding import RivalEvaluator
from renet.bundle import find_bundle
from renet.errors import RenetError
from renet.evaluation.benchmark.families import LIES, LOUD, level_at
from renet.evaluation.benchmark.study import BenchmarkStudy
from renet.evaluation.rollout import Trial
from renet.faults import FAULTS, Injection, PhysicalFault

SWITCHES = {"return": ReturnSwitch, "gate": Gate}
GROUNDS = {"gap": 6, "platform": 6, "stairs_up": 8, "stairs_down": 8}
"""Levels of the tiles that experience is collected on."""
HORIZON = 150
"""Control steps after which rewards hardly count."""


@dataclass
class Cfg:
    """Train a judge, if it learns, and run the benchmark with it."""

    judge: tyro.conf.Positional[Literal["oracle", "gate", "return"]]
    """oracle: knows. gate: a classifier. return: estimators of the return under vision and under
    blindness."""
    study: BenchmarkStudy
    """What is walked; by default in results/JUDGE or results/JUDGE_withholds."""
    withholds: bool = False
    """Withhold images rather than hand over to OP."""
    severity: int = 4
    """Severity of the faults it learns from: the benchmark's but those that act on the scene."""
    robots: int = 2
    """Robots for each fault and mode in training; each has a twin whose camera stays healthy."""
    steps: int = 500
    """Control steps of training's rollout; faults begin after a tenth."""
    epochs: int = 200
    """Passes over the rollout."""
    seed: int = 7
    """Seed of training."""

    def __post_init__(self) -> None:
        if self.judge == "return" and self.withholds:
            raise RenetError("VB-Com's rule compares policies: it can only hand over")
        if self.study.policy is not None:
            raise RenetError("a judge is of a bundle's camera: give --study.bundle, not a policy")
        if self.study.verify is not None:
            raise RenetError("no judge verifies a result: leave out --study.verify")
        if self.study.jobs > 1:
            raise RenetError("a judge walks in one process: leave out --study.jobs")
        if self.study.out == BenchmarkStudy.out:
            self.study = replace(self.study, out=Path(f"results/{self.name}"))
        if self.study.method is None:
            self.study = replace(self.study, method=find_bundle(self.study.bundle).name)

    @property
    def name(self) -> str:
        """Of the results' folder."""
        return f"{self.judge}_withholds" if self.withholds else self.judge


def make_evaluator(cfg: Cfg) -> RivalEvaluator:
    """The bundle of the study under a judge, which is trained here if it learns."""
    # Conditions of the experience; the benchmark has its own.
    evaluator = RivalEvaluator(cfg.study.bundle, cfg.study.engine, conditions="nominal")
    if cfg.judge != "oracle":
        train(cfg, evaluator)
    # Only now, for experience is collected without a judge.
    evaluator.oracle = cfg.judge == "oracle"
    evaluator.withholds = cfg.withholds
    evaluator.entry = f"{cfg.judge}, {'withholding' if cfg.withholds else 'handing over'}"
    return evaluator


def train(cfg: Cfg, evaluator: RivalEvaluator) -> None:
    """Give an evaluator a switch that is trained on its bundle's walking."""
    torch.manual_seed(cfg.seed)
    names = [name for of in (LOUD, LIES) for family in of.values() for name in family]
    faults = [name for name in names if not issubclass(FAULTS[name], PhysicalFault)]
    onset = cfg.steps // 10
    trials = [
        Trial(mode, schedule, number)
        for number, fault in enumerate(faults * cfg.robots)
        for schedule in ((Injection(fault, level_at(FAULTS[fault], cfg.severity), onset),), ())
        for mode in ("camera", "blind")
    ]
    speed = 0.6
    env = evaluator.make_env(GROUNDS, [trial.robot for trial in trials], speed, cfg.seed)
    grounds = list(GROUNDS)
    env.place_on([grounds[trial.robot % len(grounds)] for trial in trials])
    seen = collect(evaluator, env, trials, cfg.steps, cfg.seed, speed)
    evaluator.switch = switch = SWITCHES[cfg.judge]()
    losses = fit(switch, seen, horizon=min(HORIZON, cfg.steps // 3), epochs=cfg.epochs)
    print(f"Loss of {cfg.judge}: {losses[0]:.3f} before, {losses[-1]:.3f} after training")


if __name__ == "__main__":
    try:
        cfg = tyro.cli(Cfg)
        cfg.study.run(make_evaluator(cfg))
        print(f"Results: {cfg.study.out}")
    except RenetError as error:
        print(error, file=sys.stderr)
        raise SystemExit(2) from error
