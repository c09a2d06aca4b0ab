"""Scores of the monitors of vision over their thresholds, from the recording of a run."""

import numpy as np

from renet.deploy.recording.reader import Recording
from renet.deploy.recording.tick import MODES
from renet.deploy.safety.machine import Mode
from renet.selector.monitors import MONITORS, Scorer, SelectorInput

_MAX_MONITORS = 4
"""Largest number of monitors in a timeline."""


def ratios(run: Recording) -> dict[str, np.ndarray]:
    """Return scores over thresholds, [T] by the monitor's name; a monitor objects from 1 on.

    Thresholds come from the recording's header.
    """
    seen = selector_input(run.ticks)
    facts = _image_facts(run)
    found = {}
    for name, threshold in run.header.get("thresholds", {}).items():
        # Another version of renet may have had others.
        if name in MONITORS:
            score = np.asarray(MONITORS[name].score(seen, facts), float)
            found[name] = _ratio(score, threshold)
    return found


def selector_input(ticks: np.ndarray) -> SelectorInput:
    """Return the state of vision at recorded ticks [T], as that of T robots, without images."""
    return SelectorInput(
        anomaly_score=ticks["anomaly"],
        variance_score=ticks["variance"],
        surprise=ticks["surprise"],
        stillness=ticks["stillness"],
        age=ticks["frame_age"],
        invalid=ticks["frame_invalid"],
        velocity_op=ticks["velocity_op"],
        velocity_vp=ticks["velocity_vp"],
        has_image=ticks["has_image"],
        map_error=ticks["map_error"],
    )


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


def _image_facts(run: Recording) -> Scorer:
    """Return a scorer with the facts about images at each tick, as those of T robots.

    Before the first image, no monitor objects.
    """
    count = len(run.ticks)
    facts = Scorer(0)
    facts.repeats = np.zeros(count)
    facts.partly_equal = np.zeros(count)
    facts.contrast = np.full(count, np.inf)
    facts.near = np.zeros(count)
    scorer = Scorer(1)
    for row in sorted(run.images):
        image = run.images[row].astype(float)[None]
        fresh = np.ones(1, bool)
        scorer.scores(SelectorInput(np.zeros(1), image=image, fresh=fresh), names=())
        # The values hold until the next image.
        facts.repeats[row:] = scorer.repeats
        facts.partly_equal[row:] = scorer.partly_equal
        facts.contrast[row:] = scorer.contrast
        facts.near[row:] = scorer.near
    return facts


def legend_of(name: str) -> str:
    """Entry of a monitor in a legend: its name and its reason."""
    return f"{name.replace('_', ' ')}: {MONITORS[name].reason}"
