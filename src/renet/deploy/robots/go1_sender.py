"""The process that talks to the Go1 at 500 Hz, whatever becomes of the controller's.

It shares memory with the controller and holds the reading end of a pipe whose other end only the
controller has: the system closes that however the controller dies. It then brakes the robot while
it sinks, and ends. It runs in a session of its own, so that no key of the terminal reaches it.
"""

import mmap
import select
import signal
import sys
import time
import zlib

import numpy as np

from renet.deploy.realtime import realtime
from renet.deploy.robots.base import VECTORS, JointCommand
from renet.deploy.robots.go1_link import PERIOD, Go1Link

PRIORITY = 60
"""Of SCHED_FIFO: above the controller's."""
SINK = 1.0
"""Seconds of braking with which a connection ends; a standing Go1 sinks to the ground in them."""

ALIVE = np.dtype([("time", "f8")])
COMMAND = np.dtype(
    [("time", "f8"), ("position", "f8", 12), ("stiffness", "f8", 12), ("damping", "f8", 12)]
)
READING = np.dtype(
    [
        ("known", "?"),
        ("time", "f8"),
        *((name, "f8", size) for name, size in VECTORS.items()),
        ("temperature", "f8"),
        ("battery", "f8"),
        ("problem", "S200"),
        ("refused", "S200"),
    ]
)
VALUES = READING.names[1:-2] if READING.names else ()
SIZE = 4096


def clock() -> float:
    """Seconds, the same in all processes; they go on while the computer sleeps."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


class Mailbox:
    """The newest value of a fixed layout in memory that two processes share.

    One writer, one reader, no lock: a torn value fails its check and is no value. Whichever process
    dies or stops in the middle of a write or a read, the other goes on.
    """

    def __init__(self, memory: mmap.mmap, offset: int, layout: np.dtype) -> None:
        self._memory, self._offset, self._layout = memory, offset, layout
        self.end = offset + layout.itemsize + 4
        """First byte after it."""
        self._value: np.ndarray | None = None

    def write(self, value: np.ndarray) -> None:
        """Replace the value, a scalar array of the layout."""
        data = value.tobytes()
        self._memory[self._offset : self.end] = data + zlib.crc32(data).to_bytes(4, "little")

    def read(self) -> np.ndarray | None:
        """The newest whole value; None before the first."""
        for _ in range(3):
            raw = self._memory[self._offset : self.end]
            if zlib.crc32(raw[:-4]) == int.from_bytes(raw[-4:], "little"):
                self._value = np.frombuffer(raw, self._layout, 1)[0]
                break
        return self._value


def mailboxes(memory: mmap.mmap) -> tuple[Mailbox, Mailbox, Mailbox]:
    """Signs of life and commands of the controller, readings of the sender."""
    alive = Mailbox(memory, 0, ALIVE)
    commands = Mailbox(memory, alive.end, COMMAND)
    return alive, commands, Mailbox(memory, commands.end, READING)


def main(arguments: list[str]) -> None:
    """Talk to the robot until the controller is gone.

    Args:
        arguments: descriptors of the shared memory and of the pipe, the robot's address and port,
            the local port, the power level of the vendor's guard, seconds of braking at the end.
    """
    memory, pipe = (int(text) for text in arguments[:2])
    host, port, local_port, level, sink = arguments[2:]
    for name in ("INT", "TSTP", "QUIT", "HUP", "TERM", "USR1", "USR2", "PIPE"):
        signal.signal(signal.Signals[f"SIG{name}"], signal.SIG_IGN)
    alive, commands, readings = mailboxes(mmap.mmap(memory, SIZE))
    link = Go1Link(host, int(port), int(local_port), int(level))
    with realtime(PRIORITY) as refused:
        due, end = clock(), np.inf
        while clock() < end:
            if end == np.inf and select.select([pipe], [], [], 0.0)[0]:  # The controller is gone.
                link.problem = link.problem or "the connection was closed"
                end = clock() + float(sink) if link.commanded > -np.inf else 0.0
            step(link, alive, commands, readings, refused)
            due = max(due + PERIOD, clock())
            time.sleep(max(0.0, due - clock()))


def step(link: Go1Link, alive: Mailbox, commands: Mailbox, readings: Mailbox, refused: str) -> None:
    """One exchange, with what the controller last said; tells it what came back."""
    sign, said, answer = alive.read(), commands.read(), np.zeros((), READING)
    try:
        if sign is not None:
            link.alive(float(sign["time"]))
        if said is not None and said["time"] != link.commanded:
            parts = (said["position"], said["stiffness"], said["damping"])
            link.command(JointCommand(*parts), float(said["time"]))
        link.exchange(clock())
    except Exception as error:  # Talking on is all that can still brake the robot.
        link.problem = f"the vendor's driver failed: {type(error).__name__}: {error}"
    if link.state is not None:
        answer["known"] = True
        for name in VALUES:
            answer[name] = getattr(link.state, name)
    answer["problem"] = link.problem.encode()[:200]
    answer["refused"] = refused.encode()[:200]
    readings.write(answer)


if __name__ == "__main__":
    main(sys.argv[1:])
