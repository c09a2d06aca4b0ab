"""`renet evaluate log`: score of a run, from its recording alone."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from renet.bundle import Bundle
from renet.deploy.recording.reader import Recording, read_recording
from renet.deploy.recording.replay import replay_error
from renet.deploy.recording.tick import GOOD, MODES
from renet.deploy.recording.timeline import TIMELINE, draw_run
from renet.deploy.robots.base import heading
from renet.deploy.safety.machine import ENDED, Mode
from renet.errors import RenetError
from renet.files import write_atomically
from renet.interface import CONTROL_DT, OWN_GROUND, control_steps
from renet.palette import STATES
from renet.selector.selector import BLIND, SEES

SCORE = "score.json"
"""File name of a score."""
_DROP = 1.0
"""Drop of the base within a second, m, from which nothing carries it; stairs go down by 0.5."""
_SUNK = 0.15
"""Height of the base above the edges of a gap, m, below which it is in the gap: a trunk that lies
across it is at 0.06, one that leaps over it above 0.25."""
_HIND_FEET = 0.3
"""Distance from the base back to the hind feet, m."""
_STRIDE = control_steps(0.5)
"""Number of ticks from one place of a robot's way to the next, longer than a stride of its gait."""
_OLD_IMAGE = 0.3
"""Age from which an image is an old one, s; a new one comes every 0.1."""
_CROSSED = "crossed"
_FELL_INTO = "fell into"


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
    """Write score and timeline, and print the score; returns their folder.

    Raises:
        RenetError: The file is no recording, or was made with another bundle than `replay`; or
            there is an onset outside of the run.
    """
    run = read_recording(cfg.recording)
    _demand_onsets_within(run, cfg.onset)
    difference = None if cfg.replay is None else replay_error(run, Bundle.load(cfg.replay))
    result = write_score(run, cfg.out or cfg.recording.parent, cfg.onset)
    for name, value in result.items():
        if name not in ("events", "run"):
            print(f"{name:<20} {value}")
    if difference is not None:
        print(f"{'replay':<20} commands differ by at most {difference:.3g} rad")
    return cfg.out or cfg.recording.parent


def _demand_onsets_within(run: Recording, onsets: Sequence[float]) -> None:
    """Raise RenetError for an onset, s from the run's start, that is not within the run."""
    now = run.ticks["now"]
    lasts = float(now[-1] - now[0]) if len(now) else 0.0
    for onset in onsets:
        # NaN is not within it, either.
        if not 0.0 <= onset <= lasts:
            raise RenetError(
                f"--onset must be seconds from the run's start, 0 to {lasts:.2f}, got {onset:g}"
            )


def write_score(run: Recording, folder: Path, onsets: Sequence[float] = ()) -> dict[str, Any]:
    """Write `score.json` and `timeline.svg`; returns the score."""
    onsets = [*run.header.get("onsets", []), *onsets]
    result = score_run(run, onsets)
    write_atomically(folder / SCORE, (json.dumps(result, indent=1) + "\n").encode(), "score")
    try:
        draw_run(run, onsets, folder / TIMELINE)
    except RenetError as error:
        # A score without its picture is still worth having.
        print(error)
    return result


def score_run(run: Recording, onsets: Sequence[float]) -> dict[str, Any]:
    """Return falls, distance, speed, switches and timing of a run.

    Shares are of the time that the robot walks: `vision_share` on VP, `memory_share` on VP without
    an image, and `old_image_share` on VP with an old image that it takes for new. `path_m` is the
    length of the way, and `speed_m_s` its mean over the time; `distance_m` is measured from the
    place where walking began to the place where it ended. `commanded_m_s` is the mean speed that
    the policy was told, in any direction.

    Args:
        run: Run to score.
        onsets: Times at which vision was spoilt, s from the run's start.
    """
    ticks = run.ticks
    start = ticks["now"][0] if len(ticks) else 0.0
    walking = ticks["mode"] == MODES.index(Mode.WALKING)
    seconds = float(walking.sum()) * CONTROL_DT
    path = track(ticks)[walking]
    metres = float(np.hypot(*(path[-1] - path[0])[:2])) if len(path) else 0.0
    length = path_length(path)
    first = float(start + min(onsets, default=np.inf))
    sunk = sunk_in_gap(run)
    # A robot on stairs that is damped as the run ends may topple: that is no fall of the policy.
    until = next((event.time for event in run.events if event.why == ENDED), np.inf)
    # A robot that has fallen into a gap may struggle there, which is no second fall.
    down = fallen(ticks) | np.logical_or.accumulate(sunk)
    felled = np.diff(down.astype(int), prepend=0) > 0
    # A robot that lies on its back from the start never fell.
    risen = np.logical_or.accumulate(ticks["mode"] != MODES.index(Mode.DAMPING))
    blind = ticks["now"][walking & ~ticks["vision"]] - start
    went_blind = [event.time for event in run.events if event.what == BLIND]
    return {
        "seconds": round(len(ticks) * CONTROL_DT, 2),
        "complete": run.complete,
        "walking_seconds": round(seconds, 2),
        "falls": int((felled & risen & (ticks["now"] < until)).sum()),
        "path_m": round(length, 3),
        "distance_m": round(metres, 3),
        "distance_from": "simulator" if simulated(ticks) else "estimator",
        "speed_m_s": round(length / seconds, 3) if seconds else 0.0,
        "commanded_m_s": round(_mean(told_speed(run)[walking]), 3),
        "vision_share": round(_mean(ticks["vision"][walking]), 4),
        "memory_share": round(_mean((ticks["vision"] & ~ticks["has_image"])[walking]), 4),
        "old_image_share": round(_mean(on_old_image(ticks)[walking]), 4),
        "states": states(ticks[walking]),
        "crossed": _crossing(run, path, bool(sunk.any())),
        "switches": sum(event.what in (SEES, BLIND) for event in run.events),
        "blind_before_first_fault": sum(time < first for time in went_blind),
        "switch_delay_s": [delay_to_op(blind, onset) for onset in onsets],
        "compute_ms": spread(ticks["compute_ms"]),
        "period_ms": spread(1000.0 * np.diff(ticks["now"])),
        "events": [asdict(event) for event in run.events],
        "run": run.header,
    }


def summary(score: dict[str, Any]) -> str:
    """Write the score of a run in one line."""
    delays = ", ".join("never" if d is None else f"{d:.2f} s" for d in score["switch_delay_s"])
    # With its memory a policy may do without OP.
    if score["memory_share"] and not any(score["switch_delay_s"]):
        delays = ""
    end = score["crossed"]
    if score["falls"] and not end.startswith(_FELL_INTO):
        end = "fell"
    parts = [
        "dry run, the robot was left alone" if score["run"].get("dry_run") else "",
        " → ".join([*score["states"], *filter(None, [end])]),
        f"walked {score['walking_seconds']:.1f} s and {score['path_m']:.1f} m "
        f"({score['distance_from']})",
        state_shares(score) if score["walking_seconds"] else "",
        f"from the fault to blind walking: {delays}" if delays else "",
        f"falls: {score['falls']}",
    ]
    return "; ".join(part for part in parts if part)


def state_shares(score: dict[str, Any]) -> str:
    """Write the shares of the selector's states in a walk, in whole per cent that add up to 100."""
    remembered = score["memory_share"]
    old = score["old_image_share"]
    parts = {
        "saw": score["vision_share"] - remembered - old,
        "trusted an old image": old,
        "remembered": remembered,
        "blind": 1.0 - score["vision_share"],
    }
    # Rounded down; the largest remainders get the per cent that are missing.
    whole = {name: int(100.0 * share + 1e-9) for name, share in parts.items()}
    by_remainder = sorted(parts, key=lambda name: whole[name] - 100.0 * parts[name])
    for name in by_remainder[: 100 - sum(whole.values())]:
        whole[name] += 1
    return ", ".join(f"{name} {percent} %" for name, percent in whole.items() if percent)


def states(walking: np.ndarray) -> list[str]:
    """Names of the selector's states in ticks [T], in the order of their first ticks."""
    acting = np.where(walking["vision"], np.where(walking["has_image"], 0, 1), 2)
    return [[*STATES][number] for number in dict.fromkeys(acting.tolist())]


def on_old_image(ticks: np.ndarray) -> np.ndarray:
    """Mask [T] of ticks at which VP acts on an image that it takes for new, but that is old."""
    return ticks["vision"] & ticks["has_image"] & (ticks["frame_age"] > _OLD_IMAGE)


def sunk_in_gap(run: Recording) -> np.ndarray:
    """Mask [T] of ticks at which a simulated robot is in the gap of its tile."""
    ticks = run.ticks
    gap = _gap(run)
    if gap is None:
        return np.zeros(len(ticks), bool)
    inner, outer = gap
    position = ticks["base_position"]
    # The gap is a square ring around the start.
    ring = np.abs(position[:, :2]).max(axis=1)
    return (ring > inner) & (ring < outer) & (position[:, 2] < _SUNK)


def _gap(run: Recording) -> tuple[float, float] | None:
    """Return where the gap of a simulated tile begins and ends, m from the start; None: no gap."""
    end = _obstacle_end(run)
    if run.header.get("terrain") != "gap" or end is None:
        return None
    # Needs MuJoCo, which may not be installed on a robot.
    from renet.terrain.tiles import GapTile

    return GapTile().island, end


def _obstacle_end(run: Recording) -> float | None:
    """Return where the obstacle of a simulated tile ends, m from the start; None: no tile."""
    terrain = run.header.get("terrain")
    level = run.header.get("level")
    if not terrain or terrain in ("flat", OWN_GROUND) or not isinstance(level, int):
        return None
    if not len(run.ticks) or not simulated(run.ticks):
        return None
    # Needs MuJoCo, which may not be installed on a robot.
    from renet.terrain.tiles import find_tile

    try:
        tile = find_tile(terrain, level)
    except RenetError:
        # A tile of another version or package.
        return None
    return tile.obstacle_end(tile.measure_at(level))


def _crossing(run: Recording, path: np.ndarray, sunk: bool) -> str:
    """Say whether a robot came over its simulated tile's obstacle; empty without a tile.

    Args:
        run: Run with the tile in its header.
        path: Positions of the base while it walked, [T, 3] m.
        sunk: True if it was in the tile's gap.
    """
    end = _obstacle_end(run)
    if end is None:
        return ""
    # A robot may stop behind an obstacle that it has crossed.
    done = np.abs(path[:, :2]).max(initial=0.0) > end + _HIND_FEET
    verdict = _CROSSED if done else _FELL_INTO if sunk else "did not cross"
    return f"{verdict} the {run.header['terrain'].replace('_', ' ')}"


def delay_to_op(blind: np.ndarray, onset: float) -> float | None:
    """Return the time from an onset to OP, s; zero if OP acted already, None if it never did.

    Args:
        blind: Times of the steps that walked on OP, s from the run's start.
        onset: Time of the onset, s from the run's start.
    """
    later = blind[blind >= onset - 1e-9]
    return round(float(later[0] - onset), 3) if len(later) else None


def fallen(ticks: np.ndarray, lean: float = 60.0) -> np.ndarray:
    """Mask [T] of ticks at which the base leans by more than `lean` degrees or has dropped.

    Ticks without a reading repeat the one before. Only recordings of a simulator show drops.
    """
    quaternion = ticks["quaternion"]
    rows = np.arange(len(ticks))
    measured = (ticks["state"] == GOOD) & (np.abs(np.linalg.norm(quaternion, axis=1) - 1.0) < 0.1)
    upright = 1.0 - 2.0 * (quaternion[:, 1:3] ** 2).sum(axis=1)
    leaning = measured & (upright < np.cos(np.radians(lean)))
    # A single reading may be a wrong one: its neighbours decide.
    leaning[1:-1] &= leaning[:-2] | leaning[2:]
    height = ticks["base_position"][:, 2]
    dropped = height[np.maximum(rows - control_steps(1.0), 0)] - height > _DROP
    # Row of the last reading up to each tick.
    return leaning[np.maximum.accumulate(np.where(measured, rows, 0))] | dropped


def simulated(ticks: np.ndarray) -> bool:
    """True if ticks hold the position of the base, which only a simulator knows."""
    return bool(np.isfinite(ticks["base_position"]).all())


def track(ticks: np.ndarray) -> np.ndarray:
    """Base positions [T, 3] m: the simulator's, or dead reckoning at a constant height.

    Dead reckoning adds up the velocities of the estimator that acted at each tick.
    """
    if simulated(ticks):
        return ticks["base_position"].astype(float)
    walking = ticks["mode"] == MODES.index(Mode.WALKING)
    velocity = np.where(ticks["vision"][:, None], ticks["velocity_vp"], ticks["velocity_op"])
    yaw = np.array([heading(q) if np.isfinite(q).all() else 0.0 for q in ticks["quaternion"]])
    # Complex numbers x + iy, which exp(i yaw) turns from the base frame to the world.
    steps = (velocity[:, 0] + 1j * velocity[:, 1]) * np.exp(1j * yaw)
    path = np.cumsum(CONTROL_DT * np.where(walking, steps, 0.0))
    return np.stack([path.real, path.imag, np.zeros(len(ticks))], axis=1)


def path_length(path: np.ndarray) -> float:
    """Return the length of a way through positions [T, 3] m, without the sway of a gait, m."""
    places = path[::_STRIDE, :2]
    if len(path):
        places = np.vstack([places, path[-1:, :2]])
    return float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())


def told_speed(run: Recording) -> np.ndarray:
    """Return the speed that the policy was told at each tick, [T] m/s."""
    told = run.ticks["told"]
    # Of a heading only the first number is a velocity.
    parts = slice(0, 2) if run.header.get("told") == "twist" else slice(0, 1)
    return np.linalg.norm(told[:, parts], axis=1)


def spread(values: np.ndarray) -> dict[str, float]:
    """Median, 99th percentile and maximum; empty for no values."""
    if not len(values):
        return {}
    points = np.percentile(values, (50, 99, 100)).astype(float).round(3)
    return dict(zip(("p50", "p99", "max"), points.tolist(), strict=True))


def _mean(values: np.ndarray) -> float:
    """Mean, or 0 of no values."""
    return float(values.mean()) if len(values) else 0.0
