"""Lines and a status on a real pseudo-terminal, in a file, and where letters are missing."""

import io
import os
import pty
import sys

import pytest

from renet.terminal import ERASE, Terminal

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
