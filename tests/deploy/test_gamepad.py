"""Pads of two makers, whose numbers differ, by the kernel's names; requests by its own headers."""

import shutil
import subprocess
from pathlib import Path

import pytest

from renet.deploy import gamepad
from renet.deploy.gamepad import Gamepad
from renet.errors import RenetError

from .pads import CODES, PLAYSTATION, UNNAMED, XBOX, plugged

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
