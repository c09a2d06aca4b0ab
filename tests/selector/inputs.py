"""Inputs of selectors."""

from dataclasses import replace

import numpy as np

from renet.selector import SelectorInput


def seen(robots: int = 2, **changes) -> SelectorInput:
    """What healthy cameras deliver, with changes."""
    healthy = SelectorInput(
        anomaly_score=np.full(robots, 0.001),
        image=0.2 + 0.5 * np.random.default_rng(0).random((robots, 48, 64)),
        fresh=np.ones(robots, bool),
        age=np.zeros(robots),
        invalid=np.zeros(robots),
        variance_score=np.ones(robots),
        surprise=np.full(robots, 0.3),
        stillness=np.full(robots, 0.1),
        velocity_op=np.zeros((robots, 3)),
        velocity_vp=np.zeros((robots, 3)),
    )
    return replace(healthy, **changes)
