"""Learned switches in the fault benchmark: trained on the bundle's own walking, then studied.

`python benchmarks/switches.py return` is VB-Com's rule, `gate` the classifier of failing cameras.
The study is `benchmark`, version 2, or `faults`, version 1; its results are those of
`renet evaluate`, whose mode `memory` then obeys the switch. Robots, starts and noise of the
training are drawn from another seed than the study's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import torch
import tyro

from baselines.switches import Gate, ReturnSwitch, SwitchEvaluator, collect, fit
from facts import errors_in_one_line
from renet.errors import RenetError
from renet.evaluation.rollout import Trial
from renet.evaluation.studies.benchmark import LISTED
from renet.evaluation.studies.crossing import CrossingStudy
from renet.evaluation.studies.faults import FaultStudy
from renet.faults import FAULTS, Injection, PhysicalFault

SWITCHES = {"return": ReturnSwitch, "gate": Gate}

VERSION_2, VERSION_1 = (
    tyro.conf.subcommand(name, default=study(modes=("memory",)), prefix_name=False)
    for name, study in (("benchmark", CrossingStudy), ("faults", FaultStudy))
)
"""Studies of the mode that obeys the switch alone: the others are the bundle's own."""


@dataclass
class Cfg:
    """Train a switch, then run the benchmark with it."""

    switch: tyro.conf.Positional[Literal["return", "gate"]]
    """return: estimators of the return under vision and under blindness. gate: a classifier."""
    study: Annotated[CrossingStudy, VERSION_2] | Annotated[FaultStudy, VERSION_1]
    """What is studied; by default in results/switch_NAME."""
    severity: int = 4
    """Severity of the faults it learns from: version 1's but glass, foam and a knocked mount."""
    robots: int = 2
    """Robots for each fault and mode in training, in turn on the study's grounds (version 2: hard
    ones); each has a twin whose camera stays healthy."""
    steps: int = 500
    """Control steps of training's rollout; faults begin after a tenth."""
    epochs: int = 200
    """Passes over the rollout."""
    seed: int = 7
    """Seed of training."""

    def __post_init__(self) -> None:
        if self.study.out == type(self.study).out:
            self.study = replace(self.study, out=Path(f"results/switch_{self.switch}"))
        if self.seed == self.study.seed:
            raise RenetError(f"seed {self.seed} is the study's: choose another one for training")


def trained(cfg: Cfg) -> SwitchEvaluator:
    """An evaluator of the study's bundle that obeys a switch trained on it."""
    torch.manual_seed(cfg.seed)
    faults = [name for name in LISTED if not issubclass(FAULTS[name], PhysicalFault)]
    trials = [
        Trial(mode, schedule, number)
        for number, fault in enumerate(faults * cfg.robots)
        for schedule in ((Injection.of(fault, cfg.severity, cfg.steps // 10),), ())
        for mode in ("camera", "blind")
    ]
    study = cfg.study
    evaluator = SwitchEvaluator(study.bundle, study.engine)
    levels = study.levels("hard") if isinstance(study, CrossingStudy) else study.levels
    env = evaluator.make_env(levels, [trial.robot for trial in trials], study.speed, cfg.seed)
    env.place_on([study.grounds[trial.robot % len(study.grounds)] for trial in trials])
    seen = collect(evaluator, env, trials, cfg.steps, cfg.seed, study.speed)
    evaluator.switch = switch = SWITCHES[cfg.switch]()
    losses = fit(switch, seen, horizon=min(150, cfg.steps // 3), epochs=cfg.epochs)
    print(f"Loss of {cfg.switch}: {losses[0]:.3f} before, {losses[-1]:.3f} after training")
    return evaluator


if __name__ == "__main__":
    with errors_in_one_line():
        cfg = tyro.cli(Cfg)
        cfg.study.run(trained(cfg))
        print(f"Results: {cfg.study.out}")
