"""Curves of training runs over their environment steps: `renet evaluate curves`.

Runs of one label are seeds of one recipe: a line is their mean, a band reaches from the lowest to
the highest, and the table has mean and standard deviation over them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import tyro
from matplotlib.axes import Axes

from renet.curves import CURVES, LEVEL, STEPS, read_curves
from renet.errors import RenetError, unknown_name
from renet.evaluation import figures
from renet.evaluation.results import output_folder, write_csv, write_json
from renet.files import write_atomically
from renet.terminal import show

DEFAULT_CURVES = (LEVEL, "Train/mean_reward", "Episode_Metrics/collisions")
"""Beginnings of the names of curves that are drawn by default, if runs have them: a task on a plane
has no levels."""
_POINTS = 400
"""Number of points of a line."""


@dataclass(frozen=True)
class CurvesCfg:
    """Draw training runs, and print the mean and spread of their last values over seeds."""

    runs: tyro.conf.Positional[tuple[str, ...]]
    """Run folders of `renet train`, or their curves.csv, as RUN or RUN=LABEL; runs of one label are
    seeds of one recipe. By default a run's label is its folder's name."""
    curves: tuple[str, ...] = DEFAULT_CURVES
    """Names of curves, or their beginnings, as in curves.csv."""
    smooth: int = 10
    """Number of iterations of the moving mean."""
    until: float | None = None
    """Environment steps up to which runs are compared; by default the last step that all runs of a
    label have reached."""
    out: Path = Path("results/curves")
    """Folder for curves.png, summary.csv and summary.json."""

    def __post_init__(self) -> None:
        if not self.runs:
            raise RenetError("name one run at least: renet evaluate curves RUN[=LABEL] ...")
        if self.smooth < 1:
            raise RenetError(f"smooth must be at least 1, got {self.smooth}")


@dataclass(frozen=True)
class Run:
    """Curves of one training run."""

    label: str
    """Name of the recipe that the run is a seed of."""
    steps: np.ndarray
    """Environment steps after each iteration, [I]."""
    values: dict[str, np.ndarray] = field(repr=False)
    """Values of each curve, [I]; NaN where it has none."""


def make_curves(cfg: CurvesCfg) -> Path:
    """Draw the runs, write the table and return the folder.

    Raises as `read_run`, `choose_curves` and `last_step`, before anything is written.
    """
    runs = []
    for argument in cfg.runs:
        runs.append(read_run(argument, cfg.smooth))
    names = choose_curves(runs, cfg.curves)
    by_label: dict[str, list[Run]] = {}
    for run in runs:
        by_label.setdefault(run.label, []).append(run)
    rows = []
    for label, seeds in by_label.items():
        rows += last_values(label, seeds, names, cfg.until)
    out = output_folder(cfg.out)
    write_json(out / "summary.json", {"runs": rows, "smooth": cfg.smooth})
    write_csv(out / "summary.csv", rows)
    write_atomically(out / "curves.png", picture(by_label, names), "figure")
    header = ("curve", "runs", "seeds", "M steps", "mean", "SD", "range")
    show("Last values", header, list(map(table_row, rows)))
    return out


def read_run(argument: str, smooth: int) -> Run:
    """Read a run, RUN or RUN=LABEL, with a moving mean over `smooth` iterations.

    Raises:
        RenetError: The run has no curves, or too few iterations for one point.
    """
    path, _, label = argument.partition("=")
    folder = Path(path)
    file = folder if folder.suffix == ".csv" else folder / CURVES
    curves = read_curves(file)
    if STEPS not in curves:
        raise RenetError(f"{file} has no curve {STEPS}: is it of `renet train`?")
    # Curves are read at the iterations whose environment steps are known.
    iterations = sorted(curves[STEPS])
    if len(iterations) < smooth:
        raise RenetError(
            f"{file} has {len(iterations)} iterations, fewer than --smooth {smooth}: train longer, "
            "or smooth less"
        )
    values = {}
    for name, curve in curves.items():
        raw = np.array([curve.get(i, np.nan) for i in iterations])
        values[name] = moving_mean(raw, smooth)
    return Run(label or _name_of(folder), values[STEPS], values)


def _name_of(path: Path) -> str:
    """Return a run's name: that of its folder, or of a file of curves that lies elsewhere."""
    if path.name == CURVES:
        return path.parent.name
    # What follows a dot in a folder's name is no suffix.
    return path.stem if path.suffix == ".csv" else path.name


def moving_mean(values: np.ndarray, count: int) -> np.ndarray:
    """Average `count` values in a row, [I - count + 1] of [I], without NaNs."""
    # [I - count + 1, count]
    windows = np.lib.stride_tricks.sliding_window_view(values, count)
    known = ~np.isnan(windows)
    total = np.where(known, windows, 0.0).sum(axis=-1)
    number = known.sum(axis=-1)
    return np.where(number > 0, total / np.maximum(number, 1), np.nan)


def choose_curves(runs: Sequence[Run], beginnings: Sequence[str]) -> list[str]:
    """List the runs' curves whose names begin with one of `beginnings`.

    Raises RenetError for a beginning of none; for one of `DEFAULT_CURVES` only if all are missing.
    """
    names: set[str] = set()
    for run in runs:
        names |= {name for name in run.values if _known(run, name).any()}
    known = sorted(names)
    chosen = [name for name in known if name.startswith(tuple(beginnings))]
    if chosen and tuple(beginnings) == DEFAULT_CURVES:
        return chosen
    for beginning in beginnings:
        if not any(name.startswith(beginning) for name in known):
            raise unknown_name("curve", beginning, known)
    return chosen


def last_step(label: str, runs: Sequence[Run], until: float | None) -> float:
    """Return the last environment step that all runs of a label have in common, at most `until`.

    Raises RenetError if there is none: runs are compared neither before they begin nor after they
    end.
    """
    begin = max(run.steps[0] for run in runs)
    end = min(run.steps[-1] for run in runs)
    if begin > end:
        raise RenetError(
            f"the runs of {label} have no environment steps in common: give each a label of its"
            " own, RUN=LABEL"
        )
    if until is None:
        return float(end)
    if until < begin:
        raise RenetError(
            f"--until {until:g} is before the runs of {label} begin, at {begin:.0f} steps"
        )
    return float(min(end, until))


def last_values(
    label: str, runs: Sequence[Run], names: Sequence[str], until: float | None
) -> list[dict[str, Any]]:
    """Return mean and spread of each curve over a label's runs, at their last common step.

    The standard deviation is a sample's (n - 1); it is None for a single run.
    """
    # Longer runs are read where the shortest ends, or the comparison would favour them.
    end = last_step(label, runs, until)
    rows = []
    for name in names:
        values = np.array([_value_at(run, name, end) for run in runs])
        values = values[~np.isnan(values)]
        if not values.size:
            continue
        spread = float(values.std(ddof=1)) if values.size > 1 else None
        rows.append(
            {
                "label": label,
                "curve": name,
                "steps": end,
                "seeds": int(values.size),
                "mean": float(values.mean()),
                "sd": spread,
                "lowest": float(values.min()),
                "highest": float(values.max()),
            }
        )
    return rows


def _known(run: Run, name: str) -> np.ndarray:
    """Return a mask of the iterations at which a run has a value of a curve, [I] bool."""
    if name not in run.values:
        return np.zeros(len(run.steps), bool)
    return ~np.isnan(run.values[name])


def _value_at(run: Run, name: str, steps: float) -> float:
    """Interpolate a curve at a number of environment steps; NaN if it is missing."""
    known = _known(run, name)
    if not known.any():
        return float("nan")
    return float(np.interp(steps, run.steps[known], run.values[name][known]))


def table_row(row: Mapping[str, Any]) -> tuple[str, ...]:
    """Format a row of the printed table, with the last part of the curve's name."""
    curve = row["curve"].split("/")[-1].replace("_", " ")
    steps = f"{row['steps'] / 1e6:.2f}"
    spread = "-" if row["sd"] is None else f"{row['sd']:.3g}"
    ends = "-" if row["sd"] is None else f"{row['lowest']:.3g} to {row['highest']:.3g}"
    return curve, row["label"], str(row["seeds"]), steps, f"{row['mean']:.3g}", spread, ends


def picture(by_label: Mapping[str, Sequence[Run]], names: Sequence[str]) -> bytes:
    """Draw a PNG with a panel for each curve, and a line and a band for each label."""
    columns = min(len(names), 3)
    rows = math.ceil(len(names) / columns)
    with plt.rc_context(figures.STYLE):
        size = (3.6 * columns + 0.6, 2.6 * rows + 0.8)
        figure, axes = plt.subplots(rows, columns, figsize=size, squeeze=False)
        for axis, name in zip(axes.flat, names, strict=False):
            for number, (label, runs) in enumerate(by_label.items()):
                draw_seeds(axis, runs, name, f"C{number}", label)
            axis.set(title=name.split("/")[-1].replace("_", " "), xlabel="million steps")
        # The last row may have more panels than curves.
        for axis in axes.flat[len(names) :]:
            axis.set_axis_off()
        # A run may have no curve in the first panel.
        figures.legend(figure, *axes.flat)
        return figures.png(figure)


def draw_seeds(axis: Axes, runs: Sequence[Run], name: str, colour: str, label: str) -> None:
    """Draw the mean of runs over the steps they have in common, and a band over their range."""
    group = [run for run in runs if _known(run, name).any()]
    if not group:
        return
    # A curve may begin after its run, as that of episodes does.
    begin = max(run.steps[_known(run, name)][0] for run in group)
    end = min(run.steps[_known(run, name)][-1] for run in group)
    steps = np.linspace(begin, end, _POINTS)
    # [runs, points]
    values = np.empty((len(group), _POINTS))
    for row, run in enumerate(group):
        values[row] = [_value_at(run, name, step) for step in steps]
    # The legend is of all panels, of which this one may lack a run.
    count = f"{label} ({len(runs)} seeds)" if len(runs) > 1 else label
    # A line of no length is invisible.
    marker = "o" if begin == end else ""
    axis.plot(steps / 1e6, values.mean(axis=0), color=colour, label=count, marker=marker)
    if len(group) > 1:
        low = values.min(axis=0)
        high = values.max(axis=0)
        axis.fill_between(steps / 1e6, low, high, color=colour, alpha=0.2, linewidth=0)
