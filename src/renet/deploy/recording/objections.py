"""How near each monitor of vision came to an objection during a run, from its recording."""

from collections.abc import Mapping

import numpy as np

from renet.deploy.recording.reader import Recording
from renet.deploy.recording.tick import MODES
from renet.deploy.safety.machine import Mode
from renet.selector.monitors import MONITORS, Scorer, SelectorInput

SHOWN = 4
"""Monitors of a timeline, at most."""


def ratios(run: Recording) -> dict[str, np.ndarray]:
    """Scores over thresholds, [T] by the monitor's name: from 1 on it objects.

    Thresholds are those of the recording's header; an older one has the reconstruction's alone.
    """
    ticks, header = run.ticks, run.header
    thresholds: Mapping[str, float] = header.get("thresholds") or {}
    if not thresholds and header.get("beta"):
        thresholds = {"reconstruction": float(header["beta"])}
    apart = ticks["velocity_op"].astype(float) - ticks["velocity_vp"]
    repeats, contrast, near = _of_images(run)
    scores = {
        "frame_age": ticks["frame_age"],
        "duplicate": repeats,
        "invalid_fraction": ticks["frame_invalid"],
        "uniformity": -contrast,
        "nearness": near,
        "variance": ticks["variance"],
        "reconstruction": ticks["anomaly"],
        "disagreement": np.linalg.norm(apart, axis=1),
        "map_error": ticks["map_error"],
    }
    return {
        name: _ratio(np.asarray(scores[name], float), threshold)
        for name, threshold in thresholds.items()
        if name in scores
    }


def objectors(run: Recording) -> dict[str, np.ndarray]:
    """The `ratios` of the monitors that objected most while the robot walked, the worst first.

    Without any objection, those of the monitor that came nearest to one; empty without thresholds.
    """
    walking = run.ticks["mode"] == MODES.index(Mode.WALKING)
    found = ratios(run)
    if not found or not walking.any():
        return {}
    worst = {name: np.nan_to_num(values[walking], nan=0.0).max() for name, values in found.items()}
    ranked = sorted(found, key=lambda name: -worst[name])
    objected = [name for name in ranked if worst[name] >= 1.0][:SHOWN] or ranked[:1]
    return {name: found[name] for name in objected}


def _ratio(score: np.ndarray, threshold: float) -> np.ndarray:
    """A score over its threshold; of two negative numbers the other way round."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return score / threshold if threshold > 0.0 else threshold / score


def _of_images(run: Recording) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Equal images in a row, the newest image's contrast, and images of a covered lens, [T] each.

    Before the first image there is nothing to object to.
    """
    count = len(run.ticks)
    found = np.tile([[0.0], [np.inf], [0.0]], count)
    scorer = Scorer(1)
    for row in sorted(run.images):
        image = run.images[row].astype(float)[None]
        fresh = np.ones(1, bool)
        scorer.scores(SelectorInput(np.zeros(1), image=image, fresh=fresh), names=())
        # Until the next image.
        found[:, row:] = np.stack([scorer.repeats, scorer.contrast, scorer.near])
    repeats, contrast, near = found
    return repeats, contrast, near


def legend_of(name: str) -> str:
    """A monitor's name with its reason, for a legend."""
    return f"{name.replace('_', ' ')}: {MONITORS[name].reason}"
