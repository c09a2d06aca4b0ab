"""The figure of the terrain study."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt

from renet.evaluation.report import figures
from renet.evaluation.results import Provenance

SIZES = {
    "gap": "gap width",
    "platform": "platform height",
    "stairs_up": "riser of stairs up",
    "stairs_down": "riser of stairs down",
    "obstacles": "height of blocks",
    "rough": "relief",
}
"""What grows with the level of each kind of tile."""


def draw_success(summary: dict[str, Any], path: Path, provenance: Provenance) -> Path:
    """Draw the share of robots that cross against the size, one panel for each kind of tile.

    Args:
        summary: of a terrain study.
        path: of the PNG.
        provenance: of the numbers.
    """
    kinds = list(dict.fromkeys(run["kind"] for run in summary["runs"]))
    columns = min(len(kinds), 2)
    lines = -(-len(kinds) // columns)
    with plt.rc_context(figures.STYLE):
        figure, axes = plt.subplots(
            lines, columns, figsize=(9, 2.7 * lines + 0.6), sharey=True, squeeze=False
        )
        for axis, kind in zip(axes.flat, kinds, strict=False):
            runs = [run for run in summary["runs"] if run["kind"] == kind]
            figures.rates(axis, runs, "size_m", "success_rate", "success_ci95")
            axis.set(xlabel=f"{SIZES[kind]} (cm)", ylim=(-4, 104))
        for axis in axes.flat[len(kinds) :]:
            axis.set_axis_off()
        for line in axes:
            line[0].set_ylabel("robots that cross (%)")
        handles, labels = axes[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
        return figures.save(figure, path, provenance)
