"""Progress bars, tables, and lines printed by a thread, so that a terminal cannot stall a robot."""

import math
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import timedelta
from functools import partial
from itertools import zip_longest
from queue import Full, Queue
from shutil import get_terminal_size
from typing import Any, TextIO, TypeVar

from rich.cells import cell_len
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


class LastingOutput:
    """Text file that drops what it cannot write, as when a terminal or a pipe's reader is gone.

    With `renet train | tee LOG`, Ctrl-C ends `tee` first.
    """

    def __init__(self, file: TextIO) -> None:
        self._file = file

    def write(self, text: str) -> int:
        """Write a text, if the file takes it, and return its length."""
        with suppress(OSError):
            self._file.write(text)
        return len(text)

    def flush(self) -> None:
        """Write what is buffered, if the file takes it."""
        with suppress(OSError):
            self._file.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


def encodable(text: str) -> str:
    """Replace characters that standard output cannot encode, such as ° in a terminal of ASCII."""
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    return text.encode(encoding, "replace").decode(encoding)


def show(title: str, header: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    """Print a table on standard output, with a title and a header above its rows.

    In a terminal that is too narrow for it, columns that say the same in every row are told once,
    below the title, and the other columns' cells wrap between words.
    """
    # Without markup, because cells may hold a stranger's texts.
    console = Console(markup=False, emoji=False)
    title = printable(title)
    columns = []
    for cells in zip_longest(header, *rows, fillvalue=""):
        columns.append([printable(str(cell)) for cell in cells])
    widths: list[int] = []
    framed = True
    if _table_width(list(map(_natural_width, columns))) > console.width:
        columns, repeated = _split_repeated(columns)
        title = "\n".join(filter(None, (title, repeated)))
        # Without its outer frame, a table has more room for words.
        framed = _table_width(list(map(_longest_word, columns))) <= console.width
        widths = _shared_widths(columns, console.width - _table_width([0] * len(columns), framed))
    table = Table(
        title=title,
        title_justify="left",
        title_style="bold",
        show_edge=framed,
        pad_edge=framed,
    )
    for name, width in zip_longest((cells[0] for cells in columns), widths):
        # A word that is longer than its column goes on in the next line.
        table.add_column(name, width=width, overflow="fold")
    for row in zip(*(cells[1:] for cells in columns), strict=True):
        table.add_row(*row)
    console.print(table)


def _natural_width(cells: Sequence[str]) -> int:
    """Width of a column whose cells do not wrap, characters."""
    return max(map(cell_len, cells))


def _longest_word(cells: Sequence[str]) -> int:
    """Width of the longest word of a column, characters."""
    words = " ".join(cells).split()
    return max(map(cell_len, words), default=1)


def _table_width(widths: Sequence[int], framed: bool = True) -> int:
    """Width of a table with columns of these widths, characters."""
    # A line and a space on either side separate two columns; the frame has the outer ones.
    return sum(widths) + 3 * (len(widths) - 1) + 4 * framed


def _split_repeated(columns: Sequence[list[str]]) -> tuple[list[list[str]], str]:
    """Columns whose cells differ from row to row, and what the others say, in words.

    The first column, which names the rows, and columns of numbers stay.
    """
    kept = []
    repeated = []
    for column in columns:
        name, *cells = column
        words = len(cells) > 1 and cells[0][:1].isalpha()
        if kept and words and len(set(cells)) == 1:
            repeated.append(f"{name}: {cells[0]}")
        else:
            kept.append(column)
    return kept, "; ".join(repeated)


def _shared_widths(columns: Sequence[Sequence[str]], room: int) -> list[int]:
    """Widths of columns that have some room together, characters.

    The widest columns give way first. Words are kept whole where that is possible.
    """
    widths = list(map(_natural_width, columns))
    least = list(map(_longest_word, columns))
    if sum(least) > room:
        # The longest words are broken.
        least = [1] * len(columns)
    while sum(widths) > max(room, sum(least)):
        wider = [place for place, width in enumerate(widths) if width > least[place]]
        widths[max(wider, key=widths.__getitem__)] -= 1
    return widths


Listener = Callable[[str, int, int], None]
"""Function of a title, the number of steps done, and the number of all steps."""
_listener: Listener | None = None
LINE_EVERY = 60.0
"""Time between two lines of progress where standard error is no terminal, s."""
_line_time = time.monotonic()
"""Time of the latest line of progress, or of the program's start, s."""


def tell_progress(listener: Listener) -> None:
    """Make `progress` call a listener from now on, instead of showing bars."""
    global _listener
    _listener = listener


def progress(steps: Sequence[_Step], title: str) -> Iterable[_Step]:
    """Iterate over steps, and show on standard error how many are done and the time left.

    A terminal shows a bar; a file, a pipe or a terminal that cannot draw one gets a line a minute.
    """
    if _listener is not None:
        return _told(steps, title, _listener)
    if shows_bars():
        return track(steps, f"{title:<24}", console=Console(stderr=True))
    return _told(steps, title, ProgressLog().tell)


def shows_bars() -> bool:
    """Return True if standard error is a notebook, or a terminal that can redraw a bar.

    One of Emacs, TERM=dumb, cannot.
    """
    console = Console(stderr=True)
    return console.is_interactive or console.is_jupyter


def _told(steps: Sequence[_Step], title: str, listener: Listener) -> Iterator[_Step]:
    """Iterate over steps, and call a listener before each."""
    for done, step in enumerate(steps):
        listener(title, done, len(steps))
        yield step


class ProgressLog:
    """Lines on standard error about the parts of a run, at most one a minute in the program.

    They are for files and pipes, where a bar that is redrawn all the time would be noise.
    """

    def __init__(self, parts: int = 1) -> None:
        """Initialize the log when the run begins.

        Args:
            parts: Number of the run's parts, each of which has steps. Only several are counted in
                the lines.
        """
        self._parts = parts
        self._finished = 0
        # Work of each job since it finished its latest parts, in parts.
        self._under_way: dict[int, float] = {}
        self._start = time.monotonic()

    def tell(self, title: str, done: int, total: int, job: int = 0, parts: int = 1) -> None:
        """Print a line if the latest is a minute old.

        Args:
            title: Title of the parts that are being made.
            done: Number of their steps that are done.
            total: Number of all their steps.
            job: Number of the process that makes them.
            parts: Number of parts that these steps make.
        """
        global _line_time
        self._under_way[job] = parts * done / total
        now = time.monotonic()
        if now - _line_time < LINE_EVERY:
            return
        _line_time = now
        facts = [title, f"{done}/{total}", f"{time_text(self._time_left(now))} left"]
        if self._parts > 1:
            facts.insert(0, f"parts {self._finished}/{self._parts}")
        print(printable("  ".join(facts)), file=sys.stderr)

    def finish(self, parts: int, job: int = 0) -> None:
        """Count parts that a job has made."""
        self._finished += parts
        self._under_way[job] = 0.0

    @contextmanager
    def making(self, parts: int) -> Iterator[None]:
        """Tell of all progress within the block, which makes some parts in this process.

        On a terminal the block shows its bars.
        """
        global _listener
        before = _listener
        if before is None and not shows_bars():
            _listener = partial(self.tell, parts=parts)
        try:
            yield
        finally:
            _listener = before
        self.finish(parts)

    def _time_left(self, now: float) -> float:
        """Estimate the time until all parts are made, s; infinity while nothing is done."""
        done = self._finished + sum(self._under_way.values())
        if done == 0.0:
            return math.inf
        return (now - self._start) * (self._parts - done) / done


def time_text(seconds: float) -> str:
    """Format a duration as hours, minutes and seconds; dashes if it is unknown, infinity."""
    # A timedelta holds at most nine digits of days.
    if seconds >= 1e9:
        return "-:--:--"
    return str(timedelta(seconds=math.ceil(seconds)))
