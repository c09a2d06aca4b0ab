"""Timeline of a run: its monitors, vision probability and speed over its states."""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from renet.deploy.controller import UNSEEN_EVENT
from renet.deploy.recording.objections import legend_of, objectors
from renet.deploy.recording.reader import Recording
from renet.deploy.recording.tick import MODES
from renet.deploy.safety.machine import Mode
from renet.errors import RenetError, install
from renet.files import write_atomically
from renet.palette import STATES
from renet.selector.selector import BLIND, REMEMBERS

TIMELINE = "timeline.svg"
"""File name of a timeline."""
BANDS = (("#9aa0a8", "damped or standing up"), *STATES.values())
"""Colours and names of the states of a run: damped or standing up, then the selector's."""
_MAX_REASON = 90
"""Largest number of characters of a reason in the picture: half of its width."""
_MAX_POINTS = 5000
"""Largest number of points of a curve; longer runs are thinned out."""
_CUT = 3.0
"""Multiple of the threshold at which a monitor's curve is cut off."""
_MAX_MARKS = 40
"""Largest number of events and of onsets in the picture."""


@dataclass(frozen=True)
class _Panel:
    """Curves over time in one part of a timeline."""

    label: str
    curves: list[tuple[np.ndarray, str]]
    """Values [T] of each curve, and its colour."""
    line: float | None = None
    """Height of a dashed line."""


def draw_run(run: Recording, onsets: Sequence[float], path: Path) -> None:
    """Draw the monitors that objected, vision probability and speed over the states of a run.

    Args:
        run: Run to draw.
        onsets: Times at which vision was spoilt, s from the run's start.
        path: Path of the picture; its ending gives the format.

    Raises:
        RenetError: Matplotlib is not installed, or the picture cannot be written.
    """
    try:
        from matplotlib.figure import Figure
    except ModuleNotFoundError as error:
        raise RenetError(f"the timeline needs matplotlib: {install('sim')}") from error
    every = len(run.ticks) // _MAX_POINTS + 1
    ticks = run.ticks[::every]
    time = ticks["now"] - ticks["now"][0] if len(ticks) else np.zeros(0)
    ratios = objectors(run)
    monitors = []
    for number, values in enumerate(ratios.values()):
        monitors.append((np.minimum(values[::every], _CUT), f"C{number}"))
    figure = Figure(figsize=(10, 6), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True)
    panels = _panels(ticks, monitors, run.header.get("told") == "twist")
    for axis, panel in zip(axes, panels, strict=True):
        _draw_panel(axis, panel, ticks, time)
        for onset in onsets[:_MAX_MARKS]:
            axis.axvline(onset, color="#a3121f", linestyle=":", linewidth=1)
    axes[-1].set_xlabel("s")
    axes[0].set_title(_title(run), fontsize=10, parse_math=False)
    _add_legends(figure, axes[0], [legend_of(name) for name in ratios])
    _add_events(axes[0], run, time)
    picture = io.BytesIO()
    figure.savefig(picture, format=path.suffix[1:])
    write_atomically(path, picture.getvalue(), "timeline")


def _panels(
    ticks: np.ndarray, monitors: list[tuple[np.ndarray, str]], twist: bool
) -> tuple[_Panel, ...]:
    """Panels of a timeline from top to bottom.

    Args:
        ticks: Ticks, [T].
        monitors: Curves of the monitors, [T] each, and their colours.
        twist: True for a policy that is told a velocity, which may lead to the side.
    """
    told = ticks["told"]
    velocity = np.where(ticks["vision"][:, None], ticks["velocity_vp"], ticks["velocity_op"])
    speeds = [(told[:, 0], "#222730"), (velocity[:, 0], "#b5532f")]
    label = "forward speed in m/s\n(black: commanded)"
    if twist and told[:, 1].any():
        speeds += [(told[:, 1], "#9aa0a8"), (velocity[:, 1], "#dfae9b")]
        label = "speed in m/s, pale: to the left\n(black, grey: commanded)"
    return (
        _Panel(f"monitors: score / threshold\n(1: objects; cut at {_CUT:g})", monitors, 1.0),
        _Panel("vision probability P", [(ticks["probability"], "#2f7d32")], 0.5),
        _Panel(label, speeds),
    )


def _draw_panel(axis: Any, panel: _Panel, ticks: np.ndarray, time: np.ndarray) -> None:
    """Draw a panel's curves over bands of the states at ticks [T] and their times [T] s."""
    walking = ticks["mode"] == MODES.index(Mode.WALKING)
    # Numbers of `BANDS`.
    seeing = np.where(ticks["has_image"], 1, 2)
    acting = np.where(walking, np.where(ticks["vision"], seeing, 3), 0)
    height = axis.get_xaxis_transform()
    for kind, (colour, name) in enumerate(BANDS):
        look = {"color": colour, "alpha": 0.3, "lw": 0, "label": name}
        axis.fill_between(time, 0, 1, acting == kind, transform=height, **look)
    for values, colour in panel.curves:
        shown = np.where(walking & np.isfinite(values) & (np.abs(values) < 1e6), values, np.nan)
        axis.plot(time, shown, color=colour, linewidth=1)
    if panel.line is not None:
        axis.axhline(panel.line, color="#555b66", linestyle="--", linewidth=0.8)
    axis.set_ylabel(panel.label, parse_math=False, fontsize=8)


def _add_events(axis: Any, run: Recording, time: np.ndarray) -> None:
    """Write changes for the worse and their reasons into an axis with times [T] s."""
    begun = run.ticks["now"][0] if len(run.ticks) else 0.0
    whats = (REMEMBERS, UNSEEN_EVENT, BLIND, Mode.DAMPING)
    events = [event for event in run.events if event.what in whats]
    for row, event in enumerate(events[:_MAX_MARKS]):
        why = event.why if len(event.why) <= _MAX_REASON else f"{event.why[: _MAX_REASON - 1]}…"
        text = f"{event.what}: {why}"
        # Neighbours are written at different heights, towards the middle of the picture.
        place = (event.time - begun, 0.85 - 0.15 * (row % 4))
        look = {"transform": axis.get_xaxis_transform(), "fontsize": 7, "parse_math": False}
        side = "left" if place[0] < time.max(initial=0.0) / 2 else "right"
        axis.text(*place, text, ha=side, clip_on=True, **look)


def _add_legends(figure: Any, axis: Any, monitors: Sequence[str]) -> None:
    """Add legends of the states, and of the monitors, whose curves are the axis' first lines.

    They are outside of the axis, in which the reasons of events are written.
    """
    bands, names = axis.get_legend_handles_labels()
    look = {"fontsize": 7, "ncols": len(BANDS)}
    figure.legend(bands[: len(BANDS)], names[: len(BANDS)], loc="outside lower center", **look)
    if monitors:
        lines = axis.get_lines()[: len(monitors)]
        figure.legend(lines, monitors, loc="outside upper center", **look | {"ncols": 2})


def _title(run: Recording) -> str:
    """Title of a timeline: bundle, robot and terrain."""
    header = run.header
    where = f" on {header['terrain']}" if header.get("terrain") else ""
    bundle = f"{header.get('bundle') or 'bundle'} {(header.get('bundle_sha256') or '')[:12]}"
    return f"{bundle}, {header.get('robot') or 'robot'}{where}"
