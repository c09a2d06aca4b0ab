"""One 10 Hz tick of vision and of both estimators, as a pure function of its inputs."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from renet.bundle.blocks import Session
from renet.bundle.models import (
    HAS_IMAGE,
    MAP_ERROR,
    STILLNESS,
    SURPRISE,
    known_shapes,
    remembers,
)
from renet.selector.monitors import Gate

Sessions = Mapping[str, Session]
"""The models of a bundle by name."""
EstimatorOutput = dict[str, np.ndarray]
"""Results of a tick, by the names of `BundlePolicy`'s attributes that they replace."""

ESTIMATES = ("latent_op", "latent_vp", "velocity_op", "velocity_vp", "feet_height", "height_map")
SCORES = ("anomaly_score", "variance_score", SURPRISE, STILLNESS)
OF_VP = ("latent_vp", "velocity_vp", "height_map", MAP_ERROR)
"""Results of VP that must be finite for VP to drive."""
OF_OP = ("latent_op", "velocity_op")
"""Results of OP that must be finite for the robot to walk at all."""
SEEN = (*SCORES, "reconstruction")
"""Outputs of the vision model that are used, if it has them. A stranger's model may have others,
which must not replace attributes."""


class EstimatorInput(NamedTuple):
    """Inputs of one tick: copies, safe on any thread."""

    feed: dict[str, np.ndarray]
    """Inputs of the estimators without images, by their names in the model."""
    depth: np.ndarray
    """Two newest images that were delivered, newest first, [N, 2, 48, 64]."""
    accepted: np.ndarray
    """Two newest images that VP was given before, newest first, [N, 2, 48, 64]."""
    unpaired: np.ndarray
    """True where VP had no image a tick ago, so that the next image takes both places, [N] bool."""
    image_age: np.ndarray
    """Time for which images have been withheld, [N] s; NaN where VP was never given one."""
    evidence: np.ndarray
    """Evidence of the images before, [N, 2] (see `bundle.models.EVIDENCE`)."""
    gate: Gate | None
    """Gate that withholds images from VP; None withholds none."""
    blind: bool
    """True if no image has arrived: vision does not run, and its scores are infinite."""

    def robots(self, rows: np.ndarray) -> "EstimatorInput":
        """Return the inputs of some robots, given by their rows."""
        return EstimatorInput(
            {name: value[rows] for name, value in self.feed.items()},
            self.depth[rows],
            self.accepted[rows],
            self.unpaired[rows],
            self.image_age[rows],
            self.evidence[rows],
            None if self.gate is None else self.gate.of(rows),
            self.blind,
        )


def infer(sessions: Sessions, inputs: EstimatorInput) -> EstimatorOutput:
    """Run vision, withhold the images that the gate rejects, and run both estimators."""
    # Vision comes first: its scores decide which images VP may use.
    result = _see(sessions["vision"], inputs)
    estimator = sessions["estimator"]
    feed = inputs.feed | {"depth": inputs.depth}
    # A model with a memory can be told that there is no image.
    if remembers(estimator):
        result |= _withhold(inputs, result)
        has_image = result["has_image"][:, None]
        feed |= {"depth": result["accepted"], HAS_IMAGE: has_image.astype(np.float32)}
    outputs = {name: f"next_{name}" if name.startswith("latent") else name for name in ESTIMATES}
    if MAP_ERROR in {output.name for output in estimator.get_outputs()}:
        outputs[MAP_ERROR] = MAP_ERROR
    estimates: Any = estimator.run([*outputs.values()], feed)
    return result | dict(zip(outputs, estimates, strict=True))


def _see(vision: Session, inputs: EstimatorInput) -> EstimatorOutput:
    """Compute scores [N] of the newest images, and their reconstructions."""
    robots = len(inputs.depth)
    if inputs.blind:
        return {name: np.full(robots, np.inf, np.float32) for name in SCORES}
    # A model without a score leaves it at zero.
    result = {name: np.zeros(robots, np.float32) for name in SCORES}
    outputs = [output.name for output in vision.get_outputs()]
    names = [name for name in outputs if name in SEEN]
    if STILLNESS in outputs:
        names.append("next_evidence")
    found: Any = vision.run(names, {"depth": inputs.depth} | _known(vision, inputs))
    result |= dict(zip(names, found, strict=True))
    for name in SCORES:
        result[name] = result[name].reshape(-1)
    # Who was never given an image expects none.
    ignorant = np.isnan(inputs.image_age)
    for name in (SURPRISE, STILLNESS):
        result[name] = np.where(ignorant, 0.0, result[name])
    if STILLNESS in outputs:
        # An old image stands still whatever the robot does.
        fresh = True if inputs.gate is None else inputs.gate.fresh
        weighed = (fresh & ~ignorant)[:, None]
        result["evidence"] = np.where(weighed, result.pop("next_evidence"), inputs.evidence)
    return result


def _known(vision: Session, inputs: EstimatorInput) -> dict[str, np.ndarray]:
    """Return what the robots know before the image, by the vision model's names of inputs."""
    history = inputs.feed["proprioception_history"]
    age = np.nan_to_num(inputs.image_age)
    known = {
        "proprioception_history": history,
        "latent_vp": inputs.feed["latent_vp"],
        "last_image": inputs.accepted[:, 0],
        "image_age": age[:, None].astype(np.float32),
        "evidence": inputs.evidence,
    }
    return {name: known[name] for name in known_shapes(vision, history.shape[1])}


def _withhold(inputs: EstimatorInput, scores: EstimatorOutput) -> EstimatorOutput:
    """Return the robots whose VP has an image, [N] bool, and the two newest images it was given."""
    depth = inputs.depth
    has_image = np.full(len(depth), not inputs.blind)
    if inputs.gate is not None:
        has_image &= inputs.gate.judge(scores)
    # Where VP had no image a tick ago, the new image stands for that one, too.
    older = np.where(inputs.unpaired[:, None, None], depth[:, 0], inputs.accepted[:, 0])
    pair = np.stack((depth[:, 0], older), axis=1)
    accepted = np.where(has_image[:, None, None, None], pair, inputs.accepted)
    return {"has_image": has_image, "accepted": accepted}
