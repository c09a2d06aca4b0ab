"""`renet evaluate log`: what a run came to and its timeline, from its recording alone."""

import io
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from renet.bundle import Bundle
from renet.deploy.recording.objections import legend_of, objectors
from renet.deploy.recording.reader import Recording, read_recording
from renet.deploy.recording.replay import mismatch
from renet.deploy.recording.tick import GOOD, MODES
from renet.deploy.robots.base import heading
from renet.deploy.safety.machine import ENDED, Mode
from renet.errors import RenetError, install
from renet.files import write_atomically
from renet.interface import CONTROL_DT
from renet.palette import STATES
from renet.selector.selector import BLIND, REMEMBERS, SEES

SCORE, TIMELINE = "score.json", "timeline.svg"
BANDS = (("#9aa0a8", "damped or standing up"), *STATES.values())
"""Colours and names of who acts."""
DROP = 1.0
"""Metres that a base drops in a second only if nothing carries it; stairs go down by 0.5."""
MAX_POINTS = 5000
"""Points of a curve; longer runs are thinned out."""
CUT = 3.0
"""Multiple of its threshold at which a monitor's score is cut off in the picture."""
MAX_MARKS = 40
"""Events written into the picture."""


@dataclass(frozen=True)
class ScoreCfg:
    """Score a run: falls, distance, speed, switches and their delays."""

    recording: tyro.conf.Positional[Path]
    """Recording of `renet deploy`."""
    out: Path | None = None
    """Folder of score.json and timeline.svg; the recording's own by default."""
    onset: tuple[float, ...] = ()
    """Seconds at which the camera was spoilt by hand, besides the faults that were injected."""
    replay: Path | None = None
    """Bundle to replay the run with: says by how much the commands differ."""


def score_log(cfg: ScoreCfg) -> Path:
    """Write score and timeline, and print the score; returns the folder.

    Raises:
        RenetError: no recording, or another bundle's.
    """
    run = read_recording(cfg.recording)
    difference = None if cfg.replay is None else mismatch(run, Bundle.load(cfg.replay))
    result = write_score(run, cfg.out or cfg.recording.parent, cfg.onset)
    for name, value in result.items():
        if name not in ("events", "run"):
            print(f"{name:<20} {value}")
    if difference is not None:
        print(f"{'replay':<20} commands differ by at most {difference:.3g} rad")
    return cfg.out or cfg.recording.parent


def write_score(run: Recording, folder: Path, onsets: Sequence[float] = ()) -> dict[str, Any]:
    """Write `score.json` and `timeline.svg`; returns the score."""
    onsets = [*run.header.get("onsets", []), *onsets]
    result = score(run, onsets)
    write_atomically(folder / SCORE, (json.dumps(result, indent=1) + "\n").encode(), "score")
    try:
        draw_timeline(run, onsets, folder / TIMELINE)
    except RenetError as error:  # The score is worth more than its picture.
        print(error)
    return result


def score(run: Recording, onsets: Sequence[float]) -> dict[str, Any]:
    """Falls, distance, speed, switches and timing of a run.

    The distance is from where walking began to where it ended. Vision was spoilt at `onsets`,
    seconds from the run's start.
    """
    ticks = run.ticks
    start = ticks["now"][0] if len(ticks) else 0.0
    walking = ticks["mode"] == MODES.index(Mode.WALKING)
    seconds = float(walking.sum()) * CONTROL_DT
    path = track(ticks)[walking]
    metres = float(np.hypot(*(path[-1] - path[0])[:2])) if len(path) else 0.0
    first = float(start + min(onsets, default=np.inf))
    # A robot let go on stairs as the run ends may topple, which is not the policy's fall.
    until = next((event.time for event in run.events if event.why == ENDED), np.inf)
    felled = np.diff(fallen(ticks).astype(int), prepend=0) > 0
    # One that lies on its back from the start never fell.
    risen = np.logical_or.accumulate(ticks["mode"] != MODES.index(Mode.DAMPING))
    blind = ticks["now"][walking & ~ticks["vision"]] - start
    went_blind = [event.time for event in run.events if event.what == BLIND]
    return {
        "seconds": round(len(ticks) * CONTROL_DT, 2),
        "complete": run.complete,
        "walking_seconds": round(seconds, 2),
        "falls": int((felled & risen & (ticks["now"] < until)).sum()),
        "distance_m": round(metres, 3),
        "distance_from": "simulator" if simulated(ticks) else "estimator",
        "speed_m_s": round(metres / seconds, 3) if seconds else 0.0,
        "commanded_m_s": round(_mean(ticks["told"][walking, 0]), 3),
        "vision_share": round(_mean(ticks["vision"][walking]), 4),
        "memory_share": round(_mean((ticks["vision"] & ~ticks["has_image"])[walking]), 4),
        "states": states(ticks[walking]),
        "crossed": crossed(run, path),
        "switches": sum(event.what in (SEES, BLIND) for event in run.events),
        "blind_before_first_fault": sum(time < first for time in went_blind),
        "switch_delay_s": [delay_to_op(blind, onset) for onset in onsets],
        "compute_ms": spread(ticks["compute_ms"]),
        "period_ms": spread(1000.0 * np.diff(ticks["now"])),
        "events": [asdict(event) for event in run.events],
        "run": run.header,
    }


def summary(score: dict[str, Any]) -> str:
    """A score in one line."""
    delays = ", ".join("never" if d is None else f"{d:.2f} s" for d in score["switch_delay_s"])
    if score["memory_share"] and not any(score["switch_delay_s"]):
        delays = ""  # Memory spared it OP.
    end = "fell" if score["falls"] else score["crossed"]
    parts = [
        " → ".join([*score["states"], *filter(None, [end])]),
        f"walked {score['walking_seconds']:.1f} s and {score['distance_m']:.1f} m "
        f"({score['distance_from']})",
        shares(score) if score["walking_seconds"] else "",
        f"from fault to OP {delays}" if delays else "",
        f"falls: {score['falls']}",
    ]
    return "; ".join(part for part in parts if part)


def shares(score: dict[str, Any]) -> str:
    """Shares of the walk in each of the selector's states, in whole per cent that add up to 100."""
    remembered, blind = score["memory_share"], 1.0 - score["vision_share"]
    parts = {"saw": score["vision_share"] - remembered, "remembered": remembered, "blind": blind}
    # Rounded down; the largest remainders get what is missing.
    whole = {name: int(100.0 * share + 1e-9) for name, share in parts.items()}
    by_remainder = sorted(parts, key=lambda name: whole[name] - 100.0 * parts[name])
    for name in by_remainder[: 100 - sum(whole.values())]:
        whole[name] += 1
    return ", ".join(f"{name} {percent} %" for name, percent in whole.items() if percent)


def states(walking: np.ndarray) -> list[str]:
    """Names of the selector's states in ticks [T], in the order in which they first came."""
    acting = np.where(walking["vision"], np.where(walking["has_image"], 0, 1), 2)
    return [[*STATES][number] for number in dict.fromkeys(acting.tolist())]


def crossed(run: Recording, path: np.ndarray) -> str:
    """Whether a robot has left its simulated tile, from its path [T, 3] m; empty elsewhere."""
    terrain = run.header.get("terrain")
    if not terrain or terrain == "flat" or not simulated(run.ticks):
        return ""
    from renet.terrain.tiles import TILE  # Needs MuJoCo, which a robot may lack.

    done = np.abs(path[:, :2]).max(initial=0.0) > TILE / 2
    return f"{'crossed' if done else 'did not cross'} the {terrain.replace('_', ' ')}"


def delay_to_op(blind: np.ndarray, onset: float) -> float | None:
    """Seconds from an onset to OP; zero if OP acted already, None if it never did.

    The onset and `blind`, the steps that walked on OP, are in seconds from the run's start.
    """
    later = blind[blind >= onset - 1e-9]
    return round(float(later[0] - onset), 3) if len(later) else None


def fallen(ticks: np.ndarray, lean: float = 60.0) -> np.ndarray:
    """Whether the base leans by more than `lean` degrees or drops off the ground, [T].

    What is not measured at a tick is as at the tick before. Only a simulator knows of drops.
    """
    quaternion, rows = ticks["quaternion"], np.arange(len(ticks))
    measured = (ticks["state"] == GOOD) & (np.abs(np.linalg.norm(quaternion, axis=1) - 1.0) < 0.1)
    upright = 1.0 - 2.0 * (quaternion[:, 1:3] ** 2).sum(axis=1)
    leaning = measured & (upright < np.cos(np.radians(lean)))
    leaning[1:-1] &= leaning[:-2] | leaning[2:]  # A single reading is an odd one.
    height = ticks["base_position"][:, 2]
    dropped = height[np.maximum(rows - round(1.0 / CONTROL_DT), 0)] - height > DROP
    return leaning[np.maximum.accumulate(np.where(measured, rows, 0))] | dropped


def simulated(ticks: np.ndarray) -> bool:
    """Whether the recording says where the base was: only a simulator knows."""
    return bool(np.isfinite(ticks["base_position"]).all())


def track(ticks: np.ndarray) -> np.ndarray:
    """Base positions [T, 3] m: the simulator's, or dead reckoning at a constant height.

    A robot adds up the velocity estimated by whichever estimator acted.
    """
    if simulated(ticks):
        return ticks["base_position"].astype(float)
    walking = ticks["mode"] == MODES.index(Mode.WALKING)
    velocity = np.where(ticks["vision"][:, None], ticks["velocity_vp"], ticks["velocity_op"])
    yaw = np.array([heading(q) if np.isfinite(q).all() else 0.0 for q in ticks["quaternion"]])
    # Numbers x + iy of the plane, which exp(i yaw) turns from the base to the world.
    steps = (velocity[:, 0] + 1j * velocity[:, 1]) * np.exp(1j * yaw)
    path = np.cumsum(CONTROL_DT * np.where(walking, steps, 0.0))
    return np.stack([path.real, path.imag, np.zeros(len(ticks))], axis=1)


def spread(values: np.ndarray) -> dict[str, float]:
    """p50, p99 and maximum; empty for no values."""
    if not len(values):
        return {}
    points = np.percentile(values, (50, 99, 100)).astype(float).round(3)
    return dict(zip(("p50", "p99", "max"), points.tolist(), strict=True))


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if len(values) else 0.0


def draw_timeline(run: Recording, onsets: Sequence[float], path: Path) -> None:
    """Draw the monitors that objected, vision probability and speed over who was in charge.

    Vision was spoilt at `onsets`, seconds from the run's start; the path's ending says the format.

    Raises:
        RenetError: matplotlib is not installed, or the picture cannot be written.
    """
    try:
        from matplotlib.figure import Figure
    except ModuleNotFoundError as error:
        raise RenetError(f"the timeline needs matplotlib: {install('sim')}") from error
    every = len(run.ticks) // MAX_POINTS + 1
    ticks = run.ticks[::every]
    time = ticks["now"] - ticks["now"][0] if len(ticks) else np.zeros(0)
    walking = ticks["mode"] == MODES.index(Mode.WALKING)
    vision = ticks["vision"]
    objections = {
        legend_of(name): (np.minimum(values[::every], CUT), f"C{number}")
        for number, (name, values) in enumerate(objectors(run).items())
    }
    speed = np.where(vision[:, None], ticks["velocity_vp"], ticks["velocity_op"])[:, 0]
    speeds = [(ticks["told"][:, 0], "#222730"), (speed, "#b5532f")]
    panels = (
        (f"monitors: score / threshold\n(1: objects; cut at {CUT:g})", [*objections.values()], 1.0),
        ("vision probability P", [(ticks["probability"], "#2f7d32")], 0.5),
        ("forward speed in m/s\n(black: commanded)", speeds, None),
    )
    figure = Figure(figsize=(10, 6), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True)
    acting = np.where(walking, np.where(vision, np.where(ticks["has_image"], 1, 2), 3), 0)
    for axis, (label, curves, line) in zip(axes, panels, strict=True):
        height = axis.get_xaxis_transform()
        for kind, (colour, name) in enumerate(BANDS):
            look = {"color": colour, "alpha": 0.3, "lw": 0, "label": name}
            axis.fill_between(time, 0, 1, acting == kind, transform=height, **look)
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
    _add_legends(axes[0], [*objections])
    begun = run.ticks["now"][0] if len(run.ticks) else 0.0
    whats = (REMEMBERS, BLIND, Mode.DAMPING)
    events = [event for event in run.events if event.what in whats][:MAX_MARKS]
    for row, event in enumerate(events):
        text = f"{event.what}: {event.why[:60]}"
        place = (event.time - begun, 0.85 - 0.15 * (row % 4))
        look = {"transform": axes[0].get_xaxis_transform(), "fontsize": 7, "parse_math": False}
        side = "left" if place[0] < time.max(initial=0.0) / 2 else "right"
        axes[0].text(*place, text, ha=side, clip_on=True, **look)
    picture = io.BytesIO()
    figure.savefig(picture, format=path.suffix[1:])
    write_atomically(path, picture.getvalue(), "timeline")


def _add_legends(axis: Any, monitors: Sequence[str]) -> None:
    """Legends of who was in charge, and of the monitors whose curves an axis shows first."""
    bands = axis.legend(loc="upper right", fontsize=7, ncols=4)
    if monitors:
        axis.add_artist(bands)
        lines = axis.get_lines()[: len(monitors)]
        axis.legend(lines, monitors, loc="lower left", fontsize=7)


def _title(run: Recording) -> str:
    header = run.header
    where = f" on {header['terrain']}" if header.get("terrain") else ""
    bundle = f"{header.get('bundle') or 'bundle'} {(header.get('bundle_sha256') or '')[:12]}"
    return f"{bundle}, {header.get('robot') or 'robot'}{where}"
