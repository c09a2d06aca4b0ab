"""Figures of studies in one style, drawn without a display and saved with their provenance.

Each is a card of its own colour with round corners, on a light page and on a dark one. Where it has
several panels they are below one another, so that its words are legible on a telephone.
"""

import io
import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch
from matplotlib.ticker import LogFormatter, StrMethodFormatter

from renet.evaluation.results import Provenance, column, group_by
from renet.files import write_atomically
from renet.palette import BLIND_COLOUR, REMEMBERS_COLOUR, SEES_COLOUR

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
_TITLE_LETTERS = 12
"""Letters of a figure's title in an inch."""
_PANEL_LETTERS = 9
"""Letters of a panel's title, which is bold, in an inch."""
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
    letters = int(_FOOTER_LETTERS * figure.get_figwidth())
    # A hyphen may be part of a command.
    footer = textwrap.fill(short, letters, break_on_hyphens=False)
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


def label_log_ticks(axis: Axis) -> None:
    """Label the ticks of a logarithmic axis with plain numbers, such as 0.01.

    matplotlib's own labels are formulae, which `STYLE` draws as they are written.
    """
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    # It labels them only where there are hardly any major ticks.
    axis.set_minor_formatter(LogFormatter())


def setting_label(finding: dict[str, Any]) -> str:
    """Return the label of a finding's setting, such as "glare 5 on gap"."""
    return f"{finding['fault']} {finding['severity']} on {finding['ground'].replace('_', ' ')}"


Cells = Mapping[tuple[str, str], tuple[float, str]]
"""Value in percent, which sets the colour, and text of each cell, by row and column."""


def mean_cells(
    runs: Sequence[dict[str, Any]],
    share: Callable[[dict[str, Any]], float],
    heading: str = "severity",
) -> Cells:
    """Average shares of runs, in percent, by fault and another column of the rows, `heading`."""
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
    """Draw coloured tables with the same rows, dark for 100, light for 0.

    Args:
        panels: Cells of each table, by its title.
        title: Title of the figure.
        xlabel: Name of the columns' quantity.
        width: Smallest width of a column, inches.
        stacked: Tables are below one another instead of side by side.
        rotation: Rotation of the columns' names, degrees.
    """
    # Rows and columns of all panels, in the order in which they first occur.
    places = list(chain.from_iterable(panels.values()))
    rows = list(dict.fromkeys(row for row, _ in places))
    columns = list(dict.fromkeys(heading for _, heading in places))
    # A table is at least as wide as its title.
    width = max(width, max(map(len, panels)) / (_PANEL_LETTERS * len(columns)))
    with plt.rc_context({"axes.grid": False, "axes.spines.left": False}):
        across = 1 if stacked else len(panels)
        down = len(panels) if stacked else 1
        figure_width = 2.0 + width * len(columns) * across
        lines = textwrap.wrap(title, int(_TITLE_LETTERS * figure_width))
        height = 0.4 + 0.2 * len(lines) + (0.8 + 0.28 * len(rows)) * down
        size = (figure_width, height)
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
        figure.suptitle("\n".join(lines), x=0.01, ha="left", fontsize=11)
        return figure


def share_panels(
    panels: Mapping[str, Sequence[dict[str, Any]]],
    name: str,
    tick: Callable[[dict[str, Any]], str],
    xlabel: str = "",
    rotation: float = 0.0,
) -> Figure:
    """Draw panels of the shares of robots that cross, with intervals, a line for each mode.

    Args:
        panels: Rows of a summary, by title; two panels are side by side.
        name: Name of the share, see `metrics.share_columns`.
        tick: Label of a row's place; places are evenly spaced, in the order in which their labels
            first occur.
        xlabel: Label of the horizontal axis.
        rotation: Rotation of the tick labels, degrees.
    """
    columns = min(len(panels), 2)
    rows = math.ceil(len(panels) / columns)
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
        axis: Axis to draw on.
        x: Place of each row, [rows].
        runs: Rows of a summary.
        name: Name of the share, see `metrics.share_columns`.
        fmt: Format of the line.
        look: Further arguments of `Axes.errorbar`.
    """
    rate = 100 * np.array(column(runs, f"{name}_rate"))
    low = 100 * np.array(column(runs, f"{name}_ci95_low"))
    high = 100 * np.array(column(runs, f"{name}_ci95_high"))
    interval = np.stack((rate - low, high - rate)).clip(min=0.0)
    axis.errorbar(x, rate, interval, fmt=fmt, markersize=4, **look)


def count_bars(counts: Mapping[str, int], of: int, title: str) -> Figure:
    """Draw a bar for each mode, with its count out of `of` robots written on its end."""
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


def legend(figure: Figure, *axes: Axes) -> None:
    """Add a legend of the lines of some axes above a figure, each label once.

    Long labels have more rows, so that the legend is no wider than the figure.
    """
    entries: dict[str, Any] = {}
    for axis in axes:
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    # Rows of about as many entries as have room.
    rows = max(math.ceil(1.1 * len(entries) / figure.get_figwidth()), 1)
    look: Any = {"columnspacing": 1.2, "handlelength": 1.6, "fontsize": 9}
    place = "outside upper center"
    for columns in range(math.ceil(len(entries) / rows), 0, -1):
        drawn = figure.legend([*entries.values()], [*entries], loc=place, ncols=columns, **look)
        if columns == 1 or drawn.get_window_extent().width <= figure.bbox.width:
            return
        drawn.remove()
