"""Pads of two makers, whose numbers differ, by the kernel's names; requests by its own headers.

Events come through a pipe.
"""

import math
import shutil
import subprocess
from pathlib import Path

import pytest

from renet.deploy.teleop import gamepad
from renet.deploy.teleop.base import Deadman, TeleopCommand
from renet.deploy.teleop.gamepad import Gamepad, GamepadTeleop
from renet.errors import RenetError

from .pads import CODES, PLAYSTATION, UNNAMED, XBOX, Pad, plugged

pytestmark = pytest.mark.wall_clock

NAMES = ("ABS_X", "ABS_Y", "ABS_RX", "BTN_START", "BTN_SOUTH", "BTN_EAST")
PROGRAM = """
#include <stdio.h>
#include <linux/joystick.h>
int main(void) {
    printf("%u %u %u %u %u %zu\\n", (unsigned)JSIOCGAXES, (unsigned)JSIOCGBUTTONS,
        (unsigned)JSIOCGNAME(128), (unsigned)JSIOCGAXMAP, (unsigned)JSIOCGBTNMAP,
        sizeof(struct js_event));
}
"""


@pytest.mark.parametrize(("kind", "number"), [(XBOX, 7), (PLAYSTATION, 9)])
def test_a_button_is_known_by_its_name_whatever_its_number(tmp_path, monkeypatch, kind, number):
    pad = plugged(tmp_path, monkeypatch, kind)
    assert pad.buttons.index("BTN_START") == number
    found = Gamepad.find(NAMES)
    for button in ("BTN_START", "BTN_SOUTH", "BTN_EAST"):
        pad.press(button)
        assert [(event.name, event.value) for event in found.events()] == [(button, 1.0)]
    pad.press("BTN_TR")
    pad.move("ABS_RX", -32767)
    assert [(event.name, event.value) for event in found.events()] == [("", 1), ("ABS_RX", -1.0)]
    assert list(found.events()) == []
    found.close()


def test_the_first_pad_that_can_steer_is_taken(tmp_path, monkeypatch):
    plugged(tmp_path, monkeypatch, UNNAMED, XBOX)
    pad = Gamepad.find(NAMES)
    assert pad.title == XBOX[0]
    pad.close()


def test_a_pad_without_names_is_refused_in_one_line(tmp_path, monkeypatch):
    plugged(tmp_path, monkeypatch, UNNAMED)
    missing = "ABS_RX, BTN_START, BTN_SOUTH, BTN_EAST"
    with pytest.raises(RenetError, match=rf"js0 \(Old USB stick\) has no {missing}: take a pad"):
        Gamepad.find(NAMES)


def test_what_is_no_pad_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(gamepad, "DEVICES", str(tmp_path / "js*"))
    with pytest.raises(RenetError, match=r"no gamepad at .*js\*: connect one"):
        Gamepad.find(NAMES)
    (tmp_path / "js0").write_text("")
    with pytest.raises(RenetError, match=r"cannot read the gamepad .*js0: Inappropriate ioctl"):
        Gamepad.find(NAMES)


@pytest.mark.skipif(not shutil.which("cc"), reason="needs a C compiler")
def test_requests_are_those_of_the_kernels_header(tmp_path):
    (tmp_path / "requests.c").write_text(PROGRAM)
    program = tmp_path / "requests"
    compiled = subprocess.run(["cc", "-o", program, tmp_path / "requests.c"], check=False)
    if compiled.returncode:
        pytest.skip("needs the kernel's headers")
    printed = subprocess.run([program], capture_output=True, text=True, check=True).stdout
    maps = gamepad.AXIS_MAP, gamepad.BUTTON_MAP
    ours = gamepad.AXIS_COUNT, gamepad.BUTTON_COUNT, gamepad.PAD_NAME, *maps, gamepad.EVENT.size
    assert tuple(map(int, printed.split())) == ours


HEADER = Path("/usr/include/linux/input-event-codes.h")


@pytest.mark.skipif(not HEADER.exists(), reason="needs the kernel's headers")
def test_codes_are_those_of_the_kernels_header():
    defined = {}
    for line in HEADER.read_text().splitlines():
        match line.split():
            case ["#define", name, number, *_] if number[0].isdigit():
                defined[name] = int(number, 0)
    ours = {name: code for code, name in (gamepad.STICK_NAMES | gamepad.BUTTON_NAMES).items()}
    assert ours == {name: defined[name] for name in ours}
    same = {name: code for name, code in CODES.items() if name in defined}
    assert same == {name: defined[name] for name in same}


@pytest.fixture
def pad(tmp_path, monkeypatch) -> Pad:
    return plugged(tmp_path, monkeypatch, XBOX)


@pytest.fixture
def stick(pad) -> GamepadTeleop:
    """An operator with a gamepad."""
    return GamepadTeleop(math.inf)


def test_sticks_and_buttons(stick, pad):
    pad.press("BTN_START")
    assert stick.command(0.0) == TeleopCommand(arm=True)
    pad.move("ABS_Y", -32767)
    pad.move("ABS_X", 16384)
    pad.move("ABS_RX", -16384)
    ahead = stick.command(0.1)
    assert (ahead.forward, ahead.left) == (1.0, pytest.approx(-0.25, abs=1e-4))
    assert ahead.turn_rate == pytest.approx(0.5, abs=1e-4)
    pad.move("ABS_Y", 32767)
    pad.move("ABS_X", -1000)
    pad.move("ABS_RX", 1000)
    assert stick.command(0.2) == TeleopCommand(forward=-0.6), "small deflections are none"
    pad.move("ABS_RY", 32767)
    pad.press("BTN_TL")
    assert stick.command(0.3) == TeleopCommand(forward=-0.6), "nor are other sticks and buttons"
    for button in ("BTN_SOUTH", "BTN_EAST"):
        pad.press(button)
        assert stick.command(0.4).stop
        assert not stick.command(0.5).stop


def test_a_pad_out_of_range_stands(stick, pad):
    stick._deadman = Deadman(0.5)
    pad.move("ABS_Y", -32767)
    pad.move("ABS_RX", -32767)
    assert stick.command(0.0).forward == stick.command(0.5).forward == 1.0
    half = stick.command(1.0)
    assert (half.forward, half.turn_rate) == (pytest.approx(0.5), pytest.approx(0.5))
    assert stick.command(2.0) == TeleopCommand()
    pad.move("ABS_Y", -29000)
    assert stick.command(3.1).forward == pytest.approx(0.885, abs=1e-3)


def test_an_unplugged_pad_stops_and_the_operator_is_told(stick, pad):
    assert not stick.command(0.0).stop
    assert stick.problem == ""
    pad.unplug()
    assert stick.command(0.1).stop
    assert stick.problem == "the gamepad is gone: connect it, and start renet again"


@pytest.mark.parametrize("amplitude", [1, 655, 1300])
def test_a_stick_that_only_trembles_is_nobody(stick, pad, amplitude):
    """Nor is a trigger that moves, or a kernel that repeats where everything is."""
    stick._deadman = Deadman(5.0)
    pad.move("ABS_Y", -16000)
    assert stick.command(0.0).forward > 0.4
    for step in range(1, 60 * 50):
        pad.move("ABS_Y", -16000 + amplitude * (1 if step % 2 else -1))
        pad.move("ABS_RZ", 32767 * (step % 2))
        pad.press("BTN_WEST", step % 2, repeated=True)
        command = stick.command(0.02 * step)
    assert command.forward == 0.0
    pad.move("ABS_Y", -21000)
    assert stick.command(60.0).forward > 0.6


def test_a_stop_that_the_kernel_repeats_stops_and_a_start_does_not_arm(stick, pad):
    """What was pressed while its queue ran over comes as an initial event."""
    pad.press("BTN_START", repeated=True)
    assert not stick.command(0.0).arm
    pad.press("BTN_SOUTH", repeated=True)
    assert stick.command(0.02).stop


def test_buttons_before_a_run_are_forgotten_but_not_where_the_sticks_are(stick, pad):
    pad.press("BTN_START")
    pad.move("ABS_Y", -32767)
    stick.drain(0.0)
    assert stick.command(0.0) == TeleopCommand(forward=1.0)
