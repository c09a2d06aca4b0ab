"""A flight in one picture: anomaly score, vision probability and speed over the paper's bands.

Written as SVG by hand, so that a robot's computer needs no plotting package.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from itertools import pairwise

import numpy as np

from renet.deploy.flight_log import MODES, Flight
from renet.deploy.safety import Mode

WIDTH, LEFT, RIGHT, TOP, PANEL, SPACE, BOTTOM = 960, 64, 20, 84, 120, 34, 30
INNER = WIDTH - LEFT - RIGHT
MAX_POINTS = 5000
"""Of a curve; longer flights are thinned out."""
BANDS = {"damped or rising": "#d7dade", "VP acts": "#bed5b4", "OP acts": "#f3c1bb"}
LOSS, PROBABILITY, SPEED, COMMAND, FAULT, GREY = (
    "#3c3ca0",
    "#2f7d32",
    "#b5532f",
    "#222730",
    "#a3121f",
    "#555b66",
)


@dataclass(frozen=True)
class Panel:
    """One diagram."""

    label: str
    top: float
    """Largest value shown; the smallest is 0."""
    curves: list[tuple[np.ndarray, str]]
    """Values [T] and colour."""
    line: float | None = None
    """A dashed level."""


def timeline(flight: Flight, onsets: Sequence[float] = ()) -> str:
    """A flight as SVG, with the times in s at which its camera was spoilt."""
    ticks = flight.ticks
    time = ticks["now"] - ticks["now"][0] if len(ticks) else np.zeros(0)
    end = float(time[-1]) if len(time) and time[-1] > 0 else 1.0
    walking = ticks["mode"] == MODES.index(Mode.WALKING)
    panels = _panels(flight)
    height = TOP + len(panels) * (PANEL + SPACE) + BOTTOM - SPACE
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" '
        f'width="{WIDTH}" height="{height}" font-family="DejaVu Sans, Arial, sans-serif" '
        f'font-size="12" fill="{COMMAND}">',
        f'<rect width="{WIDTH}" height="{height}" fill="white"/>',
        _text(LEFT, 20, _title(flight), size=15),
        *_legend(),
    ]
    for number, panel in enumerate(panels):
        y = TOP + number * (PANEL + SPACE)
        parts += _bands(time, end, walking, ticks["vision"], y)
        parts += _frame(panel, y)
        for values, colour in panel.curves:
            shown = np.where(walking, values, np.nan)
            parts += _curve(_across(time, end), _height(shown, panel.top, y), colour)
    bottom = TOP + len(panels) * (PANEL + SPACE) - SPACE
    parts += _time_axis(end, bottom)
    parts += _marks(flight, onsets, end, bottom)
    return "\n".join([*parts, "</svg>\n"])


def _panels(flight: Flight) -> list[Panel]:
    ticks, beta = flight.ticks, float(flight.header.get("beta") or 0.0)
    score = np.where(np.isfinite(ticks["anomaly"]), ticks["anomaly"], np.nan)
    vision = ticks["vision"][:, None]
    speed = np.where(vision, ticks["velocity_vp"], ticks["velocity_op"])[:, 0]
    return [
        Panel(
            "anomaly score; threshold dashed",
            max(2.0 * beta, 1.1 * _largest(score), 1e-6),
            [(score, LOSS)],
            beta,
        ),
        Panel("vision probability P", 1.0, [(ticks["probability"], PROBABILITY)], 0.5),
        Panel(
            "forward speed in m/s, estimated by whichever acts; command in black",
            max(1.0, 1.1 * _largest(speed)),
            [(ticks["speed"], COMMAND), (speed, SPEED)],
        ),
    ]


def _title(flight: Flight) -> str:
    header = flight.header
    where = f" on {header['terrain']}" if header.get("terrain") else ""
    bundle = f"{header.get('bundle', 'bundle')} {header.get('bundle_sha256', '')[:12]}"
    return f"{bundle}, {header.get('robot', 'robot')}{where}"


def _legend() -> Iterator[str]:
    x = float(LEFT)
    for name, colour in BANDS.items():
        yield f'<rect x="{x}" y="30" width="14" height="14" fill="{colour}"/>'
        yield _text(x + 20, 41, name)
        x += 40 + 7.2 * len(name)


def _bands(
    time: np.ndarray, end: float, walking: np.ndarray, vision: np.ndarray, y: float
) -> Iterator[str]:
    """One rectangle for each stretch of one kind."""
    if not len(time):
        return
    kind = np.where(walking, np.where(vision, 1, 2), 0)
    edges = [0, *(np.flatnonzero(np.diff(kind)) + 1), len(kind) - 1]
    x, colours = _across(time, end), list(BANDS.values())
    for first, last in pairwise(edges):
        yield (
            f'<rect x="{x[first]:.1f}" y="{y}" width="{x[last] - x[first]:.1f}" '
            f'height="{PANEL}" fill="{colours[kind[first]]}"/>'
        )


def _frame(panel: Panel, y: float) -> Iterator[str]:
    yield _text(LEFT, y - 6, panel.label, colour=GREY)
    for share in (0.0, 0.5, 1.0):
        level = y + PANEL * (1.0 - share)
        yield _text(LEFT - 6, level + 4, f"{share * panel.top:.2g}", anchor="end", colour=GREY)
    if panel.line is not None:
        level = _height(np.array([panel.line]), panel.top, y)[0]
        yield _line(LEFT, WIDTH - RIGHT, level, level, GREY, "5 4")


def _time_axis(end: float, y: float) -> Iterator[str]:
    step = next(
        s for power in range(9) for s in (10**power, 2 * 10**power, 5 * 10**power) if end / s <= 20
    )
    for mark in np.arange(0.0, end + 1e-9, step):
        x = _across(mark, end)
        yield _line(x, x, y, y + 4, GREY)
        yield _text(x, y + 18, f"{mark:g} s", anchor="middle", colour=GREY)


def _marks(flight: Flight, onsets: Sequence[float], end: float, bottom: float) -> Iterator[str]:
    """Faults across all panels; in the first one, why vision or control was given up."""
    names = [*flight.header.get("fault", []), *["vision spoilt"] * len(onsets)]
    for onset, name in zip(onsets, names, strict=False):
        x = _across(onset, end)
        yield _line(x, x, TOP - 22, bottom, FAULT, "2 3")
        yield _text(x + 4, TOP - 20, name, colour=FAULT)
    row = 0
    for event in flight.events:
        if event.what in ("op", "damping"):
            x = _across(event.time - flight.ticks["now"][0], end)
            flipped = x > LEFT + 0.75 * INNER
            anchor, gap = ("end", -5) if flipped else ("start", 5)
            y = TOP + 14 + 15 * (row % 3)
            yield _text(x + gap, y, f"{event.what}: {event.why}", anchor=anchor)
            row += 1


def _curve(x: np.ndarray, heights: np.ndarray, colour: str) -> Iterator[str]:
    """A polyline for each stretch of numbers; NaN leaves a hole."""
    if not len(x):
        return
    every = len(x) // MAX_POINTS + 1
    x, heights = x[::every], heights[::every]
    for stretch in np.ma.clump_unmasked(np.ma.masked_invalid(heights)):
        points = " ".join(
            f"{a:.1f},{b:.1f}" for a, b in zip(x[stretch], heights[stretch], strict=True)
        )
        yield f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.5"/>'


def _text(
    x: float, y: float, text: str, anchor: str = "start", colour: str = COMMAND, size: int = 12
) -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{colour}" '
        f'font-size="{size}">{escape(text)}</text>'
    )


def _line(x1: float, x2: float, y1: float, y2: float, colour: str, dashes: str = "") -> str:
    dashed = f' stroke-dasharray="{dashes}"' if dashes else ""
    return (
        f'<line x1="{x1:.1f}" x2="{x2:.1f}" y1="{y1:.1f}" y2="{y2:.1f}" stroke="{colour}"{dashed}/>'
    )


def _largest(values: np.ndarray) -> float:
    return float(np.nanmax(values, initial=0.0))


def _across(time, end: float):
    """Pixels from the left, of one time or many."""
    return LEFT + INNER * time / end


def _height(values: np.ndarray, top: float, y: float) -> np.ndarray:
    return y + PANEL * (1.0 - np.clip(np.asarray(values, float) / top, 0.0, 1.0))
