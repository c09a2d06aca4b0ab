"""The selectors a study can run: the paper's rule, or monitors that are slow to trust again."""

from __future__ import annotations

import numpy as np

from renet.deploy.manifest import SelectorSpec
from renet.errors import RenetError
from renet.evaluation.rollout import EvalSelector
from renet.interface import PHYSICS_DT
from renet.selector.defaults import default_monitors
from renet.selector.guard import GuardCfg, GuardedSelector
from renet.selector.monitors import Sight
from renet.selector.selector import Selector, SelectorCfg

SELECTORS = ("guarded", "paper")
"""All monitors with a dwell before vision is trusted again; or the reconstruction score against β,
filtered, and nothing else."""


def make_selector(kind: str, spec: SelectorSpec, num_robots: int) -> EvalSelector:
    """The selector of a name, set up for N robots.

    Raises:
        RenetError: no such selector, or a rate that is no whole fraction of the physics rate.
    """
    check_selector(kind)
    return (PaperSelector if kind == "paper" else MonitorSelectorAdapter)(spec, num_robots)


def check_selector(kind: str) -> None:
    """Raise RenetError for a name that no selector has."""
    if kind not in SELECTORS:
        raise RenetError(f"unknown selector '{kind}': choose one of {', '.join(SELECTORS)}")


class MonitorSelectorAdapter:
    """A bundle's monitors, with dwell, as a selector of rollouts."""

    def __init__(self, spec: SelectorSpec, num_robots: int) -> None:
        """Set up; raises RenetError for a rate that is no whole fraction of the physics rate."""
        self._every = updates_apart(spec.rate_hz)
        found = default_monitors(spec.beta, spec.thresholds, num_robots)
        cfg = GuardCfg(spec.gamma, spec.rate_hz)
        self.selector = GuardedSelector(found, num_robots, cfg)
        self._calls = 0
        self._fresh = np.zeros(num_robots, bool)

    @property
    def probability(self) -> np.ndarray:
        """Vision probability P_t, [N]."""
        return self.selector.probability

    def update(self, sight: Sight) -> np.ndarray:
        """Take one input; the selector acts at the end of each of its own periods."""
        self._calls += 1
        self._fresh = self._fresh | sight.fresh
        if self._calls % self._every == 0:
            seen = sight if self._every == 1 else Sight(**(vars(sight) | {"fresh": self._fresh}))
            self._fresh = np.zeros_like(self._fresh)
            self.selector.update(seen)
        return self.selector.vision

    def reset(self, mask: np.ndarray) -> None:
        """Start anew for the masked robots [N]."""
        self.selector.reset(mask)


class PaperSelector:
    """The paper's selector as a selector of rollouts: it looks at the anomaly score alone."""

    def __init__(self, spec: SelectorSpec, num_robots: int) -> None:
        """Set up; raises RenetError for a rate that is no whole fraction of the physics rate."""
        self._every = updates_apart(spec.rate_hz)
        self._selector = Selector(SelectorCfg(spec.beta, spec.gamma, spec.rate_hz), num_robots)
        self._trusted = np.ones(num_robots, bool)
        self._calls = 0

    @property
    def probability(self) -> np.ndarray:
        """Vision probability P_t, [N]."""
        return self._selector.probability

    def update(self, sight: Sight) -> np.ndarray:
        """Take one input; the selector acts at the end of each of its own periods."""
        return self.judge(sight.anomaly_score)

    def judge(self, anomaly_score: np.ndarray) -> np.ndarray:
        """`update` from the score [N] alone."""
        self._calls += 1
        if self._calls % self._every == 0:
            self._trusted = self._selector.update(anomaly_score)
        return self._trusted

    def reset(self, mask: np.ndarray) -> None:
        """Start anew for the masked robots [N]."""
        self._selector.reset(mask)
        self._trusted = self._trusted | mask


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
