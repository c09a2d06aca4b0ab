"""Scores of the monitors of vision over their thresholds, from the recording of a run."""

from collections.abc import Mapping

import numpy as np

from renet.deploy.recording.reader import Recording
from renet.deploy.recording.tick import MODES
from renet.deploy.safety.machine import Mode
from renet.selector.monitors import MONITORS, Scorer, SelectorInput

_MAX_MONITORS = 4
"""Largest number of monitors in a timeline."""


def ratios(run: Recording) -> dict[str, np.ndarray]:
    """Return scores over thresholds, [T] by the monitor's name; a monitor objects from 1 on.

    Thresholds come from the recording's header. In an older recording, only the reconstruction has
    one.
    """
    ticks = run.ticks
    header = run.header
    thresholds: Mapping[str, float] = header.get("thresholds") or {}
    if not thresholds and header.get("beta"):
        thresholds = {"reconstruction": float(header["beta"])}
    apart = ticks["velocity_op"].astype(float) - ticks["velocity_vp"]
    scores = {
        "frame_age": ticks["frame_age"],
        **_of_images(run),
        "invalid_fraction": ticks["frame_invalid"],
        "variance": ticks["variance"],
        "reconstruction": ticks["anomaly"],
        "surprise": ticks["surprise"],
        "stillness": ticks["stillness"],
        "disagreement": np.linalg.norm(apart, axis=1),
        "map_error": ticks["map_error"],
    }
    found = {}
    for name, threshold in thresholds.items():
        if name in scores:
            found[name] = _ratio(np.asarray(scores[name], float), threshold)
    return found


def objectors(run: Recording) -> dict[str, np.ndarray]:
    """Return `ratios` of the monitors that objected most while the robot walked, the worst first.

    If none objected, only the monitor that came nearest to an objection is returned; without
    thresholds, none.
    """
    walking = run.ticks["mode"] == MODES.index(Mode.WALKING)
    found = ratios(run)
    if not found or not walking.any():
        return {}
    worst = {}
    for name, values in found.items():
        worst[name] = np.nan_to_num(values[walking], nan=0.0).max()
    ranked = sorted(found, key=lambda name: -worst[name])
    objected = [name for name in ranked if worst[name] >= 1.0]
    objected = objected[:_MAX_MONITORS] or ranked[:1]
    return {name: found[name] for name in objected}


def _ratio(score: np.ndarray, threshold: float) -> np.ndarray:
    """Divide a score by its threshold, or inversely if it is negative: objections are from 1 on."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return score / threshold if threshold > 0.0 else threshold / score


def _of_images(run: Recording) -> dict[str, np.ndarray]:
    """Return the scores, [T] by name, of the monitors that compare pixels.

    Before the first image, no monitor objects.
    """
    count = len(run.ticks)
    names = ("duplicate", "partly_frozen", "uniformity", "nearness")
    found = {name: np.zeros(count) for name in names}
    found["uniformity"][:] = -np.inf
    scorer = Scorer(1)
    for row in sorted(run.images):
        image = run.images[row].astype(float)[None]
        seen = SelectorInput(np.zeros(1), image=image, fresh=np.ones(1, bool))
        # The scores hold until the next image.
        for name, score in zip(names, scorer.scores(seen, names), strict=True):
            found[name][row:] = score
    return found


def legend_of(name: str) -> str:
    """Entry of a monitor in a legend: its name and its reason."""
    return f"{name.replace('_', ' ')}: {MONITORS[name].reason}"
