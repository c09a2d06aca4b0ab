"""Scores of the monitors in recorded runs with a healthy camera, for `renet calibrate --log`."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from renet.bundle import Bundle
from renet.deploy.recording.objections import selector_input
from renet.deploy.recording.reader import Recording, read_recording
from renet.deploy.recording.score import fallen
from renet.deploy.recording.tick import GOOD, MODES
from renet.deploy.safety.machine import ENDED, Mode
from renet.errors import RenetError
from renet.interface import CONTROL_DT, STEPS_PER_TICK
from renet.selector.monitors import MONITORS, Scorer

_MAX_IMAGE_AGE = 1.0
"""Age of an image, s, from which the camera was unplugged rather than late."""
MIN_MINUTES = 5.0
"""Least walking time for calibration, minutes."""
_HEALTHY_ENDS = ("operator stop", ENDED)
"""Reasons for damping at the end of a healthy walk."""
_MAX_LEAN = 45.0
"""Lean, degrees, from which a walk is not healthy: its operator may have stopped it for that."""
SETTLING_STEPS = 2 * STEPS_PER_TICK
"""Control steps left out at the start of a walk, until both images of a pair are new."""


def recorded_scores(logs: tuple[Path, ...], bundle: Bundle) -> dict[str, list[np.ndarray]]:
    """Return every monitor's highest scores in each 0.1 s, [T] for each walk, by its name.

    Walks that a problem ended are left out, as failed episodes are in simulation.

    Raises:
        RenetError: A recording cannot be read, is of another policy or of a dry run, has injected
            faults or another run's images, or is given twice, or all together hold too little
            healthy walking.
    """
    first: dict[bytes, Path] = {}
    series: dict[str, list[np.ndarray]] = {name: [] for name in MONITORS}
    for path in logs:
        run = read_recording(path)
        _check(run, path, bundle)
        # The same walk must not count twice.
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
    """Yield the rows of each walk with vision that an operator ended, without its start.

    Walks in which the robot leaned far, or whose end is not in the log, are left out.
    """
    ticks = run.ticks
    # A vision tick that came too late ends a walk; the steps after it are a walk of their own.
    walking = (ticks["mode"] == MODES.index(Mode.WALKING)) & np.isfinite(ticks["anomaly"])
    walking = np.concatenate([[False], walking, [False]])
    # First row of each walk, and the row after its last.
    edges = np.flatnonzero(walking[1:] != walking[:-1])
    for start, end in edges.reshape(-1, 2).tolist():
        if not _ended_well(run, end) or fallen(ticks, _MAX_LEAN)[start:end].any():
            continue
        # Whole ticks of vision, from the first that shows two new images.
        first = start + SETTLING_STEPS
        last = first + (end - first) // STEPS_PER_TICK * STEPS_PER_TICK
        good = ticks["frame"][first:last] == GOOD
        recent = ticks["frame_age"][first:last] < _MAX_IMAGE_AGE
        imaged = (good & recent).all() and min(run.images, default=end) <= first
        if last > first and imaged:
            yield range(first, last)


def _ended_well(run: Recording, end: int) -> bool:
    """Return True if a walk whose last row is before `end` ended for a healthy reason."""
    last = run.ticks["now"][end - 1]
    for event in run.events:
        if event.time > last and event.what in MODES:
            return event.why in _HEALTHY_ENDS
    return False


def score_walk(run: Recording, walk: range) -> np.ndarray:
    """Return the highest scores in each 0.1 s of a walk of whole vision ticks, [T, monitors]."""
    scorer = Scorer(1)
    newest = run.images[max(row for row in run.images if row <= walk.start)]
    given: np.ndarray | None = None
    image = np.zeros(0)
    scores = []
    for step, row in enumerate(walk):
        newest = run.images.get(row, newest)
        # As in the run, the monitors see the images that were given to the policy.
        fresh = step % STEPS_PER_TICK == 0 and newest is not given
        if fresh:
            given = newest
            image = newest[None].astype(np.float32)
        recorded = selector_input(run.ticks[row : row + 1])
        seen = replace(recorded, image=image, fresh=np.array([fresh]))
        scores.append(scorer.scores(seen)[:, 0])
    table = np.array(scores, float)
    return table.reshape(-1, STEPS_PER_TICK, len(MONITORS)).max(axis=1)


def _check(run: Recording, path: Path, bundle: Bundle) -> None:
    """Raise RenetError for a recording that says nothing of this bundle's healthy scores."""
    if run.header.get("models") != bundle.manifest.sha256:
        raise RenetError(f"{path} was made with other models than {bundle.path}'s")
    if run.header.get("fault"):
        raise RenetError(f"{path} was made with injected faults: it says nothing of a healthy one")
    if run.header.get("dry_run"):
        raise RenetError(f"{path} is of a dry run, in which nothing walked")
    # Some monitors compare the images with the robot's motion.
    if run.header.get("camera") == "replay":
        raise RenetError(f"{path} shows the images of an earlier run: give that one")
