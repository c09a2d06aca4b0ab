"""The paper's low-pass filter of the verdicts on vision (RENet eq. 5)."""

import math

import numpy as np

VISION_THRESHOLD = 0.5
"""Vision probability P_t above which VP drives (paper)."""


def low_pass(
    probability: np.ndarray, healthy: np.ndarray, gamma: float, count: int = 1
) -> np.ndarray:
    """Compute P_t = (1 - gamma) P_{t-1} + gamma P^_t, [N].

    Args:
        probability: Vision probability P_{t-1}, [N].
        healthy: Verdicts P^_t, [N] bool.
        gamma: Weight of a new verdict, above 0 and at most 1.
        count: Number of updates, all with the same verdict.
    """
    # All updates at once: each multiplies the distance to the verdict by 1 - gamma.
    return healthy + (1.0 - gamma) ** count * (probability - healthy)


def filter_delay(gamma: float, rate_hz: float) -> float:
    """Return the time from the first unhealthy update until OP drives, s, if P is 1 before.

    After n updates P is (1 - gamma)^n, and OP drives when it is at most one half. With gamma = 0.1
    that takes 7 updates, which are 35 ms at 200 Hz and 0.7 s at 10 Hz.
    """
    if gamma >= VISION_THRESHOLD:
        return 1.0 / rate_hz
    return math.ceil(math.log(VISION_THRESHOLD) / math.log(1.0 - gamma)) / rate_hz
