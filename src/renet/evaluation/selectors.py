"""Selectors on the clock of a rollout, which updates them once each physics step."""

from __future__ import annotations

import numpy as np

from renet.errors import RenetError
from renet.evaluation.rollout import EvalSelector
from renet.interface import PHYSICS_DT
from renet.selector import SELECTORS, SelectorInput, SelectorSpec
from renet.selector import make_selector as make_clockless


def make_selector(kind: str, spec: SelectorSpec, num_robots: int) -> EvalSelector:
    """The selector of a name, set up for N robots; raises RenetError for a name without one."""
    return ClockedSelector(kind, spec, num_robots)


def check_selector(kind: str) -> None:
    """Raise RenetError for a name that no selector has."""
    if kind not in SELECTORS:
        raise RenetError(f"unknown selector '{kind}': choose one of {', '.join(SELECTORS)}")


class ClockedSelector:
    """A `MonitorSelector` that is told the time of each physics step."""

    def __init__(self, kind: str, spec: SelectorSpec, num_robots: int) -> None:
        self.selector = make_clockless(kind, spec, num_robots)
        self._calls = 0

    @property
    def probability(self) -> np.ndarray:
        """Vision probability P_t, [N]."""
        return self.selector.probability

    def update(self, seen: SelectorInput) -> np.ndarray:
        """Take the input of one physics step; returns "use vision", [N] bool."""
        self._calls += 1
        return self.selector.update(seen, self._calls * PHYSICS_DT)

    def judge(self, anomaly_score: np.ndarray) -> np.ndarray:
        """`update` from the score [N] alone, which is all the paper's selector looks at."""
        return self.update(SelectorInput(anomaly_score))

    def reset(self, mask: np.ndarray) -> None:
        """Use vision again for the masked robots [N]."""
        self.selector.reset(mask)


def updates_apart(rate_hz: float) -> int:
    """Physics steps between two updates of a selector.

    Raises:
        RenetError: its rate is no whole fraction of the physics rate.
    """
    every = round(1.0 / (PHYSICS_DT * rate_hz)) if rate_hz > 0 else 0
    if every < 1 or abs(every * PHYSICS_DT * rate_hz - 1.0) > 1e-6:
        raise RenetError(
            f"selector rate {rate_hz} Hz: rollouts update it at 200 Hz or a whole fraction of that"
        )
    return every
