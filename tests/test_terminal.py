"""Lines and a status on a real pseudo-terminal, tables, and where letters are missing."""

import io
import os
import pty
import sys

import pytest

from renet.terminal import ERASE, Terminal, show

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


def test_cells_wrap_between_words_in_as_few_lines_as_possible(capsys, monkeypatch):
    _, _, *rows = shown(capsys, monkeypatch, 60)
    assert rows[0] == ["1", "go1-parkour", "camera", "0.5", "10.5 to 80.5"]
    assert rows[1] == ["2", "go1-parkour", "oracle,", "0.5", "10.0 to 81.0"]
    assert rows[2] == ["", "", "handing over", "", ""]
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
