"""What a terminal shows while `renet train` runs: a bar, or a line now and then."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from renet.training.runner import RenetRunner

LINE_EVERY = 10.0
"""Seconds between two lines where there is no terminal to draw a bar on."""


class Report:
    """Says how a run is doing, after each iteration."""

    def __init__(self, console: Console, runner: RenetRunner, iterations: int) -> None:
        """Begin to report.

        Args:
            console: to print on. runner: whose run it is. iterations: after which it ends.
        """
        self._console, self._runner, self._last = console, runner, iterations
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[status]}"),
            console=console,
            # Without a terminal a redrawn bar is noise.
            disable=not console.is_terminal,
            redirect_stdout=False,
            refresh_per_second=4,
        )
        done = runner.alg.iteration
        self._task = self._bar.add_task("train", total=iterations - done, status="")
        self._printed = -LINE_EVERY

    @contextmanager
    def shown(self) -> Iterator[None]:
        """Draw the bar inside."""
        with self._bar:
            yield

    def update(self) -> None:
        """Say how the iteration went."""
        self._bar.update(self._task, advance=1, status=self._status())
        if self._bar.disable and time.monotonic() - self._printed >= LINE_EVERY:
            self._printed = time.monotonic()
            done = f"{self._runner.alg.iteration}/{self._last}"
            self._console.print(f"{done}  {self._status()}", soft_wrap=True)

    def _status(self) -> str:
        """Steps, speed and the curves one watches."""
        latest = getattr(self._runner.logger.writer, "latest", {})
        shown = {
            "steps/s": ("Perf/total_fps", ".0f"),
            "reward": ("Train/mean_reward", ".2f"),
            "length": ("Train/mean_episode_length", ".0f"),
            "rate": ("Loss/learning_rate", ".0e"),
        }
        parts = [f"{self._runner.alg.steps / 1e6:.2f} M steps"]
        parts += [f"{name} {latest[t]:{fmt}}" for name, (t, fmt) in shown.items() if t in latest]
        return "  ".join(parts)
