"""The steps with which a run begins; a dry run tells each, and how long it took."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from renet.bundle import Bundle
from renet.deploy.robots.driver import RobotDriver
from renet.errors import RenetError, demand_none
from renet.interface import CONTROL_DT

WATCHED = 1.0
"""Seconds in which a robot's readings are counted."""
FEWEST = 50.0
"""Readings a second with which each control step has one of its own."""
RUNS = 50
"""Runs of the models that are timed."""


class Checklist:
    """Steps, each of which is told with its time; a failure is kept, and the next step follows.

    Without `patience` nothing is told, and the first failure ends the run.
    """

    def __init__(self, say: Callable[[str], None], patience: bool) -> None:
        """Begin a list; `say` tells the user a line."""
        self._say, self.patience = say, patience
        self.failures: list[str] = []
        """A line for each step that failed."""

    @contextmanager
    def step(self, name: str) -> Iterator[list[str]]:
        """One step; what is put into the list that it gives is told with it.

        Raises RenetError as the step does, unless there is patience.
        """
        begun = time.monotonic()
        remarks: list[str] = []
        try:
            yield remarks
        except RenetError as error:
            if not self.patience:
                raise
            self.failures.append(f"{name}: {error}")
            self._tell("FAILED", begun, name, [str(error)])
        else:
            self._tell("ok", begun, name, remarks)

    def passed(self, name: str, begun: float) -> None:
        """Tell a step that began at a time of the monotonic clock and has gone well."""
        self._tell("ok", begun, name, [])

    def _tell(self, mark: str, begun: float, name: str, remarks: Sequence[str]) -> None:
        if self.patience:
            took = time.monotonic() - begun
            self._say(f"{mark:<6} {took:6.2f} s  {': '.join([name, *remarks])}")

    def finish(self) -> None:
        """Raise RenetError with all failures, if there are any."""
        demand_none(self.failures)


def count_readings(robot: RobotDriver) -> str:
    """What a robot sends in a second, in words; raises RenetError for too little."""
    times, newest = set(), None
    begun = robot.now()
    while robot.now() - begun < WATCHED:
        robot.wait(robot.now() + CONTROL_DT / 4)
        newest = robot.read() or newest
        if newest is not None:
            times.add(newest.time)
    rate = len(times) / WATCHED
    if newest is None or rate < FEWEST:
        raise RenetError(
            f"{rate:.0f} readings a second, and at least {FEWEST:.0f} are needed: take a cable, not"
            " Wi-Fi, and an idle computer"
        )
    battery = getattr(newest, "battery", np.nan)
    charge = f", battery {battery:.0%}" if np.isfinite(battery) else ""
    return f"{rate:.0f} a second{charge}"


def time_models(bundle: Bundle) -> str:
    """How long a bundle's models take on this computer, in words; raises RenetError if too long."""
    inputs = {
        name: {
            node.name: np.zeros([n if isinstance(n, int) else 1 for n in node.shape], np.float32)
            for node in session.get_inputs()
        }
        for name, session in bundle.sessions.items()
    }
    outputs = {name: sorted(bundle.outputs(name)) for name in bundle.sessions}
    took = []
    for _ in range(RUNS):
        begun = time.perf_counter()
        for name, session in bundle.sessions.items():
            session.run(outputs[name], inputs[name])
        took.append(time.perf_counter() - begun)
    usual, slow = np.percentile(took, (50, 95))
    words = f"{1000 * usual:.1f} ms, and at most {1000 * slow:.1f} ms in 95 %"
    if slow > CONTROL_DT:
        raise RenetError(
            f"{words}; a control step has {1000 * CONTROL_DT:.0f} ms: end other programs, or take a"
            " faster computer"
        )
    return words
