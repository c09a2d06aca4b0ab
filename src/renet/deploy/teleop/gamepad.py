"""Gamepads as operators' devices, through Linux' joystick interface.

Every pad numbers its buttons in its own order: number 7 is Start on an Xbox pad and a trigger on a
PlayStation pad. So the driver is asked which stick or button of `linux/input-event-codes.h` each
number is.
"""

import array
import fcntl
import os
import struct
from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass
from glob import glob

from renet.deploy.teleop.base import MAX_INPUT, Deadman, TeleopCommand
from renet.errors import RenetError, printable
from renet.interface import MAX_REVERSE, MAX_SIDEWAYS, MAX_SPEED, MAX_TURN

DEVICES = "/dev/input/js*"
"""Pattern of the pads' device files."""
STICK_NAMES = {0x00: "ABS_X", 0x01: "ABS_Y", 0x03: "ABS_RX"}
"""Names of the sticks in use by their codes."""
BUTTON_NAMES = {0x130: "BTN_SOUTH", 0x131: "BTN_EAST", 0x13B: "BTN_START"}
"""Names of the buttons in use by their codes."""
EVENT = struct.Struct("<IhBB")
"""Time, value, kind and number: `struct js_event` of `linux/joystick.h`."""
# Bits of an event's kind.
_AXIS = 0x02
_REPEATED = 0x80
_FULL = 32767.0
"""A stick's value at its end; the kernel scales all pads to it."""
GONE = "the gamepad is gone: connect it, and start renet again"
"""Problem of a gamepad that was unplugged, or whose battery is empty; it is not opened anew."""
DEAD_ZONE = 0.1
"""Share of its range by which a stick must be off its middle to steer, and by which it must move to
show that somebody holds it. Noise is smaller."""
# Codes of buttons, number of codes of sticks, and bytes of a name, as the kernel has them.
_FIRST_BUTTON = 0x100
_LAST_BUTTON = 0x2FF
_ALL_AXES = 0x40
_NAME_SIZE = 128


def _read_request(number: int, size: int) -> int:
    """Return the ioctl request for `size` bytes of the kernel: `_IOR('j', number, …)`."""
    return 2 << 30 | size << 16 | ord("j") << 8 | number


AXIS_COUNT = _read_request(0x11, 1)
BUTTON_COUNT = _read_request(0x12, 1)
PAD_NAME = _read_request(0x13, _NAME_SIZE)
AXIS_MAP = _read_request(0x32, _ALL_AXES)
BUTTON_MAP = _read_request(0x34, 2 * (_LAST_BUTTON - _FIRST_BUTTON + 1))


@dataclass(frozen=True)
class PadEvent:
    """Move of a stick, or press or release of a button."""

    name: str
    """The kernel's name; empty for a stick or button that is not used."""
    axis: bool
    value: float
    """Position of a stick, -1 to 1; 1 for a button that is pressed, 0 for one that is released."""
    repeated: bool
    """True if the kernel only repeats its state, as at the start: nobody may have touched it."""


class Gamepad:
    """An open gamepad."""

    def __init__(self, path: str) -> None:
        """Open a device; raises OSError if it cannot be opened or is no joystick."""
        self._device = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        try:
            self.title = self._ask(PAD_NAME, "B").tobytes().split(b"\0")[0].decode(errors="replace")
            # The kernel fills maps of fixed size, of which a pad uses the beginning.
            axes = self._ask(AXIS_MAP, "B")[: self._ask(AXIS_COUNT, "B")[0]]
            buttons = self._ask(BUTTON_MAP, "H")[: self._ask(BUTTON_COUNT, "B")[0]]
        except OSError:
            self.close()
            raise
        self._axes = [STICK_NAMES.get(code, "") for code in axes]
        self._buttons = [BUTTON_NAMES.get(code, "") for code in buttons]

    @staticmethod
    def find(names: Collection[str]) -> "Gamepad":
        """Open the first gamepad that has sticks and buttons of all these names.

        Raises:
            RenetError: There is no gamepad, or none has them all.
        """
        problem = f"no gamepad at {DEVICES}: connect one (in a container, pass it /dev/input)"
        for path in sorted(glob(DEVICES)):
            try:
                pad = Gamepad(path)
            except OSError as error:
                problem = f"cannot read the gamepad {path}: {error.strerror}"
                continue
            missing = pad.missing(names)
            if not missing:
                return pad
            pad.close()
            problem = (
                f"{path} ({printable(pad.title)}) has no {', '.join(missing)}: take a pad whose "
                "driver names its buttons, such as an Xbox or a PlayStation pad"
            )
        raise RenetError(problem)

    def missing(self, names: Collection[str]) -> list[str]:
        """List the names that no stick or button of this gamepad has."""
        return [name for name in names if name not in self._axes + self._buttons]

    def events(self) -> Iterator[PadEvent]:
        """Yield the events since the last call; raises OSError once the pad is unplugged."""
        data = b""
        # Without new events, a read would have to wait.
        with suppress(BlockingIOError):
            data = os.read(self._device, MAX_INPUT // EVENT.size * EVENT.size)
            if not data or len(data) % EVENT.size:
                raise OSError("the gamepad is gone")
        for _, value, kind, number in EVENT.iter_unpack(data):
            axis = kind & ~_REPEATED == _AXIS
            known = self._axes if axis else self._buttons
            name = known[number] if number < len(known) else ""
            yield PadEvent(name, axis, value / _FULL if axis else value, bool(kind & _REPEATED))

    def close(self) -> None:
        """Close the device."""
        os.close(self._device)

    def _ask(self, request: int, kind: str) -> array.array:
        """Return the numbers of the kernel's answer; `kind` is a type code of `array`."""
        # The request itself says how many bytes the answer has.
        size = request >> 16 & 0x3FFF
        answer = array.array(kind, bytes(size))
        fcntl.ioctl(self._device, request, answer, True)
        return answer


class GamepadTeleop:
    """Reads a gamepad whose sticks and buttons the kernel names."""

    _OTHERS = (
        "right stick turns, Start or Options stands up and walks, A, B, cross or circle brakes"
    )
    controls = f"left stick forward/backward and sideways, {_OTHERS}"
    controls_ahead = f"left stick ahead, {_OTHERS}"
    FORWARD = "ABS_Y"
    LEFT = "ABS_X"
    TURN = "ABS_RX"
    ARM_BUTTONS = ("BTN_START",)
    STOP_BUTTONS = ("BTN_SOUTH", "BTN_EAST")
    attended = True

    def __init__(self, deadman: float) -> None:
        """Open the first gamepad that can steer; raises RenetError if there is none.

        The robot stands after `deadman` seconds without a move of stick or button.
        """
        sticks = (self.FORWARD, self.LEFT, self.TURN)
        self._pad = Gamepad.find((*sticks, *self.ARM_BUTTONS, *self.STOP_BUTTONS))
        self._sticks: dict[str, float] = {name: 0.0 for name in sticks}
        self._held = dict(self._sticks)
        self._deadman = Deadman(deadman)
        self.problem = ""
        """Problem that the operator is to be told; empty if there is none."""

    def command(self, now: float) -> TeleopCommand:
        """Return the command of sticks and buttons; an unplugged gamepad stops the robot."""
        arm = stop = heard = False
        try:
            for event in self._pad.events():
                # After an overflow of its queue, the kernel repeats all states without a hand.
                by_hand = not event.repeated
                if event.name in self._sticks:
                    heard |= self._moved(event.name, event.value) and by_hand
                elif not event.axis:
                    heard |= by_hand
                    pressed = event.value > 0.0
                    arm |= pressed and by_hand and event.name in self.ARM_BUTTONS
                    stop |= pressed and event.name in self.STOP_BUTTONS
        except OSError:
            stop = True
            self.problem = GONE
        authority = self._deadman.authority(heard, now)
        # The kernel counts sticks positive to the right and towards the operator.
        ahead = -self._stick(self.FORWARD)
        return TeleopCommand(
            forward=authority * ahead * (MAX_SPEED if ahead > 0.0 else MAX_REVERSE),
            left=authority * -self._stick(self.LEFT) * MAX_SIDEWAYS,
            turn_rate=authority * -self._stick(self.TURN) * MAX_TURN,
            arm=arm,
            stop=stop,
        )

    def drain(self, now: float) -> None:
        """Forget the buttons that were pressed, and learn where the sticks are."""
        self.command(now)

    def close(self) -> None:
        """Close the device."""
        self._pad.close()

    def _moved(self, name: str, value: float) -> bool:
        """Note where a stick is; returns True if it moved since the last time that it did."""
        self._sticks[name] = value
        moved = abs(value - self._held[name]) >= DEAD_ZONE
        if moved:
            self._held[name] = value
        return moved

    def _stick(self, name: str) -> float:
        """Return the position of a stick, -1 to 1, with a dead zone."""
        value = self._sticks[name]
        return value if abs(value) > DEAD_ZONE else 0.0
