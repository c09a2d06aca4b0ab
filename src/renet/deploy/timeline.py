"""A run in one picture: anomaly score, vision probability and speed over who was in charge."""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from renet.deploy.recording import MODES, Recording
from renet.deploy.safety import Mode
from renet.errors import RenetError

BANDS = {"damped or standing up": "#d7dade", "VP acts": "#bed5b4", "OP acts": "#f3c1bb"}
MAX_POINTS = 5000
"""Points of a curve; longer runs are thinned out."""
MAX_MARKS = 40
"""Events written into the picture."""


def draw_timeline(run: Recording, onsets: Sequence[float], path: Path) -> None:
    """Write a run's timeline.

    Args:
        run: read back. onsets: seconds from its start at which its camera was spoilt.
        path: of the picture; its ending says the format.

    Raises:
        RenetError: matplotlib is not installed, or the picture cannot be written.
    """
    try:
        from matplotlib.figure import Figure
    except ModuleNotFoundError as error:
        raise RenetError(
            "the timeline needs matplotlib: pip install 'renet-locomotion[sim]'"
        ) from error
    ticks = run.ticks[:: len(run.ticks) // MAX_POINTS + 1]
    time = ticks["now"] - ticks["now"][0] if len(ticks) else np.zeros(0)
    walking = ticks["mode"] == MODES.index(Mode.WALKING)
    vision = ticks["vision"]
    beta = float(run.header.get("beta") or 0.0)
    speed = np.where(vision[:, None], ticks["velocity_vp"], ticks["velocity_op"])[:, 0]
    panels = (
        ("anomaly score", [(ticks["anomaly"], "#3c3ca0")], beta),
        ("vision probability P", [(ticks["probability"], "#2f7d32")], 0.5),
        (
            "forward speed in m/s\n(black: asked)",
            [(ticks["speed"], "#222730"), (speed, "#b5532f")],
            None,
        ),
    )
    figure = Figure(figsize=(10, 6), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True)
    kind = np.where(walking, np.where(vision, 1, 2), 0)
    edges = [0, *(np.flatnonzero(np.diff(kind)) + 1), len(kind) - 1] if len(kind) else []
    for axis, (label, curves, line) in zip(axes, panels, strict=True):
        for first, last in pairwise(edges):
            colour = list(BANDS.values())[kind[first]]
            axis.axvspan(time[first], time[last], color=colour, linewidth=0)
        for values, colour in curves:
            shown = np.where(walking & np.isfinite(values) & (np.abs(values) < 1e6), values, np.nan)
            axis.plot(time, shown, color=colour, linewidth=1)
        if line is not None:
            axis.axhline(line, color="#555b66", linestyle="--", linewidth=0.8)
        axis.set_ylabel(label, parse_math=False, fontsize=8)
        for onset in onsets[:MAX_MARKS]:
            axis.axvline(onset, color="#a3121f", linestyle=":", linewidth=1)
    axes[-1].set_xlabel("s")
    axes[0].set_title(_title(run), fontsize=10, parse_math=False)
    for name, colour in BANDS.items():
        axes[0].bar(0, 0, color=colour, label=name)
    axes[0].legend(loc="upper right", fontsize=7, ncols=3)
    begun = run.ticks["now"][0] if len(run.ticks) else 0.0
    told = [event for event in run.events if event.what in ("op", "damping")][:MAX_MARKS]
    for row, event in enumerate(told):
        text = f"{event.what}: {event.why[:60]}"
        place = (event.time - begun, 0.85 - 0.15 * (row % 4))
        transform = axes[0].get_xaxis_transform()
        axes[0].text(*place, text, transform=transform, fontsize=7, parse_math=False, clip_on=True)
    try:
        figure.savefig(path)
    except OSError as error:
        raise RenetError(f"cannot write the timeline {path}: {error}") from error


def _title(run: Recording) -> str:
    header = run.header
    where = f" on {header['terrain']}" if header.get("terrain") else ""
    bundle = f"{header.get('bundle') or 'bundle'} {(header.get('bundle_sha256') or '')[:12]}"
    return f"{bundle}, {header.get('robot') or 'robot'}{where}"
