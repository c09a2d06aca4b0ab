"""What a terminal shows while `renet train` runs: a bar, or a line now and then."""

import math
import time
from collections import deque
from datetime import timedelta
from typing import Self

from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from renet.training.metrics import LEVEL
from renet.training.runner import RenetRunner

LINE_EVERY = 60.0
"""Seconds between two lines where there is no terminal to draw a bar on."""
RECENT = 20
"""Iterations from which the time of those to come is estimated: batches grow."""
SPEED = "Perf/total_fps"
REWARD = "Train/mean_reward"


class Report:
    """Says how a run is doing, after each iteration; the bar is drawn inside `with`."""

    def __init__(
        self, console: Console, runner: RenetRunner, iterations: int, deadline: float = math.inf
    ) -> None:
        """Begin to report on a runner.

        Args:
            console: where to. runner: what trains.
            iterations: after which it ends, in all. deadline: time of the monotonic clock at which
            it ends if that comes first; if there is one, the bar shows time, not iterations.
        """
        self._console, self._runner = console, runner
        self._first, self._last = runner.alg.iteration, iterations
        self._begun, self._deadline = time.monotonic(), deadline
        self._laps: deque[float] = deque([self._begun], RECENT + 1)
        self._printed = -math.inf
        self._latest: dict[str, float] = {}
        # A redrawn bar would be noise in a file.
        self._live = (
            Live(
                console=console,
                get_renderable=self.picture,
                refresh_per_second=4,
                redirect_stdout=False,
            )
            if console.is_terminal
            else None
        )

    def __enter__(self) -> Self:
        if self._live:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live:
            self._live.stop()

    def iterate(self) -> None:
        """Note that an iteration is done, and print a line if there is no bar and it is time."""
        now = time.monotonic()
        self._laps.append(now)
        # The newest value of each curve: a copy, for the bar is drawn on another thread.
        self._latest = dict(getattr(self._runner.logger.writer, "latest", {}))
        if self._live is None and now - self._printed >= LINE_EVERY:
            self._printed = now
            line = "  ".join([*self._facts(), self._levels()])
            self._console.print(line.rstrip(), soft_wrap=True)

    def picture(self) -> Group:
        """Two lines that fit into 80 columns: the bar with speed and time left, and the levels."""
        share = self._share()
        row = Table.grid(padding=(0, 2, 0, 0), expand=True)
        row.add_column(ratio=1)
        facts = [f"{share:4.0%}", *self._facts()]
        for _ in facts:
            row.add_column(no_wrap=True)
        row.add_row(ProgressBar(total=1.0, completed=share), *map(Text, facts))
        return Group(row, Text(self._levels(), no_wrap=True, overflow="ellipsis"))

    def _facts(self) -> list[str]:
        """Iterations, steps, speed and time left."""
        algorithm, latest = self._runner.alg, self._latest
        timed = self._deadline < math.inf
        facts = [
            f"iteration {algorithm.iteration}" if timed else f"{algorithm.iteration}/{self._last}"
        ]
        facts.append(f"{algorithm.steps / 1e6:.2f} M steps")
        if SPEED in latest:
            facts.append(f"{latest[SPEED]:,.0f} steps/s")
        left = self._left()
        # Whole seconds; no number of days has more than nine digits.
        known = timedelta(seconds=math.ceil(left)) if left < 1e9 else "-:--:--"
        return [*facts, f"{known} left"]

    def _levels(self) -> str:
        """The level of each kind of tile, or where there are none the reward."""
        latest = self._latest
        levels = [(tag, level) for tag, level in sorted(latest.items()) if tag.startswith(LEVEL)]
        if levels:
            return " ".join(f"{tag.removeprefix(LEVEL)} {level:.1f}" for tag, level in levels)
        return f"reward {latest[REWARD]:.2f}" if REWARD in latest else ""

    def _left(self) -> float:
        """Seconds until the run ends; infinite if nobody can say yet."""
        now = time.monotonic()
        ahead = self._last - self._runner.alg.iteration
        laps = len(self._laps) - 1
        by_iterations = math.inf
        if laps:
            by_iterations = ahead * (self._laps[-1] - self._laps[0]) / laps
            by_iterations -= now - self._laps[-1]
        return max(min(by_iterations, self._deadline - now), 0.0)

    def _share(self) -> float:
        """How much of the run is done, 0 to 1: of its time if it is limited, else iterations."""
        done = self._runner.alg.iteration - self._first
        of_iterations = done / max(self._last - self._first, 1)
        limit = self._deadline - self._begun
        # Loading may have used the time up.
        of_time = (time.monotonic() - self._begun) / limit if limit > 0.0 else 1.0
        return min(max(of_iterations, of_time), 1.0)
