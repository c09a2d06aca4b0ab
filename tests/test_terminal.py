"""Lines and a status on a real pseudo-terminal, tables, and where letters are missing.

Progress in a file is timed by a clock that is made up.
"""

import io
import os
import pty
import sys

import pytest

from renet import terminal
from renet.terminal import ERASE, Terminal, show
from tests.clock import Clock

pytestmark = pytest.mark.wall_clock


class Screen:
    """A program's terminal."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self._ours, theirs = pty.openpty()
        self._stream = os.fdopen(theirs, "w", encoding="utf-8")
        # In the test itself: pytest puts its own stream back after fixtures.
        monkeypatch.setattr(sys, "stdout", self._stream)

    def read(self) -> str:
        """All that it was sent; it ends here."""
        self._stream.write("end")
        self._stream.flush()
        # A busy system hands it over in pieces.
        sent = b""
        while not sent.endswith(b"end"):
            sent += os.read(self._ours, 100_000)
        self._stream.close()
        os.close(self._ours)
        return sent.decode().replace("\r\n", "\n").removesuffix("end")


def drawn(text: str) -> list[str]:
    """Lines that a reader sees at the end."""
    return [line.split(ERASE)[-1] for line in text.split("\n")]


def test_a_status_stays_below_the_lines(monkeypatch):
    screen = Screen(monkeypatch)
    terminal = Terminal()
    for number in range(3):
        terminal.status(f"status {number}")
        terminal.say(f"line {number}")
    terminal._lines.put(None)
    terminal._thread.join()
    assert drawn(screen.read()) == ["line 0", "line 1", "line 2", "status 2"]


def test_a_status_is_gone_at_the_end(monkeypatch):
    screen = Screen(monkeypatch)
    terminal = Terminal()
    terminal.status("status")
    terminal.say("line")
    terminal.close()
    assert drawn(screen.read()) == ["line", ""]


def test_a_status_is_cut_at_the_edge(monkeypatch):
    """One that wraps could not be erased."""
    screen = Screen(monkeypatch)
    monkeypatch.setenv("COLUMNS", "20")
    terminal = Terminal()
    terminal.status("x" * 100)
    terminal._lines.put(None)
    terminal._thread.join()
    assert drawn(screen.read()) == ["x" * 19]


def test_a_file_holds_the_lines_alone(capsys):
    terminal = Terminal()
    terminal.status("status")
    terminal.say("line")
    terminal.close()
    assert capsys.readouterr().out == "line\n"


def test_a_letter_that_a_terminal_lacks_ends_nothing(monkeypatch):
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", stream)
    terminal = Terminal()
    terminal.say("a motor has more than 65 °C")
    terminal.say("sees → blind")
    terminal.close()
    assert stream.buffer.getvalue() == b"a motor has more than 65 ?C\nsees ? blind\n"  # type: ignore[attr-defined]


@pytest.fixture
def clock(monkeypatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(terminal, "time", clock)
    monkeypatch.setattr(terminal, "_line_time", clock.now)
    return clock


def walk(clock: Clock, title: str, steps: int, seconds: float) -> None:
    """Take steps of some seconds each."""
    for _ in terminal.progress(range(steps), title):
        clock.now += seconds


def test_a_file_gets_a_line_of_progress_a_minute(clock, capsys):
    walk(clock, "stairs", 26, 5.0)
    assert capsys.readouterr().err.splitlines() == [
        "stairs  12/26  0:01:10 left",
        "stairs  24/26  0:00:10 left",
    ]


def test_short_walks_share_the_minute(clock, capsys):
    for ground in ("flat", "stairs", "gap"):
        walk(clock, ground, 5, 5.0)
    assert capsys.readouterr().err == "gap  2/5  0:00:15 left\n"


def test_a_run_is_timed_over_all_parts(clock, capsys):
    log = terminal.ProgressLog(4)
    for name, parts in (("a", 1), ("bc", 2), ("d", 1)):
        with log.making(parts):
            walk(clock, name, 4, 15.0 * parts)
    assert capsys.readouterr().err.splitlines() == [
        "parts 1/4  bc  0/4  0:03:00 left",
        "parts 1/4  bc  2/4  0:02:00 left",
        "parts 3/4  d  0/4  0:01:00 left",
    ]
    assert terminal._listener is None


def test_jobs_share_a_log(clock, capsys):
    log = terminal.ProgressLog(4)
    clock.now += 60.0
    log.tell("a", 0, 2, job=1)
    log.finish(1, job=1)
    log.tell("b", 1, 2, job=1)
    clock.now += 60.0
    log.tell("c", 1, 2, job=2)
    assert capsys.readouterr().err.splitlines() == [
        "parts 0/4  a  0/2  -:--:-- left",
        "parts 1/4  c  1/2  0:02:00 left",
    ]


def test_a_terminal_gets_a_bar_and_no_lines(clock, capsys, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    with terminal.ProgressLog(2).making(1):
        walk(clock, "stairs", 3, 60.0)
    shown = capsys.readouterr().err
    assert "100%" in shown
    assert "left" not in shown


def test_a_terminal_that_cannot_draw_a_bar_gets_lines(clock, capsys, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "dumb")
    walk(clock, "stairs", 26, 5.0)
    assert capsys.readouterr().err.splitlines() == [
        "stairs  12/26  0:01:10 left",
        "stairs  24/26  0:00:10 left",
    ]


HEADER = ("", "policy", "entry", "robot", "share", "its interval", "over")
ROWS = [
    (1, "go1-parkour", "camera", "Unitree Go1", 0.5, "10.5 to 80.5", "episodes"),
    (2, "go1-parkour", "oracle, handing over", "Unitree Go1", 0.5, "10.0 to 81.0", "episodes"),
    (3, "playground", "blind", "Unitree Go1", 0.5, "0.5 to 12.0", "episodes"),
]


def shown(capsys, monkeypatch, width: int, rows=ROWS) -> list[list[str]]:
    """Cells of each line of a table in a terminal of a width, below the title."""
    monkeypatch.setenv("COLUMNS", str(width))
    show("title", HEADER, rows)
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= width
    assert lines[0].strip() == "title"
    cells = [line.replace("┃", "│").strip("│").split("│") for line in lines[1:]]
    return [[cell.strip() for cell in line] for line in cells if "━" not in line[0]]


def test_a_wide_terminal_shows_a_row_on_a_line(capsys, monkeypatch):
    header, *rows = shown(capsys, monkeypatch, 120)
    assert tuple(header) == HEADER
    assert rows[:3] == [list(map(str, row)) for row in ROWS]


def test_words_that_every_row_repeats_give_way_first(capsys, monkeypatch):
    told, header, *rows = shown(capsys, monkeypatch, 80)
    assert told == ["robot: Unitree Go1; over: episodes"]
    # The shares are alike, too, but numbers stay.
    assert header == ["", "policy", "entry", "share", "its interval"]
    assert rows[1] == ["2", "go1-parkour", "oracle, handing over", "0.5", "10.0 to 81.0"]


def test_the_widest_cells_wrap_between_words(capsys, monkeypatch):
    _, _, *rows = shown(capsys, monkeypatch, 60)
    assert rows[0] == ["1", "go1-parkour", "camera", "0.5", "10.5 to 80.5"]
    assert rows[1] == ["2", "go1-parkour", "oracle, handing", "0.5", "10.0 to 81.0"]
    assert rows[2] == ["", "", "over", "", ""]
    assert rows[3][1:3] == ["playground", "blind"]


@pytest.mark.parametrize("width", [20, 30, 45, 52])
def test_nothing_is_lost_in_a_narrow_terminal(width, capsys, monkeypatch):
    _, *lines = shown(capsys, monkeypatch, width)
    lines = [line for line in lines if len(line) == 5]
    columns = ["".join(cells).replace(" ", "") for cells in zip(*lines, strict=True)]
    assert columns[1].startswith("policygo1-parkourgo1-parkourplayground")
    assert columns[2].startswith("entrycameraoracle,handingoverblind")
    assert columns[4].startswith("itsinterval10.5to80.510.0to81.00.5to12.0")


def test_one_row_keeps_all_its_columns(capsys, monkeypatch):
    header, *_ = shown(capsys, monkeypatch, 80, ROWS[:1])
    assert len(header) == len(HEADER)
