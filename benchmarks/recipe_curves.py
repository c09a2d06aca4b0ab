"""Draw what `renet train` learns: `python benchmarks/recipe_curves.py RUN[=LABEL]...`.

Writes docs/figures/recipe.csv, every tenth iteration of each run, and docs/figures/recipe.png from
that file and the curves of the flagship and of its recipe's other seeds; without runs the figure
alone is drawn again. Runs of one label have one colour, and each of them another seed.
"""

from __future__ import annotations

import csv
import io
import sys
from pathlib import Path
from statistics import fmean
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from facts import errors_in_one_line
from renet.curves import CURVES, LEVEL, STEPS, read_curves
from renet.errors import RenetError
from renet.evaluation import figures
from renet.files import read_object, write_atomically
from renet.terrain.tiles import tiles
from renet.training.config import steps_per_env
from renet.training.train import CONFIG_FILE

OUT = Path(__file__).parents[1] / "docs" / "figures" / "recipe"
FLAGSHIP = Path(__file__).with_name("results") / "flagship"
SHIPPED = "the Go1's policy that ships, seed 1"
"""Label of the run that made it."""
SIBLINGS = "the same recipe, seeds 2 and 3"
"""Label of the other seeds of its recipe."""


def level_curves(run: Path, steps: int = 0, every: int = 10) -> list[dict[str, float]]:
    """Levels of the curriculum by kind of tile over a run, means of `every` iterations.

    Args:
        run: its folder.
        steps: environment steps with which it began, if it went on from another run.
        every: iterations.

    Returns:
        Rows of "steps" (environment steps), "hours" and each kind's level.
    """
    config = read_object(run / CONFIG_FILE)
    curves = {name: list(curve.values()) for name, curve in read_curves(run / CURVES).items()}
    robots, agent = config["env"]["scene"]["num_envs"], config["agent"]
    values = {n.removeprefix(LEVEL): c for n, c in curves.items() if n.startswith(LEVEL)}
    seconds, rows = 0.0, []
    for number, fps in enumerate(curves.get("Perf/total_fps", ()), 1):
        fixed, batch_size = agent["num_steps_per_env"], agent["batch_size"]
        each = robots * steps_per_env(fixed, batch_size, robots, steps)
        steps, seconds = steps + each, seconds + each / fps
        if number % every == 0:
            levels = {k: round(fmean(v[number - every : number]), 3) for k, v in values.items()}
            rows.append({"steps": steps, "hours": round(seconds / 3600, 3), **levels})
    return rows


def first_steps(run: Path) -> int:
    """Environment steps with which a run began: those of the run that it went on from, or 0."""
    known = read_curves(run / CURVES).get(STEPS, {})
    if not known:
        return 0
    config = read_object(run / CONFIG_FILE)
    robots = config["env"]["scene"]["num_envs"]
    agent = config["agent"]
    batch = robots * steps_per_env(agent["num_steps_per_env"], agent["batch_size"], robots, 0)
    first = round(known[min(known)])
    # The curve's first value is of a moment within the first iteration.
    return first if first > batch else 0


def rows(argument: str) -> list[dict[str, str | float]]:
    """Environment steps, hours and the levels of the kinds drawn, every tenth iteration.

    Args:
        argument: a run's folder, or FOLDER=LABEL.

    Raises:
        RenetError: The folder holds no run, or one without levels of these kinds.
    """
    folder, _, label = argument.partition("=")
    run = Path(folder)
    seed = read_object(run / CONFIG_FILE)["agent"]["seed"]
    table = []
    for levels in level_curves(run, first_steps(run)):
        missing = [kind for kind in tiles() if kind not in levels]
        if missing:
            raise RenetError(f"{run} has no levels of {missing[0]}: name runs of a Parkour task")
        row: dict[str, str | float] = {"run": label or f"seed {seed}", "seed": seed}
        # Kinds of one's own have no panel.
        for name in ("steps", "hours", *tiles()):
            row[name] = levels[name]
        table.append(row)
    return table


def kept_rows(runs: list[str]) -> list[dict[str, str | float]]:
    """Rows of all runs; raises RenetError where two could not be told apart, or there are none."""
    table: list[dict[str, str | float]] = []
    names: set[tuple[str | float, str | float]] = set()
    for run in runs:
        part = rows(run)
        if not part:
            continue
        name = (part[0]["run"], part[0]["seed"])
        if name in names:
            raise RenetError(f"two runs are named {name[0]}, with seed {name[1]}: write RUN=LABEL")
        names.add(name)
        table += part
    if not table:
        raise RenetError("these runs have fewer than ten iterations: there is nothing to draw")
    return table


def as_csv(table: list[dict[str, str | float]]) -> str:
    """Rows as CSV, with a header."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(table[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(table)
    return text.getvalue()


def draw(table: list[dict[str, str]]) -> None:
    """Draw a panel for each kind of tile, with a line for each run and a colour for each label."""
    labels = list(dict.fromkeys(row["run"] for row in table))
    runs = dict.fromkeys((row["run"], row["seed"]) for row in table)
    with plt.rc_context(figures.STYLE):
        figure, axes = plt.subplots(
            3, 2, figsize=(figures.FIGURE_WIDTH, 7.0), sharex=True, sharey=True
        )
        for axis, kind in zip(axes.flat, tiles(), strict=True):
            for label, seed in runs:
                curve = [row for row in table if (row["run"], row["seed"]) == (label, seed)]
                steps = np.array([row["steps"] for row in curve], float)
                level = np.array([row[kind] for row in curve], float)
                axis.plot(steps / 1e6, level, **look(labels, label))
            axis.set(title=kind.replace("_", " "), ylim=(0, 10))
        for axis in axes[-1]:
            axis.set_xlabel("million environment steps")
        for axis in axes[:, 0]:
            axis.set_ylabel("curriculum's level")
        lines = [plt.Line2D([], [], **look(labels, label)) for label in labels]
        words = [f"{label} ({last_step(table, label) / 1e6:.0f} M steps)" for label in labels]
        figure.legend(lines, words, loc="outside upper center", alignment="left")
        write_atomically(OUT.with_suffix(".png"), figures.png(figure), "figure")


def look(labels: list[str], label: str) -> dict[str, Any]:
    """Colour, width and order of the lines of a label; the policy that ships stands out."""
    shown = label == SHIPPED
    return {
        "color": f"C{labels.index(label)}",
        "linewidth": 2.0 if shown else 1.0,
        # A wide line must not cover thin ones.
        "zorder": 2 if shown else 3,
    }


def last_step(table: list[dict[str, str]], label: str) -> float:
    """Environment steps of the longest run of a label."""
    return max(float(row["steps"]) for row in table if row["run"] == label)


def main(runs: list[str]) -> None:
    """Draw the runs' levels, and keep them."""
    path = OUT.with_suffix(".csv")
    text = as_csv(kept_rows(runs)) if runs else path.read_text()
    kept = list(csv.DictReader(text.splitlines()))
    flagship = []
    for number in (1, 2, 3):
        curve = (FLAGSHIP / f"seed_{number}.csv").read_text()
        label = SHIPPED if number == 1 else SIBLINGS
        for row in csv.DictReader(curve.splitlines()):
            flagship.append(row | {"run": label, "seed": str(number)})
    draw([*flagship, *kept])
    # Only what can be drawn replaces the earlier runs.
    if runs:
        write_atomically(path, text.encode(), "curves")


if __name__ == "__main__":
    with errors_in_one_line():
        main(sys.argv[1:])
