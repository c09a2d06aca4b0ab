"""Films of a training run at regular intervals, by `renet play` in a process beside it."""

import math
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from renet.errors import reason
from renet.program import own_program
from renet.training.checkpoint import checkpoints
from renet.training.runner import CHECKPOINTS

FILMS = "films"
"""Name of the folder of films in a run's folder."""
GAP_LEVEL = 3
"""Level of the tile that is filmed: a gap of 23 cm."""
LONGEST_WAIT = 600.0
"""Longest time that the end of a run waits for its last film, s."""


class Films:
    """Films of the newest checkpoint every so many iterations, one at a time.

    A film shows two robots side by side: one steered by VP, one by OP. A film that fails does not
    disturb the training: a line says why it failed.
    """

    def __init__(self, run: Path, every: int, tiles: bool, say: Callable[[str], None]) -> None:
        """Initialize films of a run.

        Args:
            run: Folder of the run.
            every: Iterations from one film to the next.
            tiles: True if the task has tiles. Without them, robots are filmed on flat ground.
            say: Function that prints a line for the user.
        """
        self._run = run
        self._every = every
        self._say = say
        self._ground = ["--terrain", "gap", "--level", str(GAP_LEVEL)]
        if not tiles:
            self._ground = ["--terrain", "flat"]
        self._process: subprocess.Popen[bytes] | None = None
        self._path = Path()
        # The checkpoint from which a run continues is not filmed.
        self._last_round = self._newest_round()

    def update(self) -> None:
        """Start a film if it is time for one; called after each iteration."""
        self._report_end()
        newest = self._newest_round()
        if self._process is not None or newest <= self._last_round:
            return
        self._last_round = newest
        checkpoint = checkpoints(self._run / CHECKPOINTS)[-1]
        self._path = self._run / FILMS / f"{checkpoint.name}.mp4"
        try:
            self._process = subprocess.Popen(
                self.command(checkpoint, self._path),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                # Ctrl-C reaches the training alone, which then ends the film.
                start_new_session=True,
            )
        except OSError as error:
            # Memory or the user's processes are used up, for example.
            self._say(f"No film {self._path.name}: {reason(error)}")

    def command(self, checkpoint: Path, film: Path) -> Sequence[str]:
        """Return the command line that films a checkpoint."""
        play = ["nice", *own_program(), "play", str(checkpoint), "--out", str(film)]
        # The last option without values: no fault.
        robots = ["--modes", "camera", "blind", "--viewer", "none", "--fault"]
        return [*play, *self._ground, *robots]

    def close(self, limit: float = math.inf) -> None:
        """Wait for an unfinished film for up to `limit` seconds, then end it."""
        if self._process is None:
            return
        try:
            self._process.wait(min(max(limit, 0.0), LONGEST_WAIT))
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.communicate()
            self._process = None
            return
        self._report_end()

    def _newest_round(self) -> int:
        """Return how many times `every` iterations the newest checkpoint has had."""
        newest = checkpoints(self._run / CHECKPOINTS)[-1:]
        if not newest:
            return 0
        return int(newest[0].name.removeprefix("it_")) // self._every

    def _report_end(self) -> None:
        """Print the path of a film that has ended, or why it failed."""
        if self._process is None or self._process.poll() is None:
            return
        _, errors = self._process.communicate()
        code = self._process.returncode
        self._process = None
        if code:
            lines = errors.decode(errors="replace").strip().splitlines() or ["no reason given"]
            self._say(f"No film {self._path.name}: {lines[-1]}")
        else:
            self._say(f"Film: {self._path}")


@contextmanager
def filming(
    films: Films | None, deadline: float, signals: Sequence[int]
) -> Iterator[Callable[[], None]]:
    """Context with a function to call after each iteration; its end waits for the last film.

    Args:
        films: The films, or None for none.
        deadline: Time of the monotonic clock until which the end waits, s.
        signals: Signals that the run has received; after one the end does not wait.
    """
    if films is None:
        yield lambda: None
        return
    try:
        yield films.update
        # The last checkpoint is written after the last iteration.
        films.update()
    finally:
        films.close(0.0 if signals else deadline - time.monotonic())
