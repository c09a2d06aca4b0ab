"""What a terminal shows while `renet train` runs: a bar, or a line now and then."""

import time

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from renet.training.runner import RenetRunner

LINE_EVERY = 10.0
"""Seconds between two lines where there is no terminal to draw a bar on."""
CURVES = {
    "steps/s": ("Perf/total_fps", ".0f"),
    "reward": ("Train/mean_reward", ".2f"),
    "length": ("Train/mean_episode_length", ".0f"),
    "rate": ("Loss/learning_rate", ".0e"),
}
"""Curves that are shown, with their formats, by the words for them."""


class Report(Progress):
    """Says how a run is doing, after each iteration; the bar is drawn inside `with`."""

    def __init__(self, console: Console, runner: RenetRunner, iterations: int) -> None:
        """Begin to report on a runner, which ends after so many iterations in all."""
        super().__init__(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[status]}"),
            console=console,
            disable=not console.is_terminal,  # A redrawn bar would be noise.
            redirect_stdout=False,
            refresh_per_second=4,
        )
        self._runner, self._last, self._printed = runner, iterations, -LINE_EVERY
        self._bar = self.add_task("train", total=iterations - runner.alg.iteration, status="")

    def iterate(self) -> None:
        """Say how an iteration went: steps, speed and the curves one watches."""
        latest = getattr(self._runner.logger.writer, "latest", {})
        shown = [f"{n} {latest[tag]:{form}}" for n, (tag, form) in CURVES.items() if tag in latest]
        status = "  ".join([f"{self._runner.alg.steps / 1e6:.2f} M steps", *shown])
        self.update(self._bar, advance=1, status=status)
        if self.disable and time.monotonic() - self._printed >= LINE_EVERY:
            self._printed = time.monotonic()
            done = f"{self._runner.alg.iteration}/{self._last}"
            self.console.print(f"{done}  {status}", soft_wrap=True)
