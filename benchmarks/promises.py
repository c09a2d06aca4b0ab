"""What must hold of a robot under `renet deploy` whatever goes wrong; every breach is kept."""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from renet.deploy.controller import Controller, Event
from renet.deploy.robots.base import JointCommand
from renet.deploy.robots.real.braking import SILENCE, Link
from renet.deploy.safety.machine import Mode
from renet.interface import ACTION_SIZE
from renet.robots import Robot

ROUNDING = 1e-6
"""Beyond a limit, rad or of a gain, that floats of a bundle may be."""
LONGEST_LINE = 200
"""Characters of a line to the operator."""
EXPECTED = ("OSError",)
"""Exceptions that drivers raise here on purpose."""
_EXCEPTION = re.compile(r"\b(\w*(?:Error|Exception|Warning)): ")


class Promises:
    """Looks at every command, event and step of all runs."""

    def __init__(self, robot: Robot) -> None:
        zero = np.zeros(ACTION_SIZE)
        self._least = np.concatenate((robot.lower, zero, zero)) - ROUNDING
        """Least position, stiffness and damping of each joint, [36]."""
        gains = (zero + robot.max_stiffness, zero + robot.max_damping)
        self._most = np.concatenate((robot.upper, *gains)) + ROUNDING
        """Largest, likewise."""
        self._controller: Controller | None = None
        self._link: Link | None = None
        self._mode = Mode.DAMPING
        """Mode after the last step."""
        self._told = Mode.DAMPING
        """Newest mode that the operator was told."""
        self._answered = False
        """True if the operator was told in this step why the robot does not stand up."""
        self.broken: Counter[str] = Counter()
        """Breaches, and how often each was."""
        self.first: dict[str, float] = {}
        """Time of the first breach of each kind, s on the robot's clock."""
        self._now = 0.0
        self.commands = 0
        """Commands that reached the motors."""

    def begin(self, controller: Controller, link: Link) -> None:
        """Watch another run, which begins braked."""
        self._controller = controller
        self._link = link
        self._mode = Mode.DAMPING
        self._told = Mode.DAMPING

    def warned(self, message: Warning | str, category: type[Warning], *where: object) -> None:
        """Keep a warning of Python or NumPy; takes the place of `warnings.showwarning`."""
        self._break(f"a warning: {category.__name__}: {message}")

    def sent(self, command: JointCommand, now: float) -> None:
        """Check a command that is about to reach the motors at `now`, s."""
        self._now = now
        self.commands += 1
        values = np.concatenate((command.position, command.stiffness, command.damping))
        # No comparison holds for a NaN.
        within = (values >= self._least) & (values <= self._most)
        if not within.all():
            self._name(values, within)
        self._check_braked(command, now)

    def _name(self, values: np.ndarray, within: np.ndarray) -> None:
        """Say what is wrong with a command of which not all numbers are within their limits."""
        if not np.isfinite(values).all():
            self._break("a command is not finite")
        elif not within[:ACTION_SIZE].all():
            self._break("a joint target is outside of its range")
        else:
            self._break("a gain is outside of its range")

    def _check_braked(self, command: JointCommand, now: float) -> None:
        """Check that a robot that was braked longer than a command lasts is only braked."""
        if not command.stiffness.any():
            return
        if self._link is not None and self._link.problem:
            self._break("a robot braked for good is driven")
        if self._controller is None:
            return
        machine = self._controller.machine
        if machine.mode is Mode.DAMPING and now - machine.since > SILENCE:
            self._break("a braked robot is driven")

    def event(self, event: Event) -> None:
        """Check what the operator is told: one line, of no exception that was not provoked."""
        self._now = event.time
        line = f"{event.what}: {event.why}"
        if not event.why or not line.isprintable() or len(line) > LONGEST_LINE:
            self._break(f"no line for the operator: {line!r}")
        for name in _EXCEPTION.findall(event.why):
            if name not in EXPECTED:
                self._break(f"an exception: {event.why}")
        if event.what in tuple(Mode):
            self._told = Mode(event.what)
        self._answered = self._answered or event.what in ("refused", Mode.DAMPING)

    def step(self, command: JointCommand, armed: bool) -> None:
        """Check a control step, in which the operator may have asked to stand up."""
        if self._controller is None:
            return
        before = self._mode
        self._mode = self._controller.machine.mode
        if self._told is not self._mode:
            self._break(f"nobody was told of {self._mode}")
        rises = before is Mode.DAMPING and self._mode is not Mode.DAMPING
        if rises and not (armed and self._mode is Mode.STANDING_UP):
            self._break(f"from damping to {self._mode} without being armed")
        if armed and before is Mode.DAMPING and not rises and not self._answered:
            self._break("nobody was told why the robot does not stand up")
        # In a step in which it was armed, too, it may have begun to rise before it was braked.
        braked = before is Mode.DAMPING and self._mode is Mode.DAMPING and not armed
        if braked and command.stiffness.any():
            self._break("a braked robot is commanded")
        self._answered = False

    @contextmanager
    def checked(self) -> Iterator[None]:
        """Count an exception in a block as a breach."""
        try:
            yield
        except Exception as error:
            self._break(f"a check failed: {type(error).__name__}: {error}")
            raise

    def _break(self, how: str) -> None:
        self.broken[how] += 1
        if how not in self.first:
            self.first[how] = round(self._now, 2)
            print(f"{self._now:.2f} s: {how}", flush=True)


def watch_warnings(promises: Promises) -> None:
    """Let every kind of warning count once; the caller restores the filters."""
    warnings.simplefilter("default")
    warnings.showwarning = promises.warned
