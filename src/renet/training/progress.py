"""Progress of `renet train` in a terminal: a bar, or without a terminal a line each minute."""

import math
import time
from collections import deque
from typing import Self

from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from renet.curves import LEVEL
from renet.terminal import LINE_EVERY, time_text
from renet.training.runner import RenetRunner

RECENT = 20
"""Number of recent iterations from which the remaining time is estimated; batches grow, so that
older ones were faster."""
SPEED_CURVE = "Perf/total_fps"
"""Curve of the environment steps per second."""
REWARD_CURVE = "Train/mean_reward"
"""Curve of the mean reward per episode."""


class Report:
    """Report on a run after each iteration; a context manager that draws the bar."""

    def __init__(
        self, console: Console, runner: RenetRunner, iterations: int, deadline: float
    ) -> None:
        """Initialize the report.

        Args:
            console: Console to print on.
            runner: Runner of the training.
            iterations: Number of iterations at which the run ends, counted from its very first.
            deadline: Time of the monotonic clock at which the run ends at the latest, s. If it is
                finite, the bar shows time in place of iterations.
        """
        self._console = console
        self._runner = runner
        self._first = runner.alg.iteration
        self._last = iterations
        self._start = time.monotonic()
        self._deadline = deadline
        self._lap_ends: deque[float] = deque([self._start], RECENT + 1)
        self._line_time = -math.inf
        self._latest: dict[str, float] = {}
        # In a file a bar, which is redrawn all the time, would be noise; TERM=dumb shows none.
        self._live = None
        if console.is_interactive:
            self._live = Live(
                console=console,
                get_renderable=self.picture,
                refresh_per_second=4,
                redirect_stdout=False,
            )

    def __enter__(self) -> Self:
        if self._live:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live:
            self._live.stop()

    def update(self) -> None:
        """Record the end of an iteration, and print a line without a terminal, once a minute."""
        now = time.monotonic()
        self._lap_ends.append(now)
        # The newest value of each curve. A copy, because the bar is drawn on another thread.
        self._latest = dict(getattr(self._runner.logger.writer, "latest", {}))
        if self._live is None and now - self._line_time >= LINE_EVERY:
            self._line_time = now
            line = "  ".join([*self._facts(), self._levels()])
            self._console.print(line.rstrip(), soft_wrap=True)

    def picture(self) -> Group:
        """Draw two lines of up to 80 columns: the bar with its facts, and the levels."""
        progress = self._progress()
        row = Table.grid(padding=(0, 2, 0, 0), expand=True)
        row.add_column(ratio=1)
        facts = [f"{progress:4.0%}", *self._facts()]
        for _ in facts:
            row.add_column(no_wrap=True)
        row.add_row(ProgressBar(total=1.0, completed=progress), *map(Text, facts))
        return Group(row, Text(self._levels(), no_wrap=True, overflow="ellipsis"))

    def _facts(self) -> list[str]:
        """Format iterations, steps, speed and remaining time."""
        algorithm = self._runner.alg
        facts = []
        if self._deadline < math.inf:
            facts.append(f"iteration {algorithm.iteration}")
        else:
            facts.append(f"{algorithm.iteration}/{self._last}")
        facts.append(f"{algorithm.steps / 1e6:.2f} M steps")
        if SPEED_CURVE in self._latest:
            facts.append(f"{self._latest[SPEED_CURVE]:,.0f} steps/s")
        facts.append(f"{time_text(self._remaining_time())} left")
        return facts

    def _levels(self) -> str:
        """Format the level of each kind of tile, or the reward of a task without tiles."""
        levels = []
        for tag, level in sorted(self._latest.items()):
            if tag.startswith(LEVEL):
                levels.append(f"{tag.removeprefix(LEVEL)} {level:.1f}")
        if levels:
            return " ".join(levels)
        if REWARD_CURVE in self._latest:
            return f"reward {self._latest[REWARD_CURVE]:.2f}"
        return ""

    def _remaining_time(self) -> float:
        """Estimate the time until the run ends, s; infinity before the first iteration is done."""
        now = time.monotonic()
        iterations = self._last - self._runner.alg.iteration
        laps = len(self._lap_ends) - 1
        by_iterations = math.inf
        if laps:
            by_iterations = iterations * (self._lap_ends[-1] - self._lap_ends[0]) / laps
            by_iterations -= now - self._lap_ends[-1]
        by_deadline = self._deadline - now
        return max(min(by_iterations, by_deadline), 0.0)

    def _progress(self) -> float:
        """Return the part of the run that is done, from 0 to 1: of its iterations or its time.

        The larger of the two counts, because the run ends with whichever is reached first.
        """
        iterations = self._runner.alg.iteration - self._first
        of_iterations = iterations / max(self._last - self._first, 1)
        limit = self._deadline - self._start
        # Loading may have used all of the time.
        of_time = (time.monotonic() - self._start) / limit if limit > 0.0 else 1.0
        return min(max(of_iterations, of_time), 1.0)
