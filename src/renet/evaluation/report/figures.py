"""Figures: one look for all of them, drawn without a display, saved whole with their provenance."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from renet.evaluation.results import Provenance
from renet.interface import CONTROL_DT

VP_BAND, OP_BAND = "#bed5b4", "#f3c1bb"
LOSS, PROBABILITY = "#3c3ca0", "#64aa5f"
FAMILIES = {
    "gaussian": ("#9ecae1", "#4292c6", "#084594"),
    "salt_and_pepper": ("#fdae6b", "#f16913", "#a63603"),
}
INK, FAINT = "#222730", "#8a919c"
MODE_COLOURS = {
    "vp": "#d9602b",
    "renet": "#3c3ca0",
    "op": "#3f8f63",
    "oracle-switch": "#7d8590",
}
MODE_NAMES = {
    "vp": "VP alone",
    "renet": "RENet",
    "op": "OP alone",
    "oracle-switch": "switch that knows the fault",
}

STYLE: dict[Any, Any] = {
    "figure.facecolor": "white",
    "figure.constrained_layout.use": True,
    "font.size": 10,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": "#c4c9d0",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 11,
    "axes.titleweight": "bold",
    "axes.grid": True,
    "grid.color": "#e8eaee",
    "xtick.color": "#555c66",
    "ytick.color": "#555c66",
    "legend.frameon": False,
    "lines.linewidth": 1.6,
}


def save(figure: Figure, path: Path, provenance: Provenance, dpi: int = 150) -> Path:
    """Write a PNG, atomically, with its provenance as last line and in its metadata."""
    line = provenance.line
    shown = line if len(line) <= 150 else line[:149] + "…"
    figure.supxlabel(shown, fontsize=6.5, color=FAINT, x=0.01, ha="left")
    part = path.with_name(path.name + ".part")
    figure.savefig(part, format="png", dpi=dpi, metadata={"Description": line})
    plt.close(figure)
    os.replace(part, path)
    return path


def noise_label(noise: str, level: float) -> str:
    """A noise setting as the paper writes it, such as "GA 30 %"."""
    short = {"gaussian": "GA", "salt_and_pepper": "SP"}
    return "no noise" if noise == "none" else f"{short.get(noise, noise)} {100 * level:.0f} %"


def speed_over_time(
    curves: Mapping[str, Mapping[tuple[str, float], np.ndarray]],
    onset: int,
    command: float,
    path: Path,
    provenance: Provenance,
) -> Path:
    """The paper's comparison: mean forward velocity against timestep, one panel for each mode.

    Args:
        curves: mode → (noise, level) → [T] m/s, mean over the robots.
        onset: timestep the noise begins at.
        command: commanded speed, m/s.
        path: of the PNG.
        provenance: of the numbers.
    """
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(1, len(curves), figsize=(11, 4.2), sharey=True, squeeze=False)
        for axis, letter, (mode, settings) in zip(axes[0], "abcdef", curves.items(), strict=False):
            used: dict[str, int] = {}
            for (noise, level), speed in settings.items():
                shade = used[noise] = used.get(noise, -1) + 1
                colour = FAMILIES.get(noise, ("#7d8590",))[shade % 3 if noise in FAMILIES else 0]
                style = "--" if noise == "none" else "-"
                axis.plot(smooth(speed), style, color=colour, label=noise_label(noise, level))
            axis.axvline(onset, color=INK, linewidth=1, linestyle=":")
            axis.axhline(command, color=FAINT, linewidth=1, linestyle=(0, (1, 3)))
            axis.annotate(
                "noise begins",
                (onset, 0.0),
                xycoords=("data", "axes fraction"),
                xytext=(4, 5),
                textcoords="offset points",
                fontsize=8,
                color=INK,
            )
            axis.set(title=f"({letter}) {MODE_NAMES[mode]}", xlabel="timestep (0.02 s)")
        axes[0][0].set_ylabel("mean forward velocity (m/s)")
        handles, labels = axes[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), fontsize=9)
        return save(figure, path, provenance)


def smooth(values: np.ndarray, steps: int = 13) -> np.ndarray:
    """A centred moving mean over about half a gait cycle, shorter at both ends."""
    kernel = np.ones(steps)
    total = np.convolve(values, kernel, "same")
    return total / np.convolve(np.ones_like(values), kernel, "same")


def rates(axis: Axes, runs: Sequence[Mapping[str, Any]], x: str, y: str, interval: str) -> None:
    """Shares in percent against a size in cm, one line with its intervals for each mode.

    Args:
        axis: to draw on.
        runs: rows of a summary.
        x: key of the size, m.
        y: key of the share, 0 to 1.
        interval: key of its confidence interval, without `_low` and `_high`.
    """
    modes = list(dict.fromkeys(run["mode"] for run in runs))
    sizes = sorted({100 * run[x] for run in runs})
    apart = 0.012 * (sizes[-1] - sizes[0] or 1.0)
    for number, mode in enumerate(modes):
        line = [run for run in runs if run["mode"] == mode]
        share = np.array([100 * run[y] for run in line])
        ends = np.array(
            [[100 * run[f"{interval}_{end}"] for run in line] for end in ("low", "high")]
        )
        # Side by side, or equal shares would hide each other.
        size = np.array([100 * run[x] for run in line]) + (number - (len(modes) - 1) / 2) * apart
        axis.errorbar(
            size,
            share,
            np.abs(ends - share),
            fmt="o-",
            markersize=4,
            elinewidth=1,
            color=MODE_COLOURS[mode],
            label=MODE_NAMES[mode],
        )
    axis.set_xticks(sizes, [f"{size:.0f}" for size in sizes])


Cells = Mapping[tuple[str, str], tuple[float, str]]
"""Percent, which gives the colour, and text, by row and column."""


def colour_tables(
    panels: Mapping[str, Cells],
    title: str,
    path: Path,
    provenance: Provenance,
    xlabel: str = "",
    width: float = 0.42,
) -> Path:
    """Coloured tables side by side with the same rows, green for 100, red for 0.

    Args:
        panels: by title.
        title: of all.
        path: of the PNG.
        provenance: of the numbers.
        xlabel: what the columns are.
        width: of a column, inches.
    """
    rows = list(dict.fromkeys(row for panel in panels.values() for row, _ in panel))
    columns = list(dict.fromkeys(column for panel in panels.values() for _, column in panel))
    with plt.rc_context({**STYLE, "axes.grid": False, "axes.spines.left": False}):
        size = (2.2 + width * len(columns) * len(panels), 1.4 + 0.3 * len(rows))
        figure, axes = plt.subplots(1, len(panels), figsize=size, sharey=True, squeeze=False)
        for axis, (name, panel) in zip(axes[0], panels.items(), strict=True):
            shade = [[panel.get((r, c), (np.nan, ""))[0] for c in columns] for r in rows]
            axis.imshow(np.array(shade, float), vmin=0, vmax=100, cmap="RdYlGn", aspect="auto")
            for (row, column), (value, text) in panel.items():
                ink = "white" if value < 15 or value > 85 else INK
                place = columns.index(column), rows.index(row)
                axis.text(*place, text, ha="center", va="center", fontsize=8, color=ink)
            axis.set_xticks(range(len(columns)), columns, fontsize=8)
            axis.set_yticks(range(len(rows)), [row.replace("_", " ") for row in rows])
            axis.tick_params(length=0)
            axis.set(title=name, xlabel=xlabel)
        figure.suptitle(title, x=0.01, ha="left", fontsize=11)
        return save(figure, path, provenance)


def bands(axis: Axes, vision: np.ndarray, every: float = CONTROL_DT) -> None:
    """Green where VP is in charge, red where OP is; `vision` is [T] bool, `every` s apart."""
    edges = np.flatnonzero(np.diff(vision.astype(int))) + 1
    for start, end in zip([0, *edges], [*edges, len(vision)], strict=True):
        colour = VP_BAND if vision[start] else OP_BAND
        axis.axvspan(start * every, end * every, color=colour, alpha=0.7, linewidth=0)


def loss_and_probability(
    axis: Axes, anomaly: np.ndarray, beta: float, probability: np.ndarray, every: float
) -> Axes:
    """Draw loss and threshold on `axis` and P_t on its right; both [T], `every` s apart.

    Returns:
        The right axis.
    """
    time = np.arange(len(anomaly)) * every
    axis.plot(time, anomaly, color=LOSS, label="reconstruction loss")
    axis.axhline(beta, color="black", linestyle="--", linewidth=1.2, label="threshold β")
    axis.set_yscale("log")
    axis.set_ylim(top=4 * np.max(anomaly, where=~np.isnan(anomaly), initial=beta))
    axis.set_xlim(0, time[-1])
    right = axis.twinx()
    right.plot(time, probability, "--", color=PROBABILITY, label="vision probability $P_t$")
    right.set(ylim=(-0.05, 1.25))
    right.set_yticks(np.linspace(0, 1, 6))
    right.set_ylabel("$P_t$", color=PROBABILITY)
    right.grid(False)
    return right


def timeline_legend(figure: Figure, axis: Axes, right: Axes) -> None:
    """Name the lines of both axes and the bands, above the figure."""
    keys = [Rectangle((0, 0), 1, 1, color=c, alpha=0.7) for c in (VP_BAND, OP_BAND)]
    lines = axis.get_legend_handles_labels(), right.get_legend_handles_labels()
    figure.legend(
        [*lines[0][0], *lines[1][0], *keys],
        [*lines[0][1], *lines[1][1], "VP in charge", "OP in charge"],
        loc="outside upper center",
        ncols=5,
        fontsize=9,
    )


def timeline(
    anomaly: np.ndarray,
    beta: float,
    probability: np.ndarray,
    vision: np.ndarray,
    marks: Sequence[tuple[float, str]],
    title: str,
    path: Path,
    provenance: Provenance,
) -> Path:
    """The paper's timeline of one robot: loss, threshold, P_t and the estimator in charge.

    Args:
        anomaly: [T] anomaly score.
        beta: threshold.
        probability: [T] P_t.
        vision: [T] bool, VP in charge.
        marks: instants to point out, (seconds, text).
        title: of the figure.
        path: of the PNG.
        provenance: of the numbers.
    """
    with plt.rc_context(STYLE):
        figure, axis = plt.subplots(figsize=(11, 3.4))
        bands(axis, vision)
        right = loss_and_probability(axis, anomaly, beta, probability, CONTROL_DT)
        axis.set(xlabel="time (s)", ylabel="anomaly score", title=title)
        for instant, text in marks:
            axis.axvline(instant, color=INK, linewidth=1, linestyle=":")
            axis.annotate(
                text,
                (instant, 1.0),
                xycoords=("data", "axes fraction"),
                xytext=(4, -11),
                textcoords="offset points",
                fontsize=8,
            )
        timeline_legend(figure, axis, right)
        return save(figure, path, provenance)
