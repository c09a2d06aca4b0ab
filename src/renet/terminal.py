"""Progress bars, tables, and lines that a thread prints, so that no terminal stalls a robot."""

import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from queue import Full, Queue
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import track
from rich.table import Table

from renet.errors import printable

Step = TypeVar("Step")
MAX_WAITING = 1000
"""Lines that wait for a stalled terminal; later ones are dropped."""


class Terminal:
    """Prints lines in order, on a thread.

    `logging.handlers.QueueListener` would do, but its `stop` waits for a hung terminal.
    """

    def __init__(self) -> None:
        self._lines: Queue[str | None] = Queue(MAX_WAITING)
        self._thread = threading.Thread(target=self._print, daemon=True)
        self._thread.start()

    def say(self, line: str) -> None:
        """Print a line soon."""
        with suppress(Full):
            self._lines.put_nowait(printable(line))

    def close(self) -> None:
        """Print the lines that wait; give up after a second if the terminal hangs."""
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
    """Print a table on standard output, without markup: a bundle's texts are not trusted."""
    table = Table(*header, title=printable(title), title_justify="left", title_style="bold")
    for row in rows:
        table.add_row(*(printable(str(cell)) for cell in row))
    Console(markup=False, emoji=False).print(table)


Listener = Callable[[str, int, int], None]
"""Takes a title, the steps done and the number of all."""
_listener: Listener | None = None


def tell_progress(listener: Listener) -> None:
    """Let `progress` tell a listener from now on, instead of showing bars."""
    global _listener
    _listener = listener


def progress(steps: Sequence[Step], title: str) -> Iterable[Step]:
    """Yield the steps, with a bar on standard error that shows the time left."""
    if _listener is not None:
        return _told(steps, title, _listener)
    return track(steps, f"{title:<24}", console=Console(stderr=True))


def _told(steps: Sequence[Step], title: str, listener: Listener) -> Iterator[Step]:
    for done, step in enumerate(steps):
        listener(title, done, len(steps))
        yield step
