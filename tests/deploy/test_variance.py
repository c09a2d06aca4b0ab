"""The monitor that judges errors by their predicted variance, on recorded images.

`data/variance.onnx` is the detector of a young policy (3.9 M steps); `data/images.npz` are six
images of a robot walking on flat ground and the same with glare of severity 1.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from renet.deploy.bundle import Bundle
from renet.deploy.bundle.bundle import write_bundle
from renet.deploy.policy import Policy
from renet.errors import RenetError
from renet.selector import SelectorInput, SelectorSpec, make_selector

DATA = Path(__file__).with_name("data")
SPEC = SelectorSpec(beta=0.01034, thresholds={"variance": 9.19, "reconstruction": 0.01034})
"""Calibrated with that detector: `renet calibrate BUNDLE --robots 70 --seconds 20 --levels 2`."""


@pytest.fixture
def seeing(models, manifest, tmp_path) -> Bundle:
    """Untrained networks with a trained detector that predicts a variance."""
    trained = models | {"vision": (DATA / "variance.onnx").read_bytes()}
    chosen = replace(manifest, selector=SPEC)
    return Bundle.load(write_bundle(tmp_path / "seeing", trained, chosen))


def trusted(bundle: Bundle, kind: str, images: str, spec: SelectorSpec = SPEC) -> bool:
    """Whether vision is used after six images."""
    policy, selector = Policy(bundle), make_selector(kind, spec)
    blind, proprioception = np.zeros(1, bool), np.zeros((1, 45))
    for tick, image in enumerate(np.load(DATA / "images.npz")[images].astype(np.float32)):
        for _ in range(5):
            policy.step(proprioception, image[None], blind)
        seen = SelectorInput(
            anomaly_score=policy.anomaly_score,
            variance_score=policy.variance_score,
            image=image[None],
            fresh=np.array([True]),
            age=np.zeros(1),
            invalid=np.zeros(1),
        )
        vision = selector.update(seen, 0.1 * tick)
    return bool(vision[0])


def test_it_leaves_on_glare_that_the_papers_rule_misses(seeing):
    assert trusted(seeing, "monitors", "healthy")
    assert not trusted(seeing, "monitors", "glare")
    assert trusted(seeing, "paper", "glare")


def test_a_model_without_the_output_ignores_its_threshold(bundle):
    easy = replace(SPEC, beta=0.25, thresholds={"variance": 1e-6, "reconstruction": 0.25})
    assert trusted(bundle, "monitors", "healthy", easy)
    assert Policy(bundle).variance_score.tolist() == [0.0]


def test_a_threshold_that_never_objects_is_refused(manifest):
    with pytest.raises(RenetError, match="variance 1000 would never object"):
        replace(manifest, selector=SelectorSpec(beta=0.01, thresholds={"variance": 1000.0}))
