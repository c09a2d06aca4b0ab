"""Steps with which a run begins; a dry run prints each of them with its time."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from renet.bundle import Bundle
from renet.deploy.robots.base import RobotDriver
from renet.errors import RenetError, demand_none
from renet.interface import CONTROL_DT

WATCHED = 1.0
"""Time for which a robot's readings are counted, s."""
FEWEST = 50.0
"""Fewest readings a second: each control step needs one of its own."""
RUNS = 50
"""Number of runs in which models are timed."""
FAILED = "FAILED"
"""Mark of a step without which no run begins."""
SLOW = "SLOW"
"""Mark of a step that a busy computer fails, after which a dry run still shows the joints."""


class Checklist:
    """Steps that are printed with their times; failures are kept until the end.

    Without `patience`, nothing is printed, and the first failure ends the run.
    """

    def __init__(self, say: Callable[[str], None], patience: bool) -> None:
        """Begin a list; `say` prints a line for the user."""
        self._say = say
        self.patience = patience
        self.failures: list[str] = []
        """A line for each step that failed."""

    @contextmanager
    def step(self, name: str, mark: str = FAILED) -> Iterator[list[str]]:
        """Run a block as one step; remarks in the list that it yields are printed with it.

        Args:
            name: Name of the step.
            mark: Mark of a failure. After any but `FAILED` the run begins all the same.

        Raises:
            RenetError: The step failed, and there is no patience.
        """
        begun = time.monotonic()
        remarks: list[str] = []
        try:
            yield remarks
        except RenetError as error:
            # A dry run goes on, so that the user sees all failures at once.
            if not self.patience:
                raise
            if mark == FAILED:
                self.failures.append(f"{name}: {error}")
            self._tell(mark, begun, name, [str(error)])
        else:
            self._tell("ok", begun, name, remarks)

    def passed(self, name: str, begun: float) -> None:
        """Print a step that succeeded; it began at the time `begun` of the monotonic clock, s."""
        self._tell("ok", begun, name, [])

    def _tell(self, mark: str, begun: float, name: str, remarks: Sequence[str]) -> None:
        if self.patience:
            took = time.monotonic() - begun
            self._say(f"{mark:<6} {took:6.2f} s  {': '.join([name, *remarks])}")

    def finish(self) -> None:
        """Raise RenetError with all failures, if there are any."""
        demand_none(self.failures)


def count_readings(robot: RobotDriver) -> str:
    """Count a robot's readings for a second, and say how many; raises RenetError for too few."""
    times = set()
    newest = None
    begun = robot.now()
    while robot.now() - begun < WATCHED:
        # Four looks in each control step; of a faster robot, 200 readings a second are counted.
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
    """Time a bundle's models on this computer, and say it; raises RenetError if too slow."""
    inputs: dict[str, dict[str, np.ndarray]] = {}
    outputs = {}
    for name, session in bundle.sessions.items():
        inputs[name] = {}
        for node in session.get_inputs():
            # The batch axis has a name instead of a size.
            shape = [size if isinstance(size, int) else 1 for size in node.shape]
            inputs[name][node.name] = np.zeros(shape, np.float32)
        outputs[name] = sorted(bundle.outputs(name))
    took = []
    for _ in range(RUNS):
        begun = time.perf_counter()
        for name, session in bundle.sessions.items():
            session.run(outputs[name], inputs[name])
        took.append(time.perf_counter() - begun)
    usual, slow = np.percentile(took, (50, 95))
    words = f"half of the steps take {1000 * usual:.1f} ms, 19 of 20 at most {1000 * slow:.1f} ms"
    allowed = f"allowed: {1000 * CONTROL_DT:.0f} ms"
    if slow > CONTROL_DT:
        raise RenetError(
            f"{words} ({allowed}): the computer is busy or too slow; end other programs and check"
            " again before the robot moves"
        )
    return f"{words} ({allowed})"
