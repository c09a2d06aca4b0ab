"""Progress bars, tables, and lines printed by a thread, so that a terminal cannot stall a robot."""

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

_Step = TypeVar("_Step")
MAX_WAITING = 1000
"""Largest number of lines that wait for a stalled terminal; later ones are dropped."""
ERASE = "\r\x1b[K"
"""Escape sequence that clears the current line."""


class Terminal:
    """Printer of lines on a thread, with a line of status below them.

    `logging.handlers.QueueListener` would do the same, but its `stop` waits for a hung terminal.
    """

    def __init__(self) -> None:
        self._lines: Queue[str | None] = Queue(MAX_WAITING)
        self._status = ""
        # In a file or a pipe, a status that is redrawn all the time would be noise.
        self._draws = sys.stdout is not None and sys.stdout.isatty()
        self._thread = threading.Thread(target=self._print, daemon=True)
        self._thread.start()

    def say(self, line: str) -> None:
        """Print a line as soon as the terminal takes it."""
        with suppress(Full):
            self._lines.put_nowait(f"{printable(line)}\n")

    def status(self, line: str) -> None:
        """Replace the line of status, which only a terminal shows."""
        if not self._draws:
            return
        self._status = printable(line)
        # An empty line redraws the status. A stalled terminal gets no more of them.
        if self._lines.empty():
            with suppress(Full):
                self._lines.put_nowait("")

    def close(self) -> None:
        """Print all waiting lines, and stop; gives up after a second if the terminal hangs."""
        self._status = ""
        with suppress(Full):
            self._lines.put("", timeout=1.0)
            self._lines.put(None, timeout=1.0)
        self._thread.join(timeout=1.0)

    def _print(self) -> None:
        """Print lines until `close` ends the thread."""
        while (line := self._lines.get()) is not None:
            text = line
            if self._draws:
                width = get_terminal_size().columns - 1
                text = f"{ERASE}{line}{self._status[:width]}"
            try:
                print(encodable(text), end="", flush=True)
            except (OSError, ValueError):
                # The terminal is gone, or standard output is closed.
                return


def encodable(text: str) -> str:
    """Replace characters that standard output cannot encode, such as ° in a terminal of ASCII."""
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    return text.encode(encoding, "replace").decode(encoding)


def show(title: str, header: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    """Print a table on standard output, with a title and a header above its rows."""
    # Without markup, because cells may hold a stranger's texts.
    table = Table(*header, title=printable(title), title_justify="left", title_style="bold")
    for row in rows:
        table.add_row(*(printable(str(cell)) for cell in row))
    Console(markup=False, emoji=False).print(table)


Listener = Callable[[str, int, int], None]
"""Function of a title, the number of steps done, and the number of all steps."""
_listener: Listener | None = None


def tell_progress(listener: Listener) -> None:
    """Make `progress` call a listener from now on, instead of showing bars."""
    global _listener
    _listener = listener


def progress(steps: Sequence[_Step], title: str) -> Iterable[_Step]:
    """Iterate over steps, with a bar on standard error that shows the time left."""
    if _listener is not None:
        return _told(steps, title, _listener)
    return track(steps, f"{title:<24}", console=Console(stderr=True))


def _told(steps: Sequence[_Step], title: str, listener: Listener) -> Iterator[_Step]:
    """Iterate over steps, and call a listener before each."""
    for done, step in enumerate(steps):
        listener(title, done, len(steps))
        yield step
