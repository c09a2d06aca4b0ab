"""The process that talks to a real robot at 500 Hz, whatever becomes of the controller's.

It shares memory with the controller and holds the reading end of a pipe whose other end only the
controller has: the system closes that however the controller dies. It then brakes the robot while
it sinks, and ends. It runs in a session of its own, so that no key of the terminal reaches it.
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
from renet.deploy.robots.real.mailbox import READING, SIZE, VALUES, Mailbox, clock, mailboxes
from renet.errors import RenetError

PRIORITY = 60
"""SCHED_FIFO priority, above the controller's."""


def main(arguments: list[str]) -> None:
    """Talk to the robot until the controller is gone.

    Args:
        arguments: descriptors of the shared memory and of the pipe, seconds of braking at the end,
            MODULE:CLASS of the robot's link, and its settings as a JSON list.
    """
    memory, pipe = (int(text) for text in arguments[:2])
    sink, link_class, settings = arguments[2:]
    for name in ("INT", "TSTP", "QUIT", "HUP", "TERM", "USR1", "USR2", "PIPE"):
        signal.signal(signal.Signals[f"SIG{name}"], signal.SIG_IGN)
    alive, commands, readings = mailboxes(mmap.mmap(memory, SIZE))
    with realtime(PRIORITY) as refused:  # From before the link starts threads of its own.
        try:
            link: Link = pkgutil.resolve_name(link_class)(*json.loads(settings))
        except Exception as error:
            named = isinstance(error, RenetError)
            problem = str(error) if named else f"{type(error).__name__}: {error}"
            readings.write(_reading(None, problem, refused))
            return
        due, end = clock(), np.inf
        while clock() < end:
            if end == np.inf and select.select([pipe], [], [], 0.0)[0]:  # The controller is gone.
                link.problem = link.problem or "the connection was closed"
                end = clock() + float(sink) if link.moved else 0.0
            step(link, alive, commands)
            with link.braked_on_failure():
                readings.write(_reading(link, link.problem, refused))
            due = max(due + PERIOD, clock())
            time.sleep(max(0.0, due - clock()))


def step(link: Link, alive: Mailbox, commands: Mailbox) -> None:
    """One exchange, with what the controller last said."""
    with link.braked_on_failure():
        sign, message = alive.read(), commands.read()
        if sign is not None:
            link.alive(float(sign["time"]))
        if message is not None and message["time"] != link.commanded:
            parts = (message["position"], message["stiffness"], message["damping"])
            link.command(JointCommand(*parts), float(message["time"]))
    with link.braked_on_failure():
        link.exchange(clock())


def _reading(link: Link | None, problem: str, refused: str) -> np.ndarray:
    """What the controller is told."""
    reading = np.zeros((), READING)
    if link is not None and link.state is not None:
        reading["valid"] = True
        for name in VALUES:
            reading[name] = getattr(link.state, name)
        reading["fault"] = link.state.fault.encode()
    reading["problem"], reading["refused"] = problem.encode(), refused.encode()
    return reading


if __name__ == "__main__":
    main(sys.argv[1:])
