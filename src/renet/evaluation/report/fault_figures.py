"""Figures of the fault benchmark: survival and detection at a glance, curves, and a gallery."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from renet.evaluation import figures
from renet.evaluation.report.example_scene import example
from renet.faults import FAULTS, SEVERITIES

Runs = list[dict[str, Any]]
SHADES = ("#b7b2e0", "#7d76c9", "#3c3ca0", "#2a2a78", "#14143f")
"""Of severities 1 to 5."""


def draw_crossed(runs: Runs, modes: Sequence[str]) -> Figure:
    """A table of colours: share of robots that cross, faults by grounds, mode by mode."""
    panels = {
        figures.MODE_NAMES[mode]: _cells(
            [run for run in runs if run["mode"] == mode],
            lambda run: run["measures"]["crossed"]["value"],
            "ground",
        )
        for mode in modes
    }
    title = "Robots that cross (%), all severities and onsets together"
    return figures.colour_tables(panels, title, width=0.62)


def draw_survival(runs: Runs, modes: Sequence[str]) -> Figure:
    """A table of colours: share of robots on their feet, faults by severities, mode by mode."""
    panels = {
        figures.MODE_NAMES[mode]: _cells(
            [run for run in runs if run["mode"] == mode], lambda run: run["survival"]
        )
        for mode in modes
    }
    title = "Robots on their feet (%), all grounds and onsets together"
    return figures.colour_tables(panels, title, "severity")


def draw_detection(runs: Runs) -> Figure:
    """Two tables: share of robots that noticed, under the selector used and the paper's rule."""
    ours = [run for run in runs if run["mode"] == "renet"] or runs
    panels = {
        name: _cells(ours, lambda run, key=key: _share(run[key], run["vision_active_at_onset"]))
        for name, key in (
            ("RENet's selector", "detected"),
            ("the paper's rule alone", "detected_by_paper"),
        )
    }
    title = "Robots with vision that noticed the fault while it lasted (%)"
    return figures.colour_tables(panels, title, "severity")


def _share(count: int, total: int) -> float:
    """`count` of `total`; NaN of nothing."""
    return count / total if total else np.nan


def _cells(
    runs: Runs, value: Callable[[dict[str, Any]], float], column: str = "severity"
) -> figures.Cells:
    """Mean shares in percent by fault and `column`."""
    found: dict[tuple[str, str], list[float]] = {}
    for run in runs:
        name = str(run[column]).replace("_", "\n")
        found.setdefault((run["fault"], name), []).append(100 * value(run))
    shares = {key: np.array(values)[~np.isnan(values)] for key, values in found.items()}
    return {
        key: (s.mean(), f"{s.mean():.0f}") if s.size else (np.nan, "–") for key, s in shares.items()
    }


def draw_roc(curves: Mapping[str, list[dict[str, Any]]]) -> Figure:
    """One panel for each fault: could a threshold tell its frames from healthy ones?"""
    columns = min(6, len(curves))
    rows = -(-len(curves) // columns)
    figure, axes = plt.subplots(
        rows, columns, figsize=(1.9 * columns + 0.4, 2.1 * rows + 0.9), squeeze=False
    )
    for axis, (fault, found) in zip(axes.flat, curves.items(), strict=False):
        _draw_curves(axis, found)
        axis.set_title(fault.replace("_", " "), fontsize=9)
    for axis in axes.flat[len(curves) :]:
        axis.set_axis_off()
    for axis in axes[-1]:
        axis.set_xlabel("false alarms", fontsize=8)
    for axis in axes[:, 0]:
        axis.set_ylabel("caught", fontsize=8)
    handles, labels = axes.flat[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right center", fontsize=8)
    figure.suptitle(
        "Frames before and after the onset: all monitors (lines), reconstruction alone (dots)",
        x=0.01,
        ha="left",
        fontsize=11,
    )
    return figure


def _draw_curves(axis: Axes, found: list[dict[str, Any]]) -> None:
    axis.plot([0, 1], [0, 1], color=figures.FAINT, linewidth=0.6)
    for curve in found:
        colour, label = SHADES[curve["severity"] - 1], f"severity {curve['severity']}"
        axis.plot(*curve["monitors"], color=colour, linewidth=1.4, label=label)
        axis.plot(*curve["reconstruction"], color=colour, linewidth=1.1, linestyle=":")
    axis.set(xlim=(-0.02, 1.02), ylim=(-0.02, 1.05), xticks=(0, 0.5, 1), yticks=(0, 0.5, 1))
    axis.tick_params(labelsize=7)


def draw_gallery(faults: Sequence[str], seed: int) -> Figure:
    """One picture of each fault at each severity; faults of time look like a healthy image."""
    framed: dict[Any, Any] = dict.fromkeys(("axes.spines.top", "axes.spines.right"), True)
    with plt.rc_context({**figures.STYLE, **framed, "axes.grid": False}):
        size = (1.6 * len(SEVERITIES) + 1.6, 1.22 * len(faults))
        figure, axes = plt.subplots(len(faults), len(SEVERITIES), figsize=size, squeeze=False)
        for row, fault in zip(axes, faults, strict=True):
            for axis, severity in zip(row, SEVERITIES, strict=True):
                axis.imshow(example(fault, severity, seed), cmap="gray", vmin=0, vmax=1)
                level = FAULTS[fault].level_of(severity)
                axis.set_title(
                    FAULTS[fault].describe(level), fontsize=8, loc="center", fontweight="normal"
                )
                axis.set(xticks=[], yticks=[])
            row[0].set_ylabel(fault.replace("_", " "), fontsize=8, rotation=0, ha="right")
        return figure
