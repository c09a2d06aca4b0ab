"""Draw what `renet train Renet-Go1-Parkour` learns: `python tools/recipe_curves.py RUN[=LABEL]...`.

Writes docs/figures/recipe.csv, every tenth iteration of each run, and docs/figures/recipe.png from
that file; without runs the figure alone is drawn again. A run's label is its seed by default.
"""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from renet.evaluation import figures
from renet.training.config import steps_per_env
from renet.training.metrics import read_curves

OUT = Path(__file__).parents[1] / "docs" / "figures" / "recipe"
LEVEL = "Curriculum/level/"
EVERY = 10
"""Iterations, of which the mean is kept."""


def rows(argument: str) -> list[dict[str, str | float]]:
    """Environment steps, hours and the curriculum's levels of a run, every tenth iteration."""
    folder, _, label = argument.partition("=")
    run = Path(folder)
    config, curves = json.loads((run / "config.json").read_text()), read_curves(run)
    taken, seconds, steps = 0.0, 0.0, []
    for fps in curves["Perf/total_fps"][1]:
        each = steps_per_env(None, config["batch_size"], config["num_envs"], taken)
        taken += each * config["num_envs"]
        seconds += each * config["num_envs"] / fps
        steps.append((taken, seconds / 3600))
    values = {n.removeprefix(LEVEL): c[1] for n, c in curves.items() if n.startswith(LEVEL)}
    label = label or f"seed {config['seed']}"
    return [
        {"run": label, "steps": steps[end - 1][0], "hours": round(steps[end - 1][1], 3)}
        | {kind: round(float(np.mean(v[end - EVERY : end])), 3) for kind, v in values.items()}
        for end in range(EVERY, len(steps) + 1, EVERY)
    ]


def draw(table: list[dict[str, str]]) -> None:
    """A panel for each kind of tile, a line for each run, a dot at each hour."""
    kinds = [name for name in table[0] if name not in ("run", "steps", "hours")]
    with plt.rc_context(figures.STYLE):
        figure, axes = plt.subplots(2, 3, figsize=(10, 5), sharex=True, sharey=True)
        for axis, kind in zip(axes.flat, kinds, strict=True):
            for run in dict.fromkeys(row["run"] for row in table):
                own = [row for row in table if row["run"] == run]
                steps, hours, level = (
                    np.array([row[name] for row in own], float) for name in ("steps", "hours", kind)
                )
                (line,) = axis.plot(steps / 1e6, level, label=run)
                whole = np.arange(1, int(hours[-1]) + 1)
                at = np.interp(whole, hours, steps)
                axis.plot(at / 1e6, np.interp(at, steps, level), "o", color=line.get_color())
            axis.set_title(kind.replace("_", " "))
            axis.set_ylim(0, 10)
        for axis in axes[1]:
            axis.set_xlabel("million environment steps")
        for axis in axes[:, 0]:
            axis.set_ylabel("curriculum's level")
        axes[0, 0].legend()
        figure.savefig(OUT.with_suffix(".png"), dpi=110)


def main(runs: list[str]) -> None:
    """Keep the runs' levels, and draw them."""
    path = OUT.with_suffix(".csv")
    if runs:
        kept = [row for run in runs for row in rows(run)]
        with path.open("w", newline="") as file:
            writer = csv.DictWriter(file, list(kept[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(kept)
    with path.open(newline="") as file:
        draw(list(csv.DictReader(file)))


if __name__ == "__main__":
    main(sys.argv[1:])
