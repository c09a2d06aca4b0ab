"""Figures of the course: the selector's timeline, lap by lap, and how each passage went."""

from collections.abc import Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from renet.evaluation import figures
from renet.interface import CONTROL_DT, STEPS_PER_TICK

ENDS = {"crossed": "#7fb98d", "stuck": "#e9c46a", "fell": "#d1584b"}
"""How a passage ends, and its colour."""


def draw_timelines(laps: Sequence[dict[str, Any]], lap: Sequence[str], beta: float) -> Figure:
    """The paper's figure: loss, P_t and the estimator in charge, one line for each lap.

    Args:
        laps: the laps' timelines, at 10 Hz.
        lap: kinds of passage.
        beta: threshold.
    """
    every, marks, events = CONTROL_DT * STEPS_PER_TICK, [], []
    for line in laps:
        where = [int(i) for i in line["passage"]]
        starts = [k for k in range(len(where)) if k == 0 or where[k] != where[k - 1]]
        marks.append([(k * every, lap[where[k]]) for k in starts])
        events.append([(instant, name) for name in ("fell", "stuck") for instant in line[name]])
    return figures.timelines(laps, marks, beta, "", events, every)


def draw_passages(passages: Sequence[dict[str, Any]]) -> Figure:
    """Shares of tries on each kind of passage that were crossed, got stuck or fell, by mode."""
    modes = list(dict.fromkeys(row["mode"] for row in passages))
    kinds = list(dict.fromkeys(row["kind"] for row in passages))
    with plt.rc_context({"axes.grid": False}):
        figure, axes = plt.subplots(
            1, len(modes), figsize=(9, 0.32 * len(kinds) + 1.5), sharey=True, squeeze=False
        )
        for axis, mode in zip(axes[0], modes, strict=True):
            rows = {row["kind"]: row for row in passages if row["mode"] == mode}
            left = np.zeros(len(kinds))
            for end, colour in ENDS.items():
                share = np.array([100 * rows[k][end] / max(rows[k]["tries"], 1) for k in kinds])
                axis.barh(kinds, share, left=left, color=colour, label=end, height=0.72)
                left += share
            for y, kind in enumerate(kinds):
                row = rows[kind]
                text = f"{row['crossed']} of {row['tries']}"
                axis.text(2, y, text, va="center", fontsize=8, color=figures.INK)
            axis.set(title=figures.MODE_NAMES[mode], xlabel="tries (%)", xlim=(0, 100))
            axis.tick_params(axis="y", length=0)
        axes[0][0].invert_yaxis()
        handles, labels = axes[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), fontsize=9)
        return figure
