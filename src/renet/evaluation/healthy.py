"""What the monitors say of healthy robots: the ground their thresholds are learnt on."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from renet.evaluation.trace import UPDATES_PER_STEP, Trace
from renet.interface import CONTROL_DT, STEPS_PER_TICK
from renet.selector.monitors import MONITORS, SelectorInput, default_monitors

UPDATES_PER_TICK = UPDATES_PER_STEP * STEPS_PER_TICK
TICK_RATE = 1.0 / (CONTROL_DT * STEPS_PER_TICK)
"""Hz."""


class ScoreLog:
    """Writes down every monitor's score; pass it to `run_rollout` as `on_sight`."""

    def __init__(self, num_robots: int) -> None:
        # Only scores are asked for: thresholds do not matter.
        self._monitors = default_monitors(1.0, dict.fromkeys(MONITORS, 1.0), num_robots)
        self._ticks: list[np.ndarray] = []
        self._updates = 0

    def __call__(self, sight: SelectorInput) -> None:
        """Take the scores of one update; a tick keeps the highest of its updates."""
        scores = np.stack([monitor.score(sight) for monitor in self._monitors])
        if self._updates % UPDATES_PER_TICK == 0:
            self._ticks.append(scores)
        else:
            np.maximum(self._ticks[-1], scores, out=self._ticks[-1])
        self._updates += 1

    @property
    def scores(self) -> dict[str, np.ndarray]:
        """Scores by monitor name, [ticks, N]."""
        table = np.stack(self._ticks)
        return {monitor.name: table[:, i] for i, monitor in enumerate(self._monitors)}


def successful_runs(trace: Trace, speed: float = 0.0) -> list[tuple[int, slice]]:
    """Robot and vision ticks of every episode that succeeded, cameras healthy.

    It did not end in a fall, and the robot came at least half as far as it was told to (the
    curriculum's rule): one that stands with its nose to a step sees a blank image. A robot still
    walking when the run ends succeeded, too. The steps between a restart and the next tick see an
    old image and are left out.

    Args:
        trace: of the run. speed: commanded, m/s; 0 forgives standing still.
    """
    runs = []
    for robot in range(trace.anomaly.shape[1]):
        edges = [0, *(np.flatnonzero(trace.ended[:, robot]) + 1).tolist(), len(trace.anomaly)]
        for start, end in pairwise(edges):
            first, beyond = -(-start // STEPS_PER_TICK), -(-end // STEPS_PER_TICK)
            if beyond <= first or trace.fell[end - 1, robot]:
                continue
            # The last step's reading may be the next start's.
            reached = trace.travelled[start:end, robot].max()
            if reached >= 0.5 * speed * (end - start) * CONTROL_DT:
                runs.append((robot, slice(first, beyond)))
    return runs


def healthy_series(log: ScoreLog, trace: Trace, speed: float = 0.0) -> dict[str, list[np.ndarray]]:
    """Scores of the episodes that succeeded, [T] each, by monitor name; see `successful_runs`."""
    runs = successful_runs(trace, speed)
    return {
        name: [table[ticks, robot] for robot, ticks in runs] for name, table in log.scores.items()
    }
