"""Films of a training run, now and then, by `renet play` in a process beside it."""

import math
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from renet.training.checkpoint import checkpoints
from renet.training.runner import CHECKPOINTS

FILMS = "films"
"""Folder of the films, in a run's own."""
GAP_LEVEL = 3
"""Level of the tile that is filmed: a gap of 23 cm."""
PATIENCE = 600.0
"""Seconds that the end of a run waits for its last film, at most."""


class Films:
    """Films the newest checkpoint every so many iterations, one film at a time.

    The camera's estimator and the blind one walk side by side. A film that fails costs the run
    nothing: it is told in a line.
    """

    def __init__(self, run: Path, every: int, tiles: bool, say: Callable[[str], None]) -> None:
        """Begin to film.

        Args:
            run: folder of the run. every: iterations from one film to the next.
            tiles: whether the task has tiles; if not, robots are filmed on flat ground.
            say: tells the user a line.
        """
        self._run, self._every, self._say = run, every, say
        self._ground = ["--terrain", "gap", "--level", str(GAP_LEVEL)]
        if not tiles:
            self._ground = ["--terrain", "flat"]
        self._process: subprocess.Popen[bytes] | None = None
        self._path = Path()
        self._begun = self._rounds()
        """Multiples of `every` that the newest film's checkpoint, or what a run goes on from, has
        behind it."""

    def iterate(self) -> None:
        """Note that an iteration is done; starts a film if it is time for one."""
        self._look()
        if self._process is not None or self._rounds() <= self._begun:
            return
        self._begun = self._rounds()
        checkpoint = self._checkpoints()[-1]
        self._path = self._run / FILMS / f"{checkpoint.name}.mp4"
        self._process = subprocess.Popen(
            self.command(checkpoint, self._path),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            # Ctrl-C is for the training, which ends the film.
            start_new_session=True,
        )

    def command(self, checkpoint: Path, film: Path) -> Sequence[str]:
        """The command that films a checkpoint."""
        play = ["nice", sys.executable, "-m", "renet", "play", str(checkpoint), "--out", str(film)]
        seen = ["--modes", "camera", "blind", "--viewer", "none", "--fault"]
        return [*play, *self._ground, *seen]

    def close(self, left: float = math.inf) -> None:
        """Wait for the film that is being made, but no longer than `left` seconds; then end it."""
        if self._process is None:
            return
        try:
            self._process.wait(min(max(left, 0.0), PATIENCE))
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.communicate()
            self._process = None
            return
        self._look()

    def _checkpoints(self) -> list[Path]:
        """Those of the run, oldest first."""
        return checkpoints(self._run / CHECKPOINTS)

    def _rounds(self) -> int:
        """Multiples of `every` that the newest checkpoint has behind it."""
        newest = self._checkpoints()[-1:]
        return int(newest[0].name.removeprefix("it_")) // self._every if newest else 0

    def _look(self) -> None:
        """Say what became of a film that has ended."""
        if self._process is None or self._process.poll() is None:
            return
        _, errors = self._process.communicate()
        failed, self._process = self._process.returncode != 0, None
        if failed:
            lines = errors.decode(errors="replace").strip().splitlines() or ["no reason given"]
            self._say(f"No film {self._path.name}: {lines[-1]}")
        else:
            self._say(f"Film: {self._path}")


@contextmanager
def filming(
    films: Films | None, deadline: float, stopped: Sequence[int]
) -> Iterator[Callable[[], None]]:
    """What to call after each iteration; None makes no films.

    The end waits for the last film, unless a signal has `stopped` the run, or until the `deadline`,
    a time of the monotonic clock.
    """
    if films is None:
        yield lambda: None
        return
    try:
        yield films.iterate
        films.iterate()  # The last checkpoint.
    finally:
        films.close(0.0 if stopped else deadline - time.monotonic())
