"""The figure of the terrain study."""

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from renet.evaluation import figures

SIZES = {
    "gap": "gap width",
    "platform": "platform height",
    "stairs_up": "riser of stairs up",
    "stairs_down": "riser of stairs down",
    "obstacles": "height of blocks",
    "rough": "relief",
}
"""What grows with the level of each kind of tile."""


def draw_success(summary: dict[str, Any]) -> Figure:
    """Draw the share of robots that cross against the size, one panel for each kind of tile."""
    kinds = list(dict.fromkeys(run["kind"] for run in summary["runs"]))
    columns = min(len(kinds), 2)
    lines = -(-len(kinds) // columns)
    figure, axes = plt.subplots(
        lines, columns, figsize=(9, 2.7 * lines + 0.6), sharey=True, squeeze=False
    )
    for axis, kind in zip(axes.flat, kinds, strict=False):
        runs = [run for run in summary["runs"] if run["kind"] == kind]
        _rates(axis, runs)
        axis.set(xlabel=f"{SIZES[kind]} (cm)", ylim=(-4, 104))
    for axis in axes.flat[len(kinds) :]:
        axis.set_axis_off()
    for line in axes:
        line[0].set_ylabel("robots that cross (%)")
    handles, labels = axes[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    return figure


def _rates(axis: Axes, runs: list[dict[str, Any]]) -> None:
    """Shares in percent against the size in cm, one line with its intervals for each mode."""
    modes = list(dict.fromkeys(run["mode"] for run in runs))
    sizes = sorted({100 * run["size_m"] for run in runs})
    apart = 0.012 * (sizes[-1] - sizes[0] or 1.0)
    for number, mode in enumerate(modes):
        line = [run for run in runs if run["mode"] == mode]
        share, *ends = (
            np.array([100 * run[name] for run in line])
            for name in ("success_rate", "success_ci95_low", "success_ci95_high")
        )
        # Side by side, or equal shares would hide each other.
        size = [100 * run["size_m"] + (number - (len(modes) - 1) / 2) * apart for run in line]
        look: dict[str, Any] = {
            "color": figures.MODE_COLOURS[mode],
            "label": figures.MODE_NAMES[mode],
        }
        axis.errorbar(
            size, share, np.abs(ends - share), fmt="o-", markersize=4, elinewidth=1, **look
        )
    axis.set_xticks(sizes, [f"{size:.0f}" for size in sizes])
