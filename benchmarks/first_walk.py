"""The README's first two commands with other seeds: who crosses the gap after its camera died.

`python benchmarks/first_walk.py` takes 20 minutes on two busy cores. Each walk is a program of its
own, as a reader starts it.
"""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import tyro

from facts import errors_in_one_line, report
from renet.errors import RenetError
from renet.terminal import progress

COMMAND = "renet deploy --camera sim --terrain gap --level 6 --fault unplugged@3.2s"
"""Command of the README; `--mode` follows."""
MODES = ("switch", "memory")
CROSSED = "crossed the gap"
"""Verdict of a walk that crossed."""


@dataclass(frozen=True)
class Cfg:
    json: Path | None = None
    """File for the results."""
    seeds: int = 25
    """Number of seeds, from 1 on."""


def walk(mode: str, seed: int, folder: Path) -> dict[str, Any]:
    """Walk once; returns the score that the command wrote into a folder.

    Raises:
        RenetError: The command failed.
    """
    command = f"{COMMAND} --mode {mode} --seed {seed}"
    arguments = [*shlex.split(command)[1:], "--out", str(folder)]
    done = subprocess.run([sys.executable, "-m", "renet", *arguments], capture_output=True)
    if done.returncode:
        raise RenetError(f"{command} failed: {done.stderr.decode().strip()}")
    return json.loads((folder / "score.json").read_text())


def summarise(scores: list[dict[str, Any]]) -> dict[str, Any]:
    """Count who crosses in each mode; `runs` has a row for each walk."""
    runs = []
    crossed = dict.fromkeys(MODES, 0)
    for score in scores:
        run = score["run"]
        crossed[run["mode"]] += score["crossed"] == CROSSED
        row = {name: run[name] for name in ("mode", "seed")}
        row |= {name: score[name] for name in ("crossed", "falls", "distance_m", "states")}
        runs.append(row)
    return {
        "command_of_the_readme": COMMAND,
        "seeds": len(scores) // len(MODES),
        "crossed": crossed,
        "bundle": scores[0]["run"]["bundle"],
        "bundle_sha256": scores[0]["run"]["bundle_sha256"],
        "runs": runs,
    }


def main(cfg: Cfg) -> None:
    if cfg.seeds < 1:
        raise RenetError(f"seeds must be at least 1, got {cfg.seeds}")
    trials = [(mode, seed) for mode in MODES for seed in range(1, cfg.seeds + 1)]
    scores = []
    for mode, seed in progress(trials, "walks"):
        with TemporaryDirectory() as folder:
            scores.append(walk(mode, seed, Path(folder) / "walk"))
    report(summarise(scores), cfg.json)


if __name__ == "__main__":
    with errors_in_one_line():
        main(tyro.cli(Cfg, description=__doc__))
