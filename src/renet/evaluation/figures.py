"""Figures: one look for all of them, drawn without a display, saved whole with their provenance."""

import io
from collections.abc import Callable, Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from renet.evaluation.results import Provenance, grouped
from renet.faults import fault_class
from renet.files import write_atomically
from renet.interface import CONTROL_DT
from renet.palette import BLIND, REMEMBERS, SEES

LOSS, PROBABILITY = "#3c3ca0", "#64aa5f"
FAMILIES = {
    "gaussian": ("#9ecae1", "#4292c6", "#084594"),
    "salt_and_pepper": ("#fdae6b", "#f16913", "#a63603"),
}
INK, FAINT = "#222730", "#8a919c"
MODE_COLOURS = {
    "camera": SEES,
    "memory": REMEMBERS,
    "blind": BLIND,
    "switch": "#009e73",
    "oracle": "#7d8590",
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
    # Names come from files and command lines: a dollar sign in them begins no formula.
    "text.parse_math": False,
}
"""Style under which every figure of a study is drawn and saved."""


def save(figure: Figure, path: Path, provenance: Provenance, dpi: int = 150) -> Path:
    """Write a PNG, atomically, with its provenance as last line and in its metadata.

    Ticks are made now, by matplotlib's present style.
    """
    line = provenance.line
    shown = line if len(line) <= 150 else line[:149] + "…"
    figure.supxlabel(shown, fontsize=6.5, color=FAINT, x=0.01, ha="left")
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=dpi, metadata={"Description": line})
    plt.close(figure)
    write_atomically(path, picture.getvalue(), "figure")
    return path


def png(figure: Figure, dpi: int = 150) -> bytes:
    """A figure as PNG, which is then closed."""
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=dpi)
    plt.close(figure)
    return picture.getvalue()


def setting_label(finding: dict[str, Any]) -> str:
    """A finding's setting, such as "glare 5 on gap"."""
    return f"{finding['fault']} {finding['severity']} on {finding['ground'].replace('_', ' ')}"


def noise_label(noise: str, level: float) -> str:
    """A noise setting as the paper writes it, such as "GA 30 %"."""
    if noise == "none":
        return "no noise"
    short = {"gaussian": "GA", "salt_and_pepper": "SP"}.get(noise)
    if short is None:
        return f"{noise}, {fault_class(noise).describe(float(level))}"
    return f"{short} {100 * level:.0f} %"


def speed_over_time(
    curves: Mapping[str, Mapping[tuple[str, float], np.ndarray]], onset: float, command: float
) -> Figure:
    """The paper's comparison: mean forward velocity against timestep, one panel for each mode.

    Args:
        curves: mode → (noise, level) → [T] m/s, mean over the robots.
        onset: seconds at which the noise begins. command: commanded speed, m/s.
    """
    figure, axes = plt.subplots(1, len(curves), figsize=(11, 4.2), sharey=True, squeeze=False)
    for axis, letter, (mode, settings) in zip(axes[0], "abcdef", curves.items(), strict=False):
        shades = {noise: cycle(FAMILIES.get(noise, ("#7d8590",))) for noise, _ in settings}
        for (noise, level), speed in settings.items():
            look: Any = {"color": next(shades[noise]), "label": noise_label(noise, level)}
            axis.plot(smooth(speed), "--" if noise == "none" else "-", **look)
        axis.axvline(onset / CONTROL_DT, color=INK, linewidth=1, linestyle=":")
        axis.axhline(command, color=FAINT, linewidth=1, linestyle=(0, (1, 3)))
        write_beside(axis, onset / CONTROL_DT, "noise begins", 0.0, xytext=(4, 5))
        axis.set(title=f"({letter}) {mode}", xlabel="timestep (0.02 s)")
    axes[0][0].set_ylabel("mean forward velocity (m/s)")
    legend(figure, axes[0][0])
    return figure


def smooth(values: np.ndarray) -> np.ndarray:
    """A centred moving mean over about half a gait cycle, shorter at both ends."""
    kernel = np.ones(13)
    total = np.convolve(values, kernel, "same")
    return total / np.convolve(np.ones_like(values), kernel, "same")


Cells = Mapping[tuple[str, str], tuple[float, str]]
"""Percent, which gives the colour, and text, by row and column."""


def mean_cells(
    runs: Sequence[dict[str, Any]],
    share: Callable[[dict[str, Any]], float],
    column: str = "severity",
) -> Cells:
    """Mean shares of the runs in percent, by fault and `column`."""
    cells = {}
    for (fault, name), group in grouped(runs, "fault", column).items():
        shares = np.array([100 * share(run) for run in group])
        shares = shares[~np.isnan(shares)]
        cell = (shares.mean(), f"{shares.mean():.0f}") if shares.size else (np.nan, "–")
        cells[fault, str(name).replace("_", "\n")] = cell
    return cells


def colour_tables(
    panels: Mapping[str, Cells], title: str, xlabel: str = "", width: float = 0.42
) -> Figure:
    """Coloured tables side by side with the same rows, dark for 100, light for 0.

    Args:
        panels: by title. title: of all.
        xlabel: what the columns are. width: of a column, inches.
    """
    rows = list(dict.fromkeys(row for panel in panels.values() for row, _ in panel))
    columns = list(dict.fromkeys(column for panel in panels.values() for _, column in panel))
    with plt.rc_context({"axes.grid": False, "axes.spines.left": False}):
        size = (2.2 + width * len(columns) * len(panels), 1.4 + 0.3 * len(rows))
        figure, axes = plt.subplots(1, len(panels), figsize=size, sharey=True, squeeze=False)
        for axis, (name, panel) in zip(axes[0], panels.items(), strict=True):
            shade = [[panel.get((r, c), (np.nan, ""))[0] for c in columns] for r in rows]
            axis.imshow(np.array(shade, float), vmin=0, vmax=130, cmap="Blues", aspect="auto")
            for (row, column), (value, text) in panel.items():
                ink = "white" if value > 80 else INK
                place = columns.index(column), rows.index(row)
                axis.text(*place, text, ha="center", va="center", fontsize=8, color=ink)
            axis.set_xticks(range(len(columns)), columns, fontsize=8)
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
    """Shares of robots that cross with their intervals, a line for each mode, up to four in a row.

    Args:
        panels: rows of a summary, by title.
        name: of the share, whose columns are NAME_rate, NAME_ci95_low and NAME_ci95_high.
        tick: a row's place, in even steps in the order in which these first occur.
        xlabel: what the horizontal axis shows. rotation: of its ticks' texts, degrees.
    """
    columns = min(len(panels), 4)
    rows = -(-len(panels) // columns)
    size = (max(2.5 * columns, 6.8) + 0.9, 2.4 * rows + 0.8)  # Wide enough for the legend.
    figure, axes = plt.subplots(rows, columns, figsize=size, sharey=True, squeeze=False)
    for axis, (title, runs) in zip(axes.flat, panels.items(), strict=False):
        places, modes = [*dict.fromkeys(map(tick, runs))], grouped(runs, "mode")
        # Side by side, or equal shares would hide each other.
        apart = 0.012 * max(len(places) - 1, 1)
        for number, ((mode,), line) in enumerate(modes.items()):
            ends = ("rate", "ci95_low", "ci95_high")
            share, *interval = np.array([[100 * run[f"{name}_{e}"] for run in line] for e in ends])
            x = [places.index(tick(run)) + (number - (len(modes) - 1) / 2) * apart for run in line]
            look: Any = {"color": MODE_COLOURS[mode], "label": mode}
            look |= {"fmt": "o--" if mode == "blind" else "o-", "markersize": 4, "elinewidth": 1}
            axis.errorbar(x, share, np.abs(interval - share), **look)
        axis.set_xticks(range(len(places)), places, rotation=rotation)
        axis.set_title(title, fontsize=9)
    for axis in axes.flat[len(panels) :]:
        axis.set_axis_off()
    axes[0][0].set_ylim(-4, 104)
    axes[-1][0].set_xlabel(xlabel)
    figure.supylabel("robots that cross (%)", fontsize=10)
    legend(figure, axes[0][0])
    return figure


def count_bars(counts: Mapping[str, int], of: int, title: str) -> Figure:
    """A bar for each mode with its count of `of` robots written on its end."""
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
    """The paper's timeline of one robot; see `draw_timeline`."""
    figure, axis = plt.subplots(figsize=(11, 3.7))
    right = draw_timeline(axis, line, marks, beta)
    axis.set(title=title, xlabel="time (s)", ylabel="anomaly score")
    legend(figure, axis, right)
    return figure


def draw_timeline(
    axis: Axes,
    line: Mapping[str, Any],
    marks: Sequence[tuple[float, str]],
    beta: float,
    every: float = CONTROL_DT,
) -> Axes:
    """Draw loss, threshold, the estimator in charge, and on a right axis, which is returned, P.

    Args:
        axis: to draw on.
        line: `anomaly`, `probability` and `vision` (VP in charge), [T] each, `every` s apart.
        marks: instants to point out, (seconds, text). beta: threshold.
    """
    vision = np.array(line["vision"], bool)
    # A robot that was set down has no score before its first tick.
    anomaly = np.array(line["anomaly"], float)
    anomaly[anomaly <= 0] = np.nan
    time, height = np.arange(len(anomaly)) * every, axis.get_xaxis_transform()
    axis.plot(time, anomaly, color=LOSS, label="reconstruction loss")
    axis.axhline(beta, color="black", linestyle="--", linewidth=1.2, label="threshold β")
    for acts, colour, label in ((vision, SEES, "VP in charge"), (~vision, BLIND, "OP in charge")):
        look = {"color": colour, "alpha": 0.3, "linewidth": 0, "label": label}
        until_next = acts | np.insert(acts[:-1], 0, False)
        axis.fill_between(time, 0, 1, until_next, step="post", transform=height, **look)
    top = 4 * np.max(anomaly, where=~np.isnan(anomaly), initial=beta)
    axis.set(yscale="log", ylim=(None, top), xlim=(0, time[-1]))
    for instant, text in marks:
        axis.axvline(instant, color=INK, linewidth=1, linestyle=":")
        write_beside(axis, instant, text, 1.0, xytext=(3, -10))
    right = axis.twinx()
    label = "vision probability P"
    right.plot(time, np.array(line["probability"]), "--", color=PROBABILITY, label=label)
    right.set(ylim=(-0.05, 1.25), yticks=np.linspace(0, 1, 6))
    right.set_ylabel("P", color=PROBABILITY)
    right.grid(False)
    return right


def write_beside(axis: Axes, instant: float, text: str, height: float, **look: Any) -> None:
    """Write beside an instant, at a share of the axis' height."""
    look = {"xytext": (0, 0), "textcoords": "offset points", "fontsize": 7.5} | look
    axis.annotate(text, (instant, height), xycoords=("data", "axes fraction"), **look)


def legend(figure: Figure, *axes: Axes) -> None:
    """Explain the lines of some axes above a figure."""
    handles = [handle for axis in axes for handle in axis.get_legend_handles_labels()[0]]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), fontsize=9)
