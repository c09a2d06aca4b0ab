"""The process that talks to a real robot at 500 Hz, whatever becomes of the controller's.

It shares memory with the controller, and reads a pipe whose other end the system closes however the
controller dies. Then it brakes the robot while it sinks, and ends. It runs in a session of its own,
so that no key of the terminal reaches it.
"""

import json
import mmap
import pkgutil
import select
import signal
import sys
import time

import numpy as np

from renet.deploy.realtime import realtime
from renet.deploy.robots.base import JointCommand
from renet.deploy.robots.real.braking import PERIOD, Link
from renet.deploy.robots.real.mailbox import READING_LAYOUT, SIZE, VALUES, Mailbox, clock, mailboxes
from renet.errors import RenetError

_PRIORITY = 60
"""SCHED_FIFO priority of the exchange, above the controller's."""


def main(arguments: list[str]) -> None:
    """Talk to the robot until the controller is gone.

    Args:
        arguments: Descriptors of the shared memory and of the pipe, time of braking at the end in
            s, MODULE:CLASS of the robot's link, and the link's arguments as a JSON list.
    """
    memory, pipe = map(int, arguments[:2])
    sink, link_class, settings = arguments[2:]
    # Only the end of the controller ends this process.
    for name in ("INT", "TSTP", "QUIT", "HUP", "TERM", "USR1", "USR2", "PIPE"):
        signal.signal(signal.Signals[f"SIG{name}"], signal.SIG_IGN)
    alive, commands, readings = mailboxes(mmap.mmap(memory, SIZE))
    # The link may start threads, which inherit the priority.
    with realtime(_PRIORITY) as refused:
        try:
            link: Link = pkgutil.resolve_name(link_class)(*json.loads(settings))
        except Exception as error:
            named = isinstance(error, RenetError)
            problem = str(error) if named else f"{type(error).__name__}: {error}"
            readings.write(_reading(None, problem, refused))
            return
        due = clock()
        end = np.inf
        while clock() < end:
            # The pipe is readable once its other end is closed: the controller is gone.
            if end == np.inf and select.select([pipe], [], [], 0.0)[0]:
                link.problem = link.problem or "the connection was closed"
                end = clock() + float(sink) if link.moved else 0.0
            step(link, alive, commands)
            with link.braked_on_failure():
                readings.write(_reading(link, link.problem, refused))
            due = max(due + PERIOD, clock())
            time.sleep(max(0.0, due - clock()))


def step(link: Link, alive: Mailbox, commands: Mailbox) -> None:
    """Do one exchange with the controller's newest sign of life and command."""
    with link.braked_on_failure():
        sign = alive.read()
        message = commands.read()
        if sign is not None:
            link.alive(float(sign["time"]))
        if message is not None and message["time"] != link.commanded:
            command = JointCommand(message["position"], message["stiffness"], message["damping"])
            link.command(command, float(message["time"]))
    with link.braked_on_failure():
        link.exchange(clock())


def _reading(link: Link | None, problem: str, refused: str) -> np.ndarray:
    """Return the message to the controller, of `READING_LAYOUT`."""
    reading = np.zeros((), READING_LAYOUT)
    if link is not None and link.state is not None:
        reading["valid"] = True
        for name in VALUES:
            reading[name] = getattr(link.state, name)
        reading["fault"] = link.state.fault.encode()
    reading["problem"] = problem.encode()
    reading["refused"] = refused.encode()
    return reading


if __name__ == "__main__":
    main(sys.argv[1:])
