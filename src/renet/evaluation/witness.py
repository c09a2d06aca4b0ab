"""Looks over a rollout's shoulder: every monitor's score, and what other selectors would do."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from renet.evaluation.healthy import ScoreLog
from renet.evaluation.rollout import Switch
from renet.evaluation.trace import UPDATES_PER_STEP
from renet.selector.monitors import SelectorInput


class Witness:
    """Pass it to `run_rollout` as `on_sight`; nobody obeys the selectors it asks."""

    def __init__(self, num_robots: int, switches: Mapping[str, Switch]) -> None:
        self.log = ScoreLog(num_robots)
        self._switches = dict(switches)
        self._verdicts: dict[str, list[np.ndarray]] = {name: [] for name in switches}

    def __call__(self, sight: SelectorInput) -> None:
        """Take one update."""
        self.log(sight)
        for name, switch in self._switches.items():
            self._verdicts[name].append(switch.update(sight).copy())

    def trusted(self, name: str) -> np.ndarray:
        """[T, U, N] bool: one selector's answers, as `Trace.trusted`."""
        verdicts = np.stack(self._verdicts[name])
        return verdicts.reshape(-1, UPDATES_PER_STEP, verdicts.shape[1])


def suspicion(
    scores: Mapping[str, np.ndarray], thresholds: Mapping[str, float], healthy: int
) -> np.ndarray:
    """One score for a whole set of monitors, [ticks, N]: the largest of theirs.

    Each monitor's score is shifted and scaled so that 0 is its median over the first `healthy`
    ticks and 1 its threshold; the set objects where the result is 1 or more.

    Args:
        scores: [ticks, N] by monitor. thresholds: of the monitors in the set. healthy: ticks.
    """
    scaled = []
    for name, threshold in thresholds.items():
        usual = float(np.median(scores[name][:healthy]))
        scaled.append((scores[name] - usual) / max(threshold - usual, 1e-9))
    return np.max(scaled, axis=0)
