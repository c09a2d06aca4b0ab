"""Progress bars, tables, and lines from a thread: a stalled terminal must not stall a robot."""

import threading
from collections.abc import Iterable, Sequence
from contextlib import suppress
from queue import Full, Queue
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import track
from rich.table import Table

Step = TypeVar("Step")
MAX_WAITING = 1000
"""Lines that wait for a terminal that takes none; later ones are lost."""


class Terminal:
    """Prints lines in order, later.

    `logging.handlers.QueueListener` would do, if its `stop` did not wait for a hung terminal.
    """

    def __init__(self) -> None:
        self._lines: Queue[str | None] = Queue(MAX_WAITING)
        self._thread = threading.Thread(target=self._print, daemon=True)
        self._thread.start()

    def say(self, line: str) -> None:
        """Print a line soon."""
        with suppress(Full):
            self._lines.put_nowait(line)

    def close(self) -> None:
        """Print what is left; give up after a second on a terminal that takes nothing."""
        with suppress(Full):
            self._lines.put(None, timeout=1.0)
        self._thread.join(timeout=1.0)

    def _print(self) -> None:
        while (line := self._lines.get()) is not None:
            try:
                print(line, flush=True)
            except OSError:  # The terminal is gone.
                return


def show(title: str, header: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    """Print a table on standard output, texts as they are: a bundle's are a stranger's."""
    table = Table(*header, title=title, title_justify="left", title_style="bold")
    for row in rows:
        table.add_row(*map(str, row))
    Console(markup=False, emoji=False).print(table)


def progress(steps: Iterable[Step], title: str) -> Iterable[Step]:
    """The steps one after the other, beside a bar on standard error with the time that is left."""
    return track(steps, f"{title:<24}", console=Console(stderr=True))
