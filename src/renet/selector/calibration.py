"""Thresholds from healthy runs: the paper's maximum, or a quantile with a stated guarantee."""

from __future__ import annotations

import math

import numpy as np

from renet.errors import RenetError


def calibrate(scores: np.ndarray) -> float:
    """Beta: the largest anomaly score of successful episodes in simulation (RENet, Method B)."""
    return float(_checked(scores).max())


def conformal_threshold(scores: np.ndarray, alpha: float) -> float:
    """The score a new healthy one exceeds with probability at most `alpha` (split conformal).

    With n scores it is the one of rank ceil((n + 1)(1 - alpha)); the paper's maximum is the case
    alpha = 1 / (n + 1).

    Raises:
        RenetError: too few scores for so small an alpha.
    """
    scores = np.sort(_checked(scores))
    rank = math.ceil((len(scores) + 1) * (1.0 - alpha))
    if not 0.0 < alpha < 1.0 or rank > len(scores):
        raise RenetError(
            f"a false-alarm probability of {alpha} needs at least {math.ceil(1 / alpha) - 1} "
            f"healthy scores, got {len(scores)}"
            if 0.0 < alpha < 1.0
            else f"alpha must be between 0 and 1, got {alpha}"
        )
    return float(scores[max(rank, 1) - 1])


def _checked(scores: np.ndarray) -> np.ndarray:
    scores = np.asarray(scores, float).ravel()
    if scores.size == 0 or not np.isfinite(scores).all():
        raise RenetError("calibration needs at least one score, all of them finite")
    return scores
