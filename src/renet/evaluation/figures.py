"""Figures: one look for all of them, drawn without a display, saved whole with their provenance."""

import io
from collections.abc import Callable, Mapping, Sequence
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
from renet.files import write_atomically
from renet.interface import CONTROL_DT
from renet.palette import BLIND, SEES

BAND = 0.3
"""Opacity of what is behind a timeline."""
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
    "paper": "#b08bd0",
    "oracle-switch": "#7d8590",
}
MODE_NAMES = {
    "vp": "VP alone",
    "renet": "RENet",
    "op": "OP alone",
    "paper": "paper's switch",
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


def setting_label(finding: dict[str, Any]) -> str:
    """A finding's setting, such as "glare 5 on gap"."""
    return f"{finding['fault']} {finding['severity']} on {finding['ground'].replace('_', ' ')}"


def noise_label(noise: str, level: float) -> str:
    """A noise setting as the paper writes it, such as "GA 30 %"."""
    short = {"gaussian": "GA", "salt_and_pepper": "SP"}
    return "no noise" if noise == "none" else f"{short.get(noise, noise)} {100 * level:.0f} %"


def speed_over_time(
    curves: Mapping[str, Mapping[tuple[str, float], np.ndarray]], onset: float, command: float
) -> Figure:
    """The paper's comparison: mean forward velocity against timestep, one panel for each mode.

    Args:
        curves: mode → (noise, level) → [T] m/s, mean over the robots.
        onset: seconds at which the noise begins.
        command: commanded speed, m/s.
    """
    figure, axes = plt.subplots(1, len(curves), figsize=(11, 4.2), sharey=True, squeeze=False)
    for axis, letter, (mode, settings) in zip(axes[0], "abcdef", curves.items(), strict=False):
        used: dict[str, int] = {}
        for (noise, level), speed in settings.items():
            shade = used[noise] = used.get(noise, -1) + 1
            colour = FAMILIES.get(noise, ("#7d8590",))[shade % 3 if noise in FAMILIES else 0]
            style = "--" if noise == "none" else "-"
            axis.plot(smooth(speed), style, color=colour, label=noise_label(noise, level))
        axis.axvline(onset / CONTROL_DT, color=INK, linewidth=1, linestyle=":")
        axis.axhline(command, color=FAINT, linewidth=1, linestyle=(0, (1, 3)))
        _write(axis, onset / CONTROL_DT, "noise begins", 0.0, xytext=(4, 5))
        axis.set(title=f"({letter}) {MODE_NAMES[mode]}", xlabel="timestep (0.02 s)")
    axes[0][0].set_ylabel("mean forward velocity (m/s)")
    handles, labels = axes[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), fontsize=9)
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
    groups: dict[tuple[str, str], list[float]] = {}
    for run in runs:
        name = str(run[column]).replace("_", "\n")
        groups.setdefault((run["fault"], name), []).append(100 * share(run))
    shares = {key: np.array(values)[~np.isnan(values)] for key, values in groups.items()}
    return {
        key: (s.mean(), f"{s.mean():.0f}") if s.size else (np.nan, "–") for key, s in shares.items()
    }


def colour_tables(
    panels: Mapping[str, Cells], title: str, xlabel: str = "", width: float = 0.42
) -> Figure:
    """Coloured tables side by side with the same rows, green for 100, red for 0.

    Args:
        panels: by title.
        title: of all.
        xlabel: what the columns are.
        width: of a column, inches.
    """
    rows = list(dict.fromkeys(row for panel in panels.values() for row, _ in panel))
    columns = list(dict.fromkeys(column for panel in panels.values() for _, column in panel))
    with plt.rc_context({"axes.grid": False, "axes.spines.left": False}):
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
        return figure


def bands(axis: Axes, vision: np.ndarray, every: float = CONTROL_DT) -> None:
    """Behind a timeline, whether VP is in charge or OP; `vision` is [T] bool, `every` s apart."""
    edges = np.flatnonzero(np.diff(vision.astype(int))) + 1
    for start, end in zip([0, *edges], [*edges, len(vision)], strict=True):
        colour = SEES if vision[start] else BLIND
        axis.axvspan(start * every, end * every, color=colour, alpha=BAND, linewidth=0)


def timelines(
    lines: Sequence[Mapping[str, Any]],
    marks: Sequence[Sequence[tuple[float, str]]],
    beta: float,
    title: str,
    events: Sequence[Sequence[tuple[float, str]]] = (),
    every: float = CONTROL_DT,
) -> Figure:
    """The paper's timeline, line by line: loss, threshold, P_t and the estimator in charge.

    Args:
        lines: `anomaly`, `probability` and `vision` (VP in charge), [T] each.
        marks: instants to point out in each line, (seconds, text).
        beta: threshold.
        title: of the figure.
        events: what went wrong in each line, (seconds, text).
        every: seconds between values.
    """
    height = 2.8 if len(lines) == 1 else 1.75
    size = (11, height * len(lines) + 0.9)
    figure, axes = plt.subplots(len(lines), 1, figsize=size, squeeze=False)
    for number, (axis, line) in enumerate(zip(axes[:, 0], lines, strict=True)):
        bands(axis, np.array(line["vision"], bool), every)
        right = _loss_and_probability(axis, line, beta, every)
        axis.set_ylabel("anomaly score" if len(lines) == 1 else f"lap {number + 1}")
        for instant, text in marks[number]:
            axis.axvline(instant, color=INK, linewidth=1, linestyle=":")
            _write(axis, instant, text, 1.0, xytext=(3, -10))
        for instant, text in events[number] if events else ():
            _write(axis, instant, text, 0.04, ha="right", fontweight="bold", color="#9c1f12")
    axes[0, 0].set_title(title)
    axes[-1, 0].set_xlabel("time (s)")
    keys = [Rectangle((0, 0), 1, 1, color=c, alpha=BAND) for c in (SEES, BLIND)]
    named = axes[-1, 0].get_legend_handles_labels(), right.get_legend_handles_labels()
    figure.legend(
        [*named[0][0], *named[1][0], *keys],
        [*named[0][1], *named[1][1], "VP in charge", "OP in charge"],
        loc="outside upper center",
        ncols=5,
        fontsize=9,
    )
    return figure


def _write(axis: Axes, instant: float, text: str, height: float, **look: Any) -> None:
    """Write beside an instant, at a share of the axis' height."""
    look = {"xytext": (0, 0), "textcoords": "offset points", "fontsize": 7.5} | look
    axis.annotate(text, (instant, height), xycoords=("data", "axes fraction"), **look)


def _loss_and_probability(axis: Axes, line: Mapping[str, Any], beta: float, every: float) -> Axes:
    """Draw loss and threshold on `axis` and P_t on its right, which is returned."""
    # A robot that was set down has no score before its first tick.
    anomaly = np.array(line["anomaly"], float)
    anomaly[anomaly <= 0] = np.nan
    time = np.arange(len(anomaly)) * every
    axis.plot(time, anomaly, color=LOSS, label="reconstruction loss")
    axis.axhline(beta, color="black", linestyle="--", linewidth=1.2, label="threshold β")
    axis.set_yscale("log")
    axis.set_ylim(top=4 * np.max(anomaly, where=~np.isnan(anomaly), initial=beta))
    axis.set_xlim(0, time[-1])
    right = axis.twinx()
    label = "vision probability $P_t$"
    right.plot(time, np.array(line["probability"]), "--", color=PROBABILITY, label=label)
    right.set(ylim=(-0.05, 1.25), yticks=np.linspace(0, 1, 6))
    right.set_ylabel("$P_t$", color=PROBABILITY)
    right.grid(False)
    return right
