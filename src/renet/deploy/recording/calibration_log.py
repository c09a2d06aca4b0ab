"""The monitors' scores in recorded runs with a healthy camera, for `renet calibrate --log`."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from renet.bundle import Bundle
from renet.deploy.recording.reader import Recording, read_recording
from renet.deploy.recording.score import fallen
from renet.deploy.recording.tick import GOOD, MODES
from renet.deploy.safety.machine import ENDED, Mode
from renet.errors import RenetError
from renet.interface import CONTROL_DT, STEPS_PER_TICK
from renet.selector.monitors import MONITORS, Scorer, SelectorInput

AWAY = 1.0
"""Seconds without a new image after which the camera was unplugged, not late."""
MIN_MINUTES = 5.0
"""Walking time from which thresholds are learnt."""
HEALTHY_ENDS = ("operator stop", ENDED)
"""Reasons for damping that say nothing against the walk before."""
TOPPLING = 45.0
"""Degrees; an operator may stop a robot that leans so, and once damped a healthy one may fall."""
WARM_UP = 2 * STEPS_PER_TICK
"""Control steps after walking began without scores of their own: both images must be new."""


def recorded_scores(logs: tuple[Path, ...], bundle: Bundle) -> dict[str, list[np.ndarray]]:
    """Every monitor's highest score in each 0.1 s, [T] for each walk, by monitor name.

    Walks that ended in trouble are left out, as failed episodes are in simulation.

    Raises:
        RenetError: a recording that cannot be read, of another policy, or with injected faults;
            the same walks twice; or too little healthy walking in all of them.
    """
    first: dict[bytes, Path] = {}
    series: dict[str, list[np.ndarray]] = {name: [] for name in MONITORS}
    for path in logs:
        run = read_recording(path)
        _check(run, path, bundle)
        ticks = run.ticks.tobytes()
        if ticks in first:
            raise RenetError(f"{path} holds the same walk as {first[ticks]}: give each log once")
        first[ticks] = path
        for walk in healthy_walks(run):
            for name, scores in zip(series, score_walk(run, walk).T, strict=True):
                series[name].append(scores)
    walks = next(iter(series.values()))
    if not walks:
        raise RenetError("the logs hold no walk with a camera that an operator ended: record one")
    minutes = sum(map(len, walks)) * STEPS_PER_TICK * CONTROL_DT / 60.0
    if minutes < MIN_MINUTES:
        raise RenetError(
            f"the logs hold {minutes:.1f} minutes of healthy walking; calibration needs at least "
            f"{MIN_MINUTES:g}"
        )
    return series


def healthy_walks(run: Recording) -> Iterator[range]:
    """Rows of each stretch of seeing walking that an operator ended, without its start.

    One in which it leaned far, or whose end the log does not hold, is left out.
    """
    ticks = run.ticks
    # A tick of vision that came too late ends a stretch; what follows is one of its own.
    walking = (ticks["mode"] == MODES.index(Mode.WALKING)) & np.isfinite(ticks["anomaly"])
    walking = np.concatenate([[False], walking, [False]])
    edges = np.flatnonzero(walking[1:] != walking[:-1])
    for start, end in edges.reshape(-1, 2).tolist():
        after = [e for e in run.events if e.time > ticks["now"][end - 1] and e.what in MODES]
        first = start + WARM_UP
        last = first + (end - first) // STEPS_PER_TICK * STEPS_PER_TICK
        healthy = bool(after) and after[0].why in HEALTHY_ENDS
        healthy &= not fallen(ticks, TOPPLING)[start:end].any()
        imaged = (ticks["frame"][first:last] == GOOD) & (ticks["frame_age"][first:last] < AWAY)
        if healthy and last > first and imaged.all() and min(run.images, default=end) <= first:
            yield range(first, last)


def score_walk(run: Recording, walk: range) -> np.ndarray:
    """Scores [T, monitors] of a stretch of whole ticks."""
    scorer = Scorer(1)
    newest = run.images[max(row for row in run.images if row <= walk.start)]
    given, image, scores = None, np.zeros(0), []
    for step, row in enumerate(walk):
        tick, newest = run.ticks[row], run.images.get(row, newest)
        # As in the run, the monitors see the images that were given to the policy.
        fresh = step % STEPS_PER_TICK == 0 and newest is not given
        if fresh:
            given, image = newest, newest[None].astype(np.float32)
        seen = SelectorInput(
            anomaly_score=tick["anomaly"][None],
            variance_score=tick["variance"][None],
            image=image,
            fresh=np.array([fresh]),
            age=tick["frame_age"][None],
            invalid=tick["frame_invalid"][None],
            velocity_op=tick["velocity_op"][None],
            velocity_vp=tick["velocity_vp"][None],
            has_image=tick["has_image"][None],
            map_error=tick["map_error"][None],
        )
        scores.append(scorer.scores(seen)[:, 0])
    table = np.array(scores, float)
    return table.reshape(-1, STEPS_PER_TICK, len(MONITORS)).max(axis=1)


def _check(run: Recording, path: Path, bundle: Bundle) -> None:
    if run.header.get("models") != bundle.manifest.sha256:
        raise RenetError(f"{path} was made with other models than {bundle.path}'s")
    if run.header.get("fault"):
        raise RenetError(f"{path} was made with injected faults: it says nothing of a healthy one")
