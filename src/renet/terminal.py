"""Progress bars, tables, and lines that a thread prints, so that no terminal stalls a robot."""

import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from queue import Full, Queue
from shutil import get_terminal_size
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import track
from rich.table import Table

from renet.errors import printable

Step = TypeVar("Step")
MAX_WAITING = 1000
"""Lines that wait for a stalled terminal; later ones are dropped."""
ERASE = "\r\x1b[K"
"""Goes to the start of the line and empties it."""


class Terminal:
    """Prints lines in order, on a thread, and keeps one line of status below them.

    `logging.handlers.QueueListener` would do, but its `stop` waits for a hung terminal.
    """

    def __init__(self) -> None:
        self._lines: Queue[str | None] = Queue(MAX_WAITING)
        self._status = ""
        # A file or a pipe would fill with what only an eye on it reads.
        self._draws = sys.stdout is not None and sys.stdout.isatty()
        self._thread = threading.Thread(target=self._print, daemon=True)
        self._thread.start()

    def say(self, line: str) -> None:
        """Print a line soon."""
        with suppress(Full):
            self._lines.put_nowait(f"{printable(line)}\n")

    def status(self, line: str) -> None:
        """Show a line below all others in place of the last one; on a terminal alone."""
        if not self._draws:
            return
        self._status = printable(line)
        # A terminal that stalls is not to be given more and more of them.
        if self._lines.empty():
            with suppress(Full):
                self._lines.put_nowait("")

    def close(self) -> None:
        """Print the lines that wait; give up after a second if the terminal hangs."""
        self._status = ""
        with suppress(Full):
            self._lines.put("", timeout=1.0)
            self._lines.put(None, timeout=1.0)
        self._thread.join(timeout=1.0)

    def _print(self) -> None:
        while (line := self._lines.get()) is not None:
            text = line
            if self._draws:
                width = get_terminal_size().columns - 1
                text = f"{ERASE}{line}{self._status[:width]}"
            try:
                print(encodable(text), end="", flush=True)
            except (OSError, ValueError):  # The terminal is gone, or closed.
                return


def encodable(text: str) -> str:
    """A text without what standard output cannot encode, such as ° in a terminal of ASCII."""
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    return text.encode(encoding, "replace").decode(encoding)


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
