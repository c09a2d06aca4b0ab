"""Keys through a real pseudo-terminal."""

import io
import math
import os
import re
import sys
import termios

import pytest

from renet.deploy.teleop.base import Deadman, TeleopCommand
from renet.deploy.teleop.keyboard import ARM_KEY, KEYS, STAND_KEY, KeyboardTeleop
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
        ("www", TeleopCommand(forward=0.3)),
        ("wss", TeleopCommand(forward=-0.1)),
        ("www" + "sss", TeleopCommand()),  # Exactly zero: nobody arms a robot that creeps.
        ("w" * 50, TeleopCommand(forward=1.0)),
        ("s" * 50 + "w", TeleopCommand(forward=-0.5)),
        ("aad?", TeleopCommand(turn_rate=0.2)),
        ("d" * 50, TeleopCommand(turn_rate=-1.0)),
        ("jjl", TeleopCommand(left=0.1)),
        ("l" * 50, TeleopCommand(left=-0.5)),
        ("wajx", TeleopCommand()),
        ("wö€", TeleopCommand(forward=0.1)),  # A foreign letter is no key.
        ("wwwr", TeleopCommand()),  # Standing up forgets the old speed.
        ("their\n", TeleopCommand()),  # A pasted word is no wish to rise.
        ("w w", TeleopCommand(forward=0.2, stop=True)),
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


def test_every_key_is_named_and_means_one_thing(keyboard):
    keys = [*KEYS, STAND_KEY, ARM_KEY, "q", " "]
    assert len(set(keys)) == len(keys)
    for key in keys:
        word = rf"\b{key}\b" if key != " " else "space"
        assert re.search(word, keyboard.controls)
        # A policy that only walks ahead has no keys for going sideways.
        assert bool(re.search(word, keyboard.controls_ahead)) == (key not in ("j", "l"))


def test_a_held_key_arms_once(keyboard, terminal):
    armed = []
    for now in (0.0, 0.7, 1.4, 2.5):
        os.write(terminal, b"r")
        armed.append(keyboard.command(now).arm)
    assert armed == [True, False, False, True]


def test_without_any_key_it_stands_until_told_anew(keyboard, terminal):
    keyboard._deadman = Deadman(5.0)
    os.write(terminal, b"wwww")
    assert keyboard.command(0.0).forward == keyboard.command(5.0).forward == pytest.approx(0.4)
    assert keyboard.command(5.5).forward == pytest.approx(0.2)
    os.write(terminal, b"\n")
    assert keyboard.command(5.6).forward == pytest.approx(0.4), "any key is a sign of life"
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


def test_a_program_without_a_terminal_is_told(monkeypatch):
    for stdin in (io.StringIO(), None):
        monkeypatch.setattr(sys, "stdin", stdin)
        with pytest.raises(RenetError, match="keys need a terminal"):
            KeyboardTeleop(math.inf)


def test_keys_before_a_run_are_forgotten(keyboard, terminal):
    os.write(terminal, b"r")
    keyboard.drain(0.0)
    assert keyboard.command(0.0) == TeleopCommand()
