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
from renet.training.metrics import level_curves

OUT = Path(__file__).parents[1] / "docs" / "figures" / "recipe"


def rows(argument: str) -> list[dict[str, str | float]]:
    """Environment steps, hours and the curriculum's levels of a run, every tenth iteration."""
    folder, _, label = argument.partition("=")
    run = Path(folder)
    label = label or f"seed {json.loads((run / 'config.json').read_text())['seed']}"
    return [{"run": label, **row} for row in level_curves(run)]


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
