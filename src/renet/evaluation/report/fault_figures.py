"""Figures of the fault benchmark: survival and detection at a glance, and a gallery."""

from collections.abc import Callable, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from renet.evaluation import figures
from renet.evaluation.report.example_scene import example
from renet.faults import FAULTS, SEVERITIES

Runs = list[dict[str, Any]]


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
        name: _cells(
            ours, lambda run, key=key: run[key] / (run["vision_active_at_onset"] or np.nan)
        )
        for name, key in (
            ("RENet's selector", "detected"),
            ("the paper's rule alone", "detected_by_paper"),
        )
    }
    title = "Robots with vision that noticed the fault while it lasted (%)"
    return figures.colour_tables(panels, title, "severity")


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
