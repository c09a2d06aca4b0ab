"""Figures of studies in one style, drawn without a display and saved with their provenance.

Each is a card of its own colour with round corners, on a light page and on a dark one. Where it has
several panels they are below one another, so that its words are legible on a telephone.
"""

import io
import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
from itertools import chain, cycle
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

from renet.evaluation.results import Provenance, column, group_by
from renet.faults import fault_class
from renet.files import write_atomically
from renet.interface import CONTROL_DT
from renet.palette import BLIND_COLOUR, REMEMBERS_COLOUR, SEES_COLOUR

_LOSS = "#3c3ca0"
_PROBABILITY = "#64aa5f"
_NOISE_COLOURS = {
    "gaussian": ("#9ecae1", "#4292c6", "#084594"),
    "salt_and_pepper": ("#fdae6b", "#f16913", "#a63603"),
}
"""Colours of each noise, in the order of its levels."""
INK = "#222730"
"""Colour of text and lines."""
FAINT = "#69707b"
"""Colour of what is less important."""
BACKGROUND = "#f6f7f9"
"""Colour of the background of figures and of the drawings in the documents."""
_CORNER = 0.08
"""Radius of a figure's corners, inches."""
FIGURE_WIDTH = 5.6
"""Width of a figure of several panels, inches: on a telephone its letters are 9 pixels high."""
_FOOTER_LETTERS = 19
"""Letters of a figure's last line in an inch."""
MODE_COLOURS = {
    "camera": SEES_COLOUR,
    "memory": REMEMBERS_COLOUR,
    "blind": BLIND_COLOUR,
    "switch": "#009e73",
    "oracle": "#7d8590",
}

STYLE: dict[Any, Any] = {
    "figure.facecolor": BACKGROUND,
    "axes.facecolor": "none",
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
    "grid.color": "#dee1e6",
    "xtick.color": "#555c66",
    "ytick.color": "#555c66",
    "legend.frameon": False,
    "lines.linewidth": 1.6,
    # Names from files and command lines may hold a dollar sign, which is no formula.
    "text.parse_math": False,
}
"""Style in which every figure of a study is drawn and saved."""


def save_figure(figure: Figure, path: Path, provenance: Provenance, dpi: int = 150) -> Path:
    """Write a PNG, atomically, with its provenance as last line and in its metadata.

    matplotlib makes ticks only now, in its current style.
    """
    add_footer(figure, provenance)
    write_atomically(path, png(figure, dpi, provenance.line), "figure")
    return path


def add_footer(figure: Figure, provenance: Provenance) -> None:
    """Write the provenance below a figure, shortened, in lines as long as the figure is wide."""
    line = provenance.line
    short = line if len(line) <= 150 else line[:149] + "…"
    footer = textwrap.fill(short, int(_FOOTER_LETTERS * figure.get_figwidth()))
    figure.supxlabel(footer, fontsize=6.5, color=FAINT, x=0.01, ha="left")


def _round_corners(figure: Figure) -> None:
    """Put a card with round corners in the place of a figure's background."""
    figure.patch.set_visible(False)
    card = FancyBboxPatch(
        (0.0, 0.0),
        *figure.get_size_inches(),
        boxstyle=f"round,pad=0,rounding_size={_CORNER}",
        transform=figure.dpi_scale_trans,
        facecolor=BACKGROUND,
        linewidth=0,
        zorder=-1,
    )
    figure.add_artist(card)


def png(figure: Figure, dpi: int = 150, description: str | None = None) -> bytes:
    """Render a figure as PNG, with a description in its metadata, and close it."""
    _round_corners(figure)
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=dpi, metadata={"Description": description})
    plt.close(figure)
    return picture.getvalue()


def setting_label(finding: dict[str, Any]) -> str:
    """Label of a finding's setting, such as "glare 5 on gap"."""
    return f"{finding['fault']} {finding['severity']} on {finding['ground'].replace('_', ' ')}"


def noise_label(noise: str, level: float) -> str:
    """Label of a noise setting as in the paper, such as "GA 30 %"."""
    if noise == "none":
        return "no noise"
    short = {"gaussian": "GA", "salt_and_pepper": "SP"}.get(noise)
    if short is None:
        return f"{noise}, {fault_class(noise).describe(float(level))}"
    return f"{short} {100 * level:.0f} %"


def speed_over_time(
    curves: Mapping[str, Mapping[tuple[str, float], np.ndarray]], onset: float, command: float
) -> Figure:
    """The paper's comparison: mean forward velocity against timestep, a panel below the other.

    Args:
        curves: mode → (noise, level) → [T] m/s, mean over the robots.
        onset: time at which the noise begins, s.
        command: commanded speed, m/s.
    """
    size = (FIGURE_WIDTH, 2.6 * len(curves) + 1.0)
    figure, axes = plt.subplots(
        len(curves), 1, figsize=size, sharex=True, sharey=True, squeeze=False
    )
    column_of_axes = axes[:, 0]
    for axis, letter, (mode, settings) in zip(
        column_of_axes, "abcdef", curves.items(), strict=False
    ):
        shades = {noise: cycle(_NOISE_COLOURS.get(noise, ("#7d8590",))) for noise, _ in settings}
        for (noise, level), speed in settings.items():
            look: Any = {"color": next(shades[noise]), "label": noise_label(noise, level)}
            axis.plot(smooth(speed), "--" if noise == "none" else "-", **look)
        axis.axvline(onset / CONTROL_DT, color=INK, linewidth=1, linestyle=":")
        axis.axhline(command, color=FAINT, linewidth=1, linestyle=(0, (1, 3)))
        write_beside(axis, onset / CONTROL_DT, "noise begins", 0.0, xytext=(4, 5))
        axis.set(title=f"({letter}) {mode}", ylabel="mean forward\nvelocity (m/s)")
    column_of_axes[-1].set_xlabel("timestep (0.02 s)")
    legend(figure, column_of_axes[0])
    return figure


def smooth(values: np.ndarray) -> np.ndarray:
    """Centred moving mean over about half a gait cycle, shorter at both ends."""
    kernel = np.ones(13)
    total = np.convolve(values, kernel, "same")
    return total / np.convolve(np.ones_like(values), kernel, "same")


Cells = Mapping[tuple[str, str], tuple[float, str]]
"""Value in percent, which sets the colour, and text of each cell, by row and column."""


def mean_cells(
    runs: Sequence[dict[str, Any]],
    share: Callable[[dict[str, Any]], float],
    heading: str = "severity",
) -> Cells:
    """Mean shares of runs in percent, by fault and another column of the rows, the heading."""
    cells = {}
    for (fault, name), group in group_by(runs, "fault", heading).items():
        shares = np.array([100 * share(run) for run in group])
        shares = shares[~np.isnan(shares)]
        mean = shares.mean() if shares.size else np.nan
        text = f"{mean:.0f}" if shares.size else "–"
        cells[fault, str(name).replace("_", "\n")] = (mean, text)
    return cells


def colour_tables(
    panels: Mapping[str, Cells],
    title: str,
    xlabel: str = "",
    width: float = 0.42,
    stacked: bool = False,
    rotation: float = 0.0,
) -> Figure:
    """Coloured tables with the same rows, dark for 100, light for 0.

    Args:
        panels: cells of each table, by its title.
        title: title of the figure.
        xlabel: name of the columns' quantity.
        width: width of a column, inches.
        stacked: tables are below one another instead of side by side.
        rotation: rotation of the columns' names, degrees.
    """
    # Rows and columns of all panels, in the order in which they first occur.
    places = list(chain.from_iterable(panels.values()))
    rows = list(dict.fromkeys(row for row, _ in places))
    columns = list(dict.fromkeys(heading for _, heading in places))
    with plt.rc_context({"axes.grid": False, "axes.spines.left": False}):
        across = 1 if stacked else len(panels)
        down = len(panels) if stacked else 1
        size = (2.0 + width * len(columns) * across, 0.6 + (0.8 + 0.28 * len(rows)) * down)
        figure, axes = plt.subplots(down, across, figsize=size, sharey=True, squeeze=False)
        for axis, (name, panel) in zip(axes.flat, panels.items(), strict=True):
            shade = np.full((len(rows), len(columns)), np.nan)
            for (row, heading), (value, _) in panel.items():
                shade[rows.index(row), columns.index(heading)] = value
            # A range beyond 100 keeps the darkest cells from being black.
            axis.imshow(shade, vmin=0, vmax=130, cmap="Blues", aspect="auto")
            for (row, heading), (value, text) in panel.items():
                ink = "white" if value > 80 else INK
                place = (columns.index(heading), rows.index(row))
                axis.text(*place, text, ha="center", va="center", fontsize=9, color=ink)
            axis.set_xticks(range(len(columns)), columns, fontsize=9, rotation=rotation)
            axis.set_yticks(range(len(rows)), [row.replace("_", " ") for row in rows])
            axis.tick_params(length=0)
            axis.set(title=name, xlabel=xlabel)
        figure.suptitle(title, x=0.01, ha="left", fontsize=11)
        return figure


def share_panels(
    panels: Mapping[str, Sequence[dict[str, Any]]],
    name: str,
    tick: Callable[[dict[str, Any]], str],
    xlabel: str = "",
    rotation: float = 0.0,
) -> Figure:
    """Panels with shares of robots that cross and their intervals, a line for each mode.

    Args:
        panels: rows of a summary, by title; two panels are side by side.
        name: name of the share, see `metrics.share_columns`.
        tick: label of a row's place; places are evenly spaced, in the order in which their labels
            first occur.
        xlabel: label of the horizontal axis.
        rotation: rotation of the tick labels, degrees.
    """
    columns = min(len(panels), 2)
    rows = -(-len(panels) // columns)
    size = (FIGURE_WIDTH, 1.75 * rows + 0.9)
    figure, axes = plt.subplots(rows, columns, figsize=size, sharey=True, squeeze=False)
    for axis, (title, runs) in zip(axes.flat, panels.items(), strict=False):
        places = list(dict.fromkeys(map(tick, runs)))
        modes = group_by(runs, "mode")
        # Modes are side by side, or equal shares would hide each other.
        apart = 0.02 * max(len(places) - 1, 1)
        for number, ((mode,), line) in enumerate(modes.items()):
            shift = (number - (len(modes) - 1) / 2) * apart
            x = [places.index(tick(run)) + shift for run in line]
            look: Any = {"color": MODE_COLOURS[mode], "label": mode, "elinewidth": 1}
            draw_shares(axis, x, line, name, "o--" if mode == "blind" else "o-", **look)
        axis.set_xticks(range(len(places)), places, rotation=rotation)
        axis.set_title(title, fontsize=9)
    for axis in axes.flat[len(panels) :]:
        axis.set_axis_off()
    axes[0][0].set_ylim(-4, 104)
    for axis in axes[-1]:
        axis.set_xlabel(xlabel)
    figure.supylabel("robots that cross (%)", fontsize=10)
    legend(figure, axes[0][0])
    return figure


def draw_shares(
    axis: Axes,
    x: Sequence[float] | np.ndarray,
    runs: Sequence[Mapping[str, Any]],
    name: str,
    fmt: str = "o-",
    **look: Any,
) -> None:
    """Draw a line of shares of robots in percent, with their intervals.

    Args:
        axis: axis to draw on.
        x: place of each row, [rows].
        runs: rows of a summary.
        name: name of the share, see `metrics.share_columns`.
        fmt: format of the line.
        look: further arguments of `Axes.errorbar`.
    """
    rate = 100 * np.array(column(runs, f"{name}_rate"))
    low = 100 * np.array(column(runs, f"{name}_ci95_low"))
    high = 100 * np.array(column(runs, f"{name}_ci95_high"))
    interval = np.stack((rate - low, high - rate)).clip(min=0.0)
    axis.errorbar(x, rate, interval, fmt=fmt, markersize=4, **look)


def count_bars(counts: Mapping[str, int], of: int, title: str) -> Figure:
    """Bar for each mode, with its count out of `of` robots written on its end."""
    figure, axis = plt.subplots(figsize=(9, 0.9 + 0.55 * len(counts)))
    colours = [MODE_COLOURS[mode] for mode in counts]
    bars = axis.barh([*counts], [*counts.values()], color=colours)
    axis.bar_label(bars, [f"{count} of {of}" for count in counts.values()], padding=5)
    axis.set(title=title, xlim=(0, 1.15 * of), xticks=[])
    axis.grid(False)
    axis.invert_yaxis()
    axis.spines[["bottom", "left"]].set_visible(False)
    axis.tick_params(length=0, labelsize=11)
    return figure


def timeline(
    line: Mapping[str, Any], marks: Sequence[tuple[float, str]], beta: float, title: str
) -> Figure:
    """The paper's timeline of one robot: loss, threshold, estimator in charge and probability P.

    Args:
        line: `anomaly`, `probability` and `vision` (VP in charge) at each control step, [T] each.
        marks: times to point out, s, with their texts.
        beta: threshold on the anomaly score.
        title: title of the figure.
    """
    figure, axis = plt.subplots(figsize=(11, 3.7))
    vision = np.array(line["vision"], bool)
    # A robot has no score before its first tick, which a logarithmic axis would show as a dive.
    anomaly = np.array(line["anomaly"], float)
    anomaly[anomaly <= 0] = np.nan
    time = np.arange(len(anomaly)) * CONTROL_DT
    height = axis.get_xaxis_transform()
    axis.plot(time, anomaly, color=_LOSS, label="reconstruction loss")
    axis.axhline(beta, color="black", linestyle="--", linewidth=1.2, label="threshold β")
    for acts, colour, label in (
        (vision, SEES_COLOUR, "VP in charge"),
        (~vision, BLIND_COLOUR, "OP in charge"),
    ):
        look = {"color": colour, "alpha": 0.3, "linewidth": 0, "label": label}
        # A step's colour reaches until the next step.
        until_next = acts | np.insert(acts[:-1], 0, False)
        axis.fill_between(time, 0, 1, until_next, step="post", transform=height, **look)
    # Leave room above the curve for the marks' texts.
    top = 4 * np.max(anomaly, where=~np.isnan(anomaly), initial=beta)
    axis.set(yscale="log", ylim=(None, top), xlim=(0, time[-1]))
    axis.set(title=title, xlabel="time (s)", ylabel="anomaly score")
    for instant, text in marks:
        axis.axvline(instant, color=INK, linewidth=1, linestyle=":")
        write_beside(axis, instant, text, 1.0, xytext=(3, -10))
    right = axis.twinx()
    label = "vision probability P"
    right.plot(time, np.array(line["probability"]), "--", color=_PROBABILITY, label=label)
    right.set(ylim=(-0.05, 1.25), yticks=np.linspace(0, 1, 6))
    right.set_ylabel("P", color=_PROBABILITY)
    right.grid(False)
    legend(figure, axis, right)
    return figure


def write_beside(axis: Axes, instant: float, text: str, height: float, **look: Any) -> None:
    """Write a text beside an instant, at a share of the axis' height."""
    look = {"xytext": (0, 0), "textcoords": "offset points", "fontsize": 7.5} | look
    axis.annotate(text, (instant, height), xycoords=("data", "axes fraction"), **look)


def legend(figure: Figure, *axes: Axes) -> None:
    """Add a legend of the lines of some axes above a figure."""
    handles = []
    for axis in axes:
        handles += axis.get_legend_handles_labels()[0]
    # Rows of about as many entries as have room.
    rows = math.ceil(1.1 * len(handles) / figure.get_figwidth())
    look: Any = {"columnspacing": 1.2, "handlelength": 1.6, "fontsize": 9}
    columns = math.ceil(len(handles) / max(rows, 1))
    figure.legend(handles=handles, loc="outside upper center", ncols=columns, **look)
