"""A selector of several monitors, slow to trust again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from renet.selector.filter import LowPassFilter
from renet.selector.monitors import Monitor, Sight


@dataclass(frozen=True)
class GuardCfg:
    """How fast vision is left and how slowly it is trusted again."""

    gamma: float = 0.1
    """Weight of a new verdict in the filter (paper)."""
    rate_hz: float = 200.0
    """Updates per second."""
    dwell: float = 1.0
    """Seconds without an objection before vision is trusted again."""
    between_returns: float = 5.0
    """Seconds between two returns to vision: a flickering camera costs one flap in that time."""


class GuardedSelector:
    """Leaves vision when the filtered verdict of all monitors says so, and returns after a dwell.

    Leaving is never delayed beyond the paper's filter: only coming back is.
    """

    def __init__(self, monitors: Sequence[Monitor], num_robots: int, cfg: GuardCfg) -> None:
        self.cfg, self.monitors = cfg, list(monitors)
        self.filter = LowPassFilter(cfg.gamma, num_robots)
        self.vision = np.ones(num_robots, bool)
        """Whether each robot trusts vision, [N]."""
        self.reason = np.full(num_robots, "", object)
        """What the first objecting monitor said at the last departure from vision, [N]."""
        self.scores = np.zeros((len(self.monitors), num_robots))
        """Every monitor's score at the last update, [M, N], in the order of `monitors`."""
        self._thresholds = np.array([[monitor.threshold] for monitor in self.monitors])
        self._calm = np.zeros(num_robots)
        self._since_return = np.full(num_robots, np.inf)

    @property
    def probability(self) -> np.ndarray:
        """Vision probability P_t, [N]."""
        return self.filter.probability

    def update(self, sight: Sight) -> np.ndarray:
        """One update at `rate_hz`; returns "use vision", [N] bool."""
        step = 1.0 / self.cfg.rate_hz
        # Every monitor looks at every update: some remember what they saw.
        self.scores = np.stack([monitor.score(sight) for monitor in self.monitors])
        verdicts = self.scores < self._thresholds
        healthy = np.logical_and.reduce(verdicts)
        likely = self.filter.update(healthy)
        self._calm = np.where(healthy, self._calm + step, 0.0)
        self._since_return += step
        leaving = self.vision & ~likely
        rested = self._since_return >= self.cfg.between_returns
        returning = ~self.vision & likely & (self._calm >= self.cfg.dwell) & rested
        for robot in np.flatnonzero(leaving & ~healthy):
            self.reason[robot] = self.monitors[int(verdicts[:, robot].argmin())].reason
        self._since_return[returning] = 0.0
        self.reason[returning] = ""
        self.vision = (self.vision & ~leaving) | returning
        return self.vision

    def reset(self, mask: np.ndarray) -> None:
        """Trust vision again for the masked robots."""
        self.filter.reset(mask)
        self.vision[mask], self.reason[mask] = True, ""
        self._calm[mask], self._since_return[mask] = 0.0, np.inf
        for monitor in self.monitors:
            monitor.reset(mask)
