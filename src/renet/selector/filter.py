"""The paper's low-pass filter on "vision looks healthy" (RENet eq. 5)."""

import math

import numpy as np

from renet.errors import RenetError

VISION_THRESHOLD = 0.5
"""Vision is chosen while P_t is larger (paper)."""


class LowPassFilter:
    """P_t = (1 - gamma) P_{t-1} + gamma P^_t for N robots; P_0 = 1: vision is trusted at first."""

    def __init__(self, gamma: float, num_robots: int = 1) -> None:
        if not 0.0 < gamma <= 1.0:
            raise RenetError(f"the filter's gamma must be in (0, 1], got {gamma}")
        self.gamma = gamma
        self.probability = np.ones(num_robots)
        """Vision probability P_t, [N]."""

    def update(self, healthy: np.ndarray, count: int = 1) -> np.ndarray:
        """Take P^_t ([N] bool) `count` times; returns whether P_t chooses vision, [N] bool."""
        self.probability = healthy + (1.0 - self.gamma) ** count * (self.probability - healthy)
        return self.probability > VISION_THRESHOLD

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Trust vision again for the masked robots, by default all."""
        self.probability[slice(None) if mask is None else mask] = 1.0


def switch_delay(gamma: float, rate_hz: float) -> float:
    """Seconds from the first unhealthy update to OP, starting from P = 1.

    P falls to (1 - gamma)^n after n updates and must not exceed one half: at gamma = 0.1 that
    takes 7 updates, 35 ms at 200 Hz but 0.7 s at the 10 Hz of the images.
    """
    if gamma >= VISION_THRESHOLD:
        return 1.0 / rate_hz
    return math.ceil(math.log(VISION_THRESHOLD) / math.log(1.0 - gamma)) / rate_hz
