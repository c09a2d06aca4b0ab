"""Keys through a real pseudo-terminal, a joystick's events through a pipe."""

from __future__ import annotations

import io
import os
import pty
import struct
import termios

import pytest

from renet.deploy.consoles import Deadman, JoystickOperator, KeyboardOperator
from renet.deploy.operator import Request
from renet.errors import RenetError


@pytest.fixture
def terminal():
    master, slave = pty.openpty()
    with os.fdopen(slave) as stream:
        yield master, stream


def test_keys(terminal):
    master, stream = terminal
    keyboard = KeyboardOperator(stream)
    assert keyboard.request(0.0) == Request()
    os.write(master, b"r")
    assert keyboard.request(0.0) == Request(arm=True)
    os.write(master, b"wwwsaad?")
    request = keyboard.request(0.0)
    assert (request.speed, request.turn) == (pytest.approx(0.2), pytest.approx(0.1))
    os.write(master, b"w" * 50)
    assert keyboard.request(0.0).speed == 1.0
    os.write(master, b" ")
    assert keyboard.request(0.0).stop
    assert not keyboard.request(0.0).stop
    assert not keyboard.quit
    os.write(master, b"q")
    assert keyboard.request(0.0).stop
    assert keyboard.request(0.0).stop
    assert keyboard.quit


def test_a_foreign_letter_is_no_key(terminal):
    master, stream = terminal
    keyboard = KeyboardOperator(stream)
    os.write(master, "wö€".encode())
    assert keyboard.request(0.0) == Request(speed=0.1)
    assert not keyboard.quit


def test_without_any_key_it_stands_until_told_anew(terminal):
    master, stream = terminal
    keyboard = KeyboardOperator(stream, deadman=5.0)
    os.write(master, b"wwww")
    assert keyboard.request(0.0).speed == keyboard.request(5.0).speed == pytest.approx(0.4)
    assert keyboard.request(5.5).speed == pytest.approx(0.2)
    os.write(master, b"\n")
    assert keyboard.request(5.6).speed == pytest.approx(0.4), "any key is a sign of life"
    assert keyboard.request(11.7) == Request()
    os.write(master, b"\n")
    assert keyboard.request(11.8) == Request(), "it does not leap back to the old speed"


def test_arming_again_forgets_the_old_speed(terminal):
    master, stream = terminal
    keyboard = KeyboardOperator(stream)
    os.write(master, b"wwwr")
    assert keyboard.request(0.0) == Request(arm=True)


def test_the_terminal_is_given_back(terminal):
    _, stream = terminal
    before = termios.tcgetattr(stream)
    keyboard = KeyboardOperator(stream)
    assert termios.tcgetattr(stream) != before
    keyboard.close()
    assert termios.tcgetattr(stream) == before


def test_a_lost_terminal_stops():
    master, slave = pty.openpty()
    keyboard = KeyboardOperator(os.fdopen(slave))
    os.close(master)
    assert keyboard.request(0.0).stop
    assert keyboard.quit
    keyboard.close()


def test_no_terminal():
    with pytest.raises(RenetError, match="needs a terminal"):
        KeyboardOperator(io.StringIO())


@pytest.fixture
def stick(tmp_path):
    """A joystick and what writes its events: (value, kind, number)."""
    path = tmp_path / "js0"
    os.mkfifo(path)
    joystick = JoystickOperator(path)
    writer = os.open(path, os.O_WRONLY)

    def event(value: int, kind: int, number: int) -> None:
        os.write(writer, struct.pack("<IhBB", 0, value, kind, number))

    yield joystick, event, writer
    joystick.close()


def test_sticks_and_buttons(stick):
    joystick, event, _ = stick
    event(0, 0x82, 1)
    event(1, 1, 7)
    assert joystick.request(0.0) == Request(arm=True)
    event(-32767, 2, 1)
    event(-16384, 2, 3)
    request = joystick.request(0.1)
    assert (request.speed, request.turn) == (1.0, pytest.approx(0.05, abs=1e-4))
    assert joystick.request(0.2).turn == pytest.approx(0.1, abs=1e-4)
    event(32767, 2, 1)
    event(1000, 2, 3)
    request = joystick.request(0.3)
    assert request.speed == 0.0, "it walks forwards only"
    assert request.turn == pytest.approx(0.1, abs=1e-4), "small deflections are none"
    event(1, 1, 0)
    assert joystick.request(0.4).stop
    assert not joystick.request(0.5).stop


def test_a_long_pause_does_not_turn_the_robot_far(stick):
    joystick, event, _ = stick
    event(-32767, 2, 3)
    joystick.request(0.0)
    assert joystick.request(100.0).turn == pytest.approx(0.1)


def test_a_joystick_out_of_range_stands(stick):
    joystick, event, _ = stick
    joystick._deadman = Deadman(0.5)
    event(-32767, 2, 1)
    event(-32767, 2, 3)
    assert joystick.request(0.0).speed == joystick.request(0.5).speed == 1.0
    assert joystick.request(1.0).speed == pytest.approx(0.5)
    gone = joystick.request(2.0)
    assert gone.speed == 0.0
    assert joystick.request(3.0).turn == gone.turn
    event(-32000, 2, 1)
    assert joystick.request(3.1).speed == pytest.approx(0.977, abs=1e-3)


def test_an_unplugged_joystick_stops(stick):
    joystick, _, writer = stick
    assert not joystick.request(0.0).stop
    os.close(writer)
    assert joystick.request(0.1).stop


def test_no_joystick(tmp_path):
    with pytest.raises(RenetError, match="no joystick at"):
        JoystickOperator(tmp_path / "js0")
