"""The paper's low-pass filter on "vision looks healthy" (RENet eq. 5)."""

import math

import numpy as np

VISION_THRESHOLD = 0.5
"""VP drives while P_t is larger (paper)."""


def low_pass(
    probability: np.ndarray, healthy: np.ndarray, gamma: float, count: int = 1
) -> np.ndarray:
    """P_t = (1 - gamma) P_{t-1} + gamma P^_t, [N], `count` times with the same P^_t.

    Args:
        probability: vision probability P_{t-1}, [N].
        healthy: verdicts P^_t, [N] bool.
        gamma: weight of a new verdict, above 0 and at most 1. count: number of updates.
    """
    return healthy + (1.0 - gamma) ** count * (probability - healthy)


def filter_delay(gamma: float, rate_hz: float) -> float:
    """Seconds from the first unhealthy update to OP, starting from P = 1.

    P falls to (1 - gamma)^n after n updates, and OP drives from one half down: at gamma = 0.1 that
    takes 7 updates, which are 35 ms at 200 Hz and 0.7 s at 10 Hz.
    """
    if gamma >= VISION_THRESHOLD:
        return 1.0 / rate_hz
    return math.ceil(math.log(VISION_THRESHOLD) / math.log(1.0 - gamma)) / rate_hz
