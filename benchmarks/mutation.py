"""How many small changes of what decides over the robot the tests notice (mutmut).

Mutates the modules of `[tool.mutmut]` in pyproject.toml, takes a seeded sample of each group's
mutants and runs, for each of them, those of the mirrored tests that reach the mutated function.
"""

from __future__ import annotations

import json
import os
import random
import subprocess
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

import tyro

from facts import report

GROUPS = {
    "selector": "renet.selector.*",
    "safety": "renet.deploy.safety.*",
    "controller": "renet.deploy.controller.*",
    "drivers": "renet.deploy.robots.*",
}
FIRST = "renet.deploy.safety.x_teleop_problem__mutmut_1"
"""Any mutant: what mutmut does with the first makes all of them and times the tests."""
SURVIVED, UNTESTED = 0, 33
"""mutmut's exit codes; every other one says that a test failed or never ended."""


@dataclass(frozen=True)
class Cfg:
    json: Path | None = None
    """File for the results."""
    sample: int = 40
    """Mutants of each group."""
    seed: int = 1
    groups: tuple[str, ...] = tuple(GROUPS)
    only: tuple[str, ...] = ()
    """Run these mutants instead, as the results name them."""


def mutmut(*names: str) -> None:
    """Run mutants by name, one after the other; hypothesis judges no test by its time."""
    environment = os.environ | {"CI": "1", "OMP_NUM_THREADS": "1"}
    subprocess.run(["mutmut", "run", "--max-children", "1", *names], check=True, env=environment)


def exit_codes() -> dict[str, int | None]:
    """By mutant; None for one that never ran."""
    files = Path("mutants").rglob("*.meta")
    return {
        k: v for file in files for k, v in json.loads(file.read_text())["exit_code_by_key"].items()
    }


def main(cfg: Cfg) -> None:
    if cfg.only:
        mutmut(*cfg.only)
        codes = exit_codes()
        print({name: codes[name] for name in cfg.only})
        return
    mutmut(FIRST)
    chance, chosen = random.Random(cfg.seed), {}
    for group in cfg.groups:
        names = sorted(name for name in exit_codes() if fnmatch(name, GROUPS[group]))
        chosen[group] = (len(names), chance.sample(names, min(cfg.sample, len(names))))
    results = {}
    for group, (count, names) in chosen.items():
        mutmut(*names)
        codes = exit_codes()
        alive = sorted(name for name in names if codes[name] in (SURVIVED, UNTESTED))
        score = round(1.0 - len(alive) / len(names), 3)
        results[group] = {"mutants": count, "run": len(names), "score": score, "alive": alive}
        report(results, cfg.json)


if __name__ == "__main__":
    main(tyro.cli(Cfg))
