"""The paper's auto selector: reconstruction loss against beta, filtered (RENet, Method B)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from renet.errors import RenetError
from renet.selector.filter import LowPassFilter


@dataclass(frozen=True)
class SelectorCfg:
    """What the selector needs to know."""

    beta: float
    """Threshold on the anomaly score; see `renet calibrate`."""
    gamma: float = 0.1
    """Weight of a new verdict in the filter (paper)."""
    rate_hz: float = 200.0
    """Filter updates per second: at 200 Hz gamma = 0.1 switches within the paper's 0.04 s."""

    def __post_init__(self) -> None:
        if not np.isfinite(self.beta) or self.beta <= 0.0:
            raise RenetError(f"the selector's beta must be positive, got {self.beta}")
        if self.rate_hz <= 0.0:
            raise RenetError(f"the selector's rate must be positive, got {self.rate_hz}")


class Selector:
    """Chooses VP or OP for N robots. A score that is not finite counts as an anomaly."""

    def __init__(self, cfg: SelectorCfg, num_robots: int = 1) -> None:
        self.cfg = cfg
        self.filter = LowPassFilter(cfg.gamma, num_robots)

    @property
    def probability(self) -> np.ndarray:
        """Vision probability P_t, [N]."""
        return self.filter.probability

    def update(self, anomaly_score: np.ndarray) -> np.ndarray:
        """One update at `rate_hz` with the newest Loss_ad [N]; returns "use vision", [N] bool."""
        return self.filter.update(np.asarray(anomaly_score) < self.cfg.beta)

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Trust vision again for the masked robots, by default all."""
        self.filter.reset(mask)
