"""CPU time of a study and steps per second of a training, at an earlier commit and now, in turn.

Both run the code of their own tree, with the packages that are installed. The study's results are
compared to the last digit.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any, Literal

import tyro

from facts import errors_in_one_line, report
from renet.curves import CURVES, read_curves
from renet.errors import RenetError

ROOT = Path(__file__).parents[1]
STEPS_PER_SECOND = "Perf/total_fps"
"""Name of the curve."""


@dataclass(frozen=True)
class Cfg:
    """Compare the speed of this working tree with that of an earlier commit."""

    before: tyro.conf.Positional[str]
    """Commit, branch or tag."""
    rounds: int = 3
    """Runs of each commit, in turn."""
    parts: tuple[Literal["study", "training"], ...] = ("study", "training")
    """What is measured."""
    ground: str = "gap"
    """Ground of the fault study."""
    faults: tuple[str, ...] = ()
    """Faults of the study; all by default."""
    robots: int = 20
    """Robots in each setting of the study."""
    healthy_minutes: float = 80.0
    """Robot minutes of the study without faults."""
    task: str = "Renet-Go1-Parkour"
    """Task of the training."""
    num_envs: int = 512
    """Robots of the training."""
    budget: str = "5m"
    """Time of each training."""
    json: Path | None = None
    """Result file."""


@dataclass
class Runs:
    """What was measured of one commit, a number for each round."""

    study_cpu_s: list[float] = field(default_factory=list)
    study_wall_s: list[float] = field(default_factory=list)
    training_steps_per_s: list[float] = field(default_factory=list)


@contextmanager
def worktree(commit: str) -> Iterator[Path]:
    """A temporary worktree of a commit; raises RenetError where git cannot make it."""
    with TemporaryDirectory() as folder:
        tree = Path(folder) / "before"
        git = ["git", "-C", str(ROOT), "worktree"]
        add = [*git, "add", "--detach", str(tree), commit]
        done = subprocess.run(add, capture_output=True, text=True)
        if done.returncode:
            raise RenetError(f"git cannot check out {commit}: {done.stderr.strip()}")
        try:
            yield tree
        finally:
            subprocess.run([*git, "remove", "--force", str(tree)], check=True)


def renet(tree: Path, *arguments: str) -> tuple[float, float]:
    """Run a tree's `renet`; returns seconds of its processors and of the wall clock.

    Raises RenetError where it fails.
    """
    env = os.environ | {"PYTHONPATH": str(tree / "src")}
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    command = [sys.executable, "-m", "renet", *arguments]
    code = subprocess.run(command, env=env, stdout=subprocess.DEVNULL).returncode
    if code:
        raise RenetError(f"`renet {' '.join(arguments)}` of {tree} ended with code {code}")
    after, wall = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter() - start
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, wall


def run_study(tree: Path, cfg: Cfg, out: Path) -> tuple[float, float]:
    """Run the fault study on one ground, in nominal conditions."""
    size = ["--robots", str(cfg.robots), "--healthy-minutes", str(cfg.healthy_minutes)]
    faults = ["--faults", *cfg.faults] if cfg.faults else []
    where = ["--grounds", cfg.ground, "--out", str(out)]
    # Commits without other conditions have nominal ones alone.
    if (tree / "src/renet/evaluation/conditions.py").exists():
        where += ["--conditions", "nominal"]
    return renet(tree, "evaluate", "faults", *where, *size, *faults)


def numbers(out: Path) -> dict[str, Any]:
    """A study's summary without what tells where and when it was made."""
    summary = json.loads((out / "summary.json").read_text())
    return {k: v for k, v in summary.items() if k not in ("settings", "provenance")}


def train(tree: Path, cfg: Cfg, logs: Path) -> float:
    """Train, and return the median of the iterations' steps per second, without the first."""
    size = ("--num-envs", str(cfg.num_envs), "--time-budget", cfg.budget)
    renet(tree, "train", cfg.task, *size, "--log-root", str(logs))
    curves = read_curves(next(logs.rglob(CURVES)))
    values = [*curves[STEPS_PER_SECOND].values()]
    if len(values) < 2:
        raise RenetError(f"{cfg.budget} is too short for two iterations: give more --budget")
    return median(values[1:])


def measure(trees: dict[str, Path], cfg: Cfg, folder: Path) -> dict[str, Runs]:
    """Run all rounds; raises RenetError where the results of the commits' studies differ."""
    runs = {name: Runs() for name in trees}
    small = replace(cfg, faults=("blackout:5",), robots=1, healthy_minutes=0.0)
    for name, tree in trees.items():
        run_study(tree, small, folder / name)  # Compiles kernels.
    for number in range(1, cfg.rounds + 1):
        for name, tree in trees.items():
            out = folder / f"{name}_{number}"
            if "study" in cfg.parts:
                cpu, wall = run_study(tree, cfg, out)
                runs[name].study_cpu_s.append(cpu)
                runs[name].study_wall_s.append(wall)
                first, these = numbers(folder / "before_1"), numbers(out)
                if these != first:
                    differing = ", ".join(key for key in first if these.get(key) != first[key])
                    raise RenetError(
                        f"round {number}, {name}: other results than before: {differing}"
                    )
            if "training" in cfg.parts:
                runs[name].training_steps_per_s.append(train(tree, cfg, out / "logs"))
    return runs


def ratios(runs: dict[str, Runs]) -> dict[str, Any]:
    """What this tree needs or makes of what the commit before did: median, least and greatest."""
    results: dict[str, Any] = {}
    for name, before in vars(runs["before"]).items():
        pairs = zip(vars(runs["now"])[name], before, strict=True)
        values = sorted(now / then for now, then in pairs)
        if values:
            results[f"{name}_ratio"] = median(values)
            results[f"{name}_ratio_spread"] = [values[0], values[-1]]
    return results


def main(cfg: Cfg) -> None:
    with errors_in_one_line(), worktree(cfg.before) as tree, TemporaryDirectory() as folder:
        head = ["git", "-C", str(tree), "rev-parse", "HEAD"]
        commit = subprocess.run(head, capture_output=True, text=True, check=True).stdout.strip()
        runs = measure({"before": tree, "now": ROOT}, cfg, Path(folder))
        results: dict[str, Any] = {"before": commit, "rounds": cfg.rounds, "ground": cfg.ground}
        results |= {"task": cfg.task, "num_envs": cfg.num_envs, "budget": cfg.budget}
        if "study" in cfg.parts:
            results["study_results_equal"] = True  # Or `measure` had raised.
        results |= ratios(runs)
        results |= {f"{name}_runs": vars(one) for name, one in runs.items()}
        report(results, cfg.json)


if __name__ == "__main__":
    main(tyro.cli(Cfg))
