"""Keys through a real pseudo-terminal, a joystick's events through a pipe."""

import io
import math
import os
import struct
import sys
import termios
from collections.abc import Iterator

import pytest

from renet.deploy import teleop
from renet.deploy.teleop import Deadman, JoystickTeleop, KeyboardTeleop, TeleopCommand
from renet.errors import RenetError


@pytest.fixture
def keyboard(terminal):
    keyboard = KeyboardTeleop(math.inf)
    yield keyboard
    keyboard.close()


@pytest.mark.parametrize(
    ("keys", "command"),
    [
        ("r", TeleopCommand(arm=True)),
        ("www", TeleopCommand(speed=0.3)),
        ("ww" + "s" * 9 + "w", TeleopCommand(speed=0.1)),
        ("w" * 50, TeleopCommand(speed=1.0)),
        ("aad?", TeleopCommand(turn=0.1)),
        ("wö€", TeleopCommand(speed=0.1)),  # A foreign letter is no key.
        ("wwwr", TeleopCommand()),  # Standing up forgets the old speed.
        ("their\n", TeleopCommand()),  # A pasted word is no wish to rise.
        ("w w", TeleopCommand(speed=0.2, stop=True)),
    ],
)
def test_keys(keyboard, terminal, keys, command):
    assert keyboard.command(0.0) == TeleopCommand()
    os.write(terminal, keys.encode())
    assert vars(keyboard.command(0.0)) == pytest.approx(vars(command))
    assert not keyboard.command(0.0).stop
    assert not keyboard.quit
    os.write(terminal, b"q")
    assert keyboard.command(0.0).stop
    assert keyboard.command(0.0).stop
    assert keyboard.quit


def test_a_held_key_arms_once(keyboard, terminal):
    armed = []
    for now in (0.0, 0.7, 1.4, 2.5):
        os.write(terminal, b"r")
        armed.append(keyboard.command(now).arm)
    assert armed == [True, False, False, True]


def test_without_any_key_it_stands_until_told_anew(keyboard, terminal):
    keyboard._deadman = Deadman(5.0)
    os.write(terminal, b"wwww")
    assert keyboard.command(0.0).speed == keyboard.command(5.0).speed == pytest.approx(0.4)
    assert keyboard.command(5.5).speed == pytest.approx(0.2)
    os.write(terminal, b"\n")
    assert keyboard.command(5.6).speed == pytest.approx(0.4), "any key is a sign of life"
    assert keyboard.command(11.7) == TeleopCommand()
    os.write(terminal, b"\n")
    assert keyboard.command(11.8) == TeleopCommand(), "it does not leap back to the old speed"


def test_a_flood_of_keys_does_not_hold_up_a_step(keyboard, terminal, monkeypatch):
    """A key held down, or a cat on the keyboard: one read a step, and the stop in it is obeyed."""
    sizes, read = [], os.read

    def flooded(descriptor: int, size: int) -> bytes:
        os.write(terminal, b"w" * 1000)  # It never ends.
        sizes.append(size)
        return read(descriptor, size)

    os.write(terminal, b"w" * 100 + b" ")
    monkeypatch.setattr(os, "read", flooded)
    assert keyboard.command(0.0).stop
    assert len(sizes) == 1


def test_the_terminal_is_given_back(terminal):
    before = termios.tcgetattr(sys.stdin)
    keyboard = KeyboardTeleop(math.inf)
    assert termios.tcgetattr(sys.stdin) != before
    keyboard.close()
    assert termios.tcgetattr(sys.stdin) == before


def test_a_lost_terminal_stops(keyboard, terminal):
    os.close(terminal)
    assert keyboard.command(0.0).stop
    assert keyboard.quit


def test_what_is_not_there_is_named(tmp_path, monkeypatch):
    for stdin in (io.StringIO(), None):
        monkeypatch.setattr(sys, "stdin", stdin)
        with pytest.raises(RenetError, match="needs a terminal"):
            KeyboardTeleop(math.inf)
    monkeypatch.setattr(teleop, "JOYSTICK", tmp_path / "js0")
    with pytest.raises(RenetError, match="no joystick at"):
        JoystickTeleop(math.inf)


class Stick(JoystickTeleop):
    """A joystick whose events are written here."""

    def __init__(self) -> None:
        super().__init__(math.inf)
        self.writer = os.open(teleop.JOYSTICK, os.O_WRONLY)

    def event(self, value: int, kind: int, number: int) -> None:
        os.write(self.writer, struct.pack("<IhBB", 0, value, kind, number))


@pytest.fixture
def stick(tmp_path, monkeypatch) -> Iterator[Stick]:
    monkeypatch.setattr(teleop, "JOYSTICK", tmp_path / "js0")
    os.mkfifo(teleop.JOYSTICK)
    stick = Stick()
    yield stick
    stick.close()


def test_sticks_and_buttons(stick):
    stick.event(-32767, 0x82, 3)
    stick.event(1, 1, 7)
    assert not stick.command(0.0).arm, "a stick that is held would turn the robot"
    stick.event(0, 2, 3)
    stick.event(1, 1, 7)
    assert stick.command(0.0) == TeleopCommand(arm=True)
    stick.event(-32767, 2, 1)
    stick.event(-16384, 2, 3)
    ahead = stick.command(0.1)
    assert (ahead.speed, ahead.turn) == (1.0, pytest.approx(0.05, abs=1e-4))
    assert stick.command(100.0).turn == pytest.approx(0.1, abs=1e-4), "no far turn after a pause"
    stick.event(32767, 2, 1)
    stick.event(1000, 2, 3)
    back = stick.command(100.1)
    assert back.speed == 0.0, "it walks forwards only"
    assert back.turn == pytest.approx(0.1, abs=1e-4), "small deflections are none"
    stick.event(1, 1, 0)
    assert stick.command(100.2).stop
    assert not stick.command(100.3).stop


def test_a_joystick_out_of_range_stands(stick):
    stick._deadman = Deadman(0.5)
    stick.event(-32767, 2, 1)
    stick.event(-32767, 2, 3)
    assert stick.command(0.0).speed == stick.command(0.5).speed == 1.0
    assert stick.command(1.0).speed == pytest.approx(0.5)
    gone = stick.command(2.0)
    assert gone.speed == 0.0
    assert stick.command(3.0).turn == gone.turn
    stick.event(-29000, 2, 1)
    assert stick.command(3.1).speed == pytest.approx(0.885, abs=1e-3)


def test_an_unplugged_joystick_stops(stick):
    assert not stick.command(0.0).stop
    os.close(stick.writer)
    assert stick.command(0.1).stop


@pytest.mark.parametrize("amplitude", [1, 655, 1300])
def test_a_stick_that_only_trembles_is_nobody(stick, amplitude):
    """Nor is a trigger that moves, or a kernel that repeats where everything is."""
    stick._deadman = Deadman(5.0)
    stick.event(-16000, 2, 1)
    assert stick.command(0.0).speed > 0.4
    for step in range(1, 60 * 50):
        stick.event(-16000 + amplitude * (1 if step % 2 else -1), 2, 1)
        stick.event(32767 * (step % 2), 2, 5)
        stick.event(step % 2, 0x81, 3)
        command = stick.command(0.02 * step)
    assert command.speed == 0.0
    stick.event(-21000, 2, 1)
    assert stick.command(60.0).speed > 0.6


def test_a_stop_that_the_kernel_repeats_stops_and_a_start_does_not_arm(stick):
    """What was pressed while its queue ran over comes as an initial event."""
    stick.event(1, 0x81, 7)
    assert not stick.command(0.0).arm
    stick.event(1, 0x81, 0)
    assert stick.command(0.02).stop
