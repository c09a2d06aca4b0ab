"""Scores of the monitors in a rollout, and answers of other selectors to them."""

import math
from itertools import pairwise

import numpy as np

from renet.evaluation.trace import UPDATES_PER_STEP, Trace
from renet.interface import CONTROL_DT, PHYSICS_DT, STEPS_PER_TICK
from renet.pilot.pilot import Selector
from renet.selector.monitors import MONITORS, Scorer, SelectorInput


class MonitorLog:
    """Record of every monitor's score; pass it as a rollout's `on_update`."""

    def __init__(self, num_robots: int) -> None:
        self._scorer = Scorer(num_robots)
        self._ticks: list[np.ndarray] = []
        self._updates = 0

    def __call__(self, seen: SelectorInput) -> None:
        """Record the scores of one update; a tick keeps the highest of its updates."""
        scores = self._scorer.scores(seen)
        if self._updates % (UPDATES_PER_STEP * STEPS_PER_TICK) == 0:
            self._ticks.append(scores)
        else:
            np.maximum(self._ticks[-1], scores, out=self._ticks[-1])
        self._updates += 1

    @property
    def scores(self) -> dict[str, np.ndarray]:
        """Scores by monitor name, [ticks, N]."""
        return dict(zip(MONITORS, np.stack(self._ticks, axis=1), strict=True))


def successful_runs(trace: Trace, speed: float = 0.0) -> list[tuple[int, slice]]:
    """List robot and vision ticks of every successful episode of a run with healthy cameras.

    An episode succeeds if it does not end in a fall and the robot covers at least half of the
    commanded distance (the curriculum's rule), for a robot stuck in front of a step sees a blank
    image. A robot still walking when the run ends succeeds, too. The steps between a restart and
    the next tick have an old image and are left out. With a `speed` of 0 m/s, standing still is a
    success.
    """
    runs = []
    for robot in range(trace.anomaly.shape[1]):
        edges = [0, *(np.flatnonzero(trace.ended[:, robot]) + 1).tolist(), len(trace.anomaly)]
        for start, end in pairwise(edges):
            # Ticks that begin within the episode.
            first = math.ceil(start / STEPS_PER_TICK)
            beyond = math.ceil(end / STEPS_PER_TICK)
            if beyond <= first or trace.fell[end - 1, robot]:
                continue
            # The last step's reading may be the next start's.
            reached = trace.travelled[start:end, robot].max()
            if reached >= 0.5 * speed * (end - start) * CONTROL_DT:
                runs.append((robot, slice(first, beyond)))
    return runs


def healthy_series(
    log: MonitorLog, trace: Trace, speed: float = 0.0
) -> dict[str, list[np.ndarray]]:
    """Return the scores of successful episodes, [T] each, by monitor; see `successful_runs`."""
    runs = successful_runs(trace, speed)
    series = {}
    for name, table in log.scores.items():
        series[name] = [table[ticks, robot] for robot, ticks in runs]
    return series


def replay_selector(selector: Selector, anomaly: np.ndarray) -> np.ndarray:
    """Replay a run's anomaly scores to a selector that the run did not obey.

    Args:
        selector: Judges anomaly scores alone, as the paper's does.
        anomaly: Anomaly scores, [T, N].

    Returns:
        Answers, true where vision is trusted, [T, U, N].
    """
    answers = []
    for number, score in enumerate(np.repeat(anomaly, UPDATES_PER_STEP, axis=0), start=1):
        answer = selector.update(SelectorInput(score), number * PHYSICS_DT)
        answers.append(answer.copy())
    return np.array(answers).reshape(len(anomaly), UPDATES_PER_STEP, -1)
