"""Schedules of faults, and the injector that applies them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from renet.errors import RenetError
from renet.faults.base import FOREVER, Fault, Frames
from renet.faults.catalogue import FAULTS, fault_class
from renet.faults.physical import PhysicalFault, ViewPerturbation
from renet.interface import CONTROL_DT, control_steps


@dataclass(frozen=True)
class Injection:
    """Fault of one camera, with its level and its time."""

    fault: str
    """Name in the catalogue (`FAULTS`)."""
    level: float
    """Level, in the fault's unit."""
    onset: int = 150
    """Control step (0.02 s) at which the fault begins."""
    duration: float = FOREVER
    """Time for which the fault is active, s."""
    period: float = FOREVER
    """Time from one onset to the next, s; infinity for a single onset."""

    def __post_init__(self) -> None:
        fault_class(self.fault)
        if self.onset < 0 or self.duration <= 0 or self.period < self.duration:
            raise RenetError(
                f"fault '{self.fault}': onset {self.onset} must be >= 0 and"
                f" 0 < duration {self.duration} <= period {self.period}"
            )

    @classmethod
    def of(
        cls, fault: str, severity: int, onset: int = 150, duration: float = FOREVER
    ) -> Injection:
        """Build the injection of a fault at a severity from 1 to 5."""
        return cls(fault, fault_class(fault).level_of(severity), onset, duration)

    def elapsed(self, step: int) -> float:
        """Return the time since the latest onset at a control step, s; -1 if it is not active."""
        steps = step - self.onset
        if steps < 0:
            return -1.0
        if self.period < FOREVER:
            steps %= max(control_steps(self.period), 1)
        time = steps * CONTROL_DT
        # Some faults end by themselves.
        duration = min(self.duration, FAULTS[self.fault].lasts(self.level))
        return time if time < duration else -1.0

    def at_work(self, step: int) -> bool:
        """Return True if the fault is active at a control step."""
        return self.elapsed(step) >= 0


FAULT = re.compile(
    r"(?P<name>[a-z_]+)(:(?P<severity>\d))?"
    r"(@(?P<onset>\d{1,9}(\.\d+)?)s?(\+(?P<length>\d{1,9}(\.\d+)?)s?)?)?"
)
WORST = 5
"""Severity of a fault that is given without one."""


def parse_fault(text: str, onset: float | None = None) -> Injection:
    """Parse an injection given on the command line.

    Args:
        text: `NAME[:SEVERITY]@SECONDS[+DURATION]`, such as `glare:3@4s+2s`.
        onset: Onset of a text without one, s; with None the text must have one.

    Raises:
        RenetError: The text has another form, or an unknown fault or severity.
    """
    match = FAULT.fullmatch(text)
    begins = float(match["onset"]) if match and match["onset"] else onset
    # A misspelt name is the likelier mistake, and its form may be another one.
    if name := re.match(r"[a-z_]+", text):
        fault_class(name[0])
    if match is None or begins is None:
        raise RenetError(
            f"cannot read the fault {text!r}: write NAME[:SEVERITY]@SECONDS[+DURATION], "
            "such as blackout@5s or glare:3@4s+2s"
        )
    severity = int(match["severity"] or WORST)
    step = control_steps(begins)
    duration = float(match["length"] or "inf")
    return Injection.of(match["name"], severity, step, duration)


FaultSchedule = tuple[Injection, ...]
"""Injections into one camera, applied one after the other to the same frames."""


class Injector:
    """Injector of faults into the frames of a batch of robots, each with its own schedule."""

    def __init__(
        self,
        schedules: Sequence[FaultSchedule],
        streams: Sequence[int],
        seed: int,
        physical: bool = False,
    ) -> None:
        """Build the faults of all robots.

        Robots with the same stream and seed draw the same noise, whatever their rows are.

        Args:
            schedules: Schedules of the robots.
            streams: Numbers of the robots' random streams.
            seed: Seed of the whole study.
            physical: The cameras are in a simulated world, which can apply physical faults.

        Raises:
            RenetError: A schedule has a physical fault, but the cameras are not in such a world.
        """
        self._num_robots = len(schedules)
        self._stages: list[tuple[Injection, Fault, np.ndarray]] = []
        length = max((len(schedule) for schedule in schedules), default=0)
        for position in range(length):
            # Robots with the same injection at this position share a fault.
            groups: dict[Injection, list[int]] = {}
            for row, schedule in enumerate(schedules):
                if position < len(schedule):
                    groups.setdefault(schedule[position], []).append(row)
            for injection, rows in groups.items():
                rngs = [np.random.default_rng([seed, position, streams[row]]) for row in rows]
                fault = FAULTS[injection.fault](injection.level, rngs)
                if isinstance(fault, PhysicalFault) and not physical:
                    raise RenetError(
                        f"fault '{fault.name}' acts on the scene, not on the image: only a"
                        " simulated world can carry it out"
                    )
                self._stages.append((injection, fault, np.array(rows)))

    def at_work(self, step: int) -> np.ndarray:
        """Return a mask of robots with an active fault at a control step, [n] bool."""
        mask = np.zeros(self._num_robots, bool)
        for injection, _, rows in self._stages:
            mask[rows] |= injection.at_work(step)
        return mask

    def perturbation(self, step: int) -> ViewPerturbation:
        """Compute the difference between the cameras' views and their scenes at a control step."""
        view = ViewPerturbation.none(self._num_robots)
        for injection, fault, rows in self._stages:
            if isinstance(fault, PhysicalFault) and injection.at_work(step):
                fault.apply(view, rows, injection.elapsed(step))
        return view

    def apply(self, frames: Frames, step: int, spared: np.ndarray | None = None) -> Frames:
        """Apply all faults to frames; call this once in each vision tick.

        Args:
            frames: Frames of all robots; not changed.
            step: Control step.
            spared: True for robots whose frames are not read any more and stay as they are, [n]
                bool.
        """
        frames = frames.copy()
        for injection, fault, rows in self._stages:
            time = injection.elapsed(step)
            times = np.full(len(rows), time)
            if spared is not None:
                times[spared[rows]] = -1.0
            spoilt = fault.corrupt(frames.rows(rows), times)
            if time >= 0:
                frames.write(rows, spoilt)
        return frames
