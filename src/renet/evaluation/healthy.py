"""What the monitors say of healthy robots: the ground their thresholds are learnt on."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from renet.evaluation.trace import UPDATES_PER_STEP, Trace
from renet.selector.defaults import MONITORS, default_monitors
from renet.selector.monitors import Sight
from renet.vocabulary import CONTROL_DT, STEPS_PER_TICK

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

    def __call__(self, sight: Sight) -> None:
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


def successful_runs(trace: Trace) -> list[tuple[int, slice]]:
    """Robot and vision ticks of every episode that did not end in a fall.

    A robot still on its feet when the run ends succeeded, too. The steps between a restart and
    the next tick see an old image and are left out.
    """
    runs = []
    for robot in range(trace.anomaly.shape[1]):
        edges = [0, *(np.flatnonzero(trace.ended[:, robot]) + 1).tolist(), len(trace.anomaly)]
        for start, end in pairwise(edges):
            first, beyond = -(-start // STEPS_PER_TICK), -(-end // STEPS_PER_TICK)
            if beyond > first and not trace.fell[end - 1, robot]:
                runs.append((robot, slice(first, beyond)))
    return runs


def healthy_series(log: ScoreLog, trace: Trace) -> dict[str, list[np.ndarray]]:
    """Scores of the successful episodes, [T] each, by monitor name."""
    runs = successful_runs(trace)
    return {
        name: [table[ticks, robot] for robot, ticks in runs] for name, table in log.scores.items()
    }
