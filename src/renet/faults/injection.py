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
from renet.interface import CONTROL_DT


@dataclass(frozen=True)
class Injection:
    """One fault on one camera: what, how strong, and when."""

    fault: str
    """Name in the catalogue (`FAULTS`)."""
    level: float
    """Strength, in the fault's own unit."""
    onset: int = 150
    """Control step (0.02 s) at which it begins."""
    duration: float = FOREVER
    """Seconds for which it is at work."""
    period: float = FOREVER
    """Seconds from one onset to the next; infinity: there is one onset."""

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
        """The injection of a catalogue fault at a severity between 1 and 5."""
        return cls(fault, fault_class(fault).level_of(severity), onset, duration)

    def elapsed(self, step: int) -> float:
        """Seconds since the latest onset at a control step; -1 where it is not at work."""
        steps = step - self.onset
        if steps < 0:
            return -1.0
        if self.period < FOREVER:
            steps %= max(round(self.period / CONTROL_DT), 1)
        time = steps * CONTROL_DT
        return time if time < min(self.duration, FAULTS[self.fault].lasts(self.level)) else -1.0

    def at_work(self, step: int) -> bool:
        """Whether it spoils the camera's frames at a control step."""
        return self.elapsed(step) >= 0


FAULT = re.compile(
    r"(?P<name>[a-z_]+)(:(?P<severity>\d))?"
    r"(@(?P<onset>\d{1,9}(\.\d+)?)s?(\+(?P<length>\d{1,9}(\.\d+)?)s?)?)?"
)
WORST = 5
"""Severity of a fault that does not name one."""


def parse_fault(text: str, onset: float | None = None) -> Injection:
    """The injection that a command line asks for.

    Args:
        text: `NAME[:SEVERITY]@SECONDS[+DURATION]`, such as `glare:3@4s+2s`.
        onset: onset in s of a text without one; None: the text must have one.

    Raises:
        RenetError: a text of another form, an unknown fault or severity.
    """
    match = FAULT.fullmatch(text)
    begins = float(match["onset"]) if match and match["onset"] else onset
    if match is None or begins is None:
        raise RenetError(
            f"cannot read the fault {text!r}: write NAME[:SEVERITY]@SECONDS[+DURATION], "
            "such as blackout@5s or glare:3@4s+2s"
        )
    step, severity = round(begins / CONTROL_DT), int(match["severity"] or WORST)
    return Injection.of(match["name"], severity, step, duration=float(match["length"] or "inf"))


Schedule = tuple[Injection, ...]
"""Injections into one camera, which act one after the other on the same frames."""


class Injector:
    """Spoils the frames of a batch of robots, each by its own schedule."""

    def __init__(
        self,
        schedules: Sequence[Schedule],
        streams: Sequence[int],
        seed: int,
        physical: bool = False,
    ) -> None:
        """Set up the faults. Robots with the same stream and seed draw the same noise in any row.

        Args:
            schedules: one for each robot.
            streams: number of each robot's random stream.
            seed: seed of the whole study.
            physical: whether the cameras are in a world that carries out physical faults; these
                raise RenetError elsewhere.
        """
        self._num_robots = len(schedules)
        self._stages: list[tuple[Injection, Fault, np.ndarray]] = []
        for place in range(max((len(s) for s in schedules), default=0)):
            groups: dict[Injection, list[int]] = {}
            for row, schedule in enumerate(schedules):
                if place < len(schedule):
                    groups.setdefault(schedule[place], []).append(row)
            for injection, rows in groups.items():
                rngs = [np.random.default_rng([seed, place, streams[row]]) for row in rows]
                fault = FAULTS[injection.fault](injection.level, rngs)
                if isinstance(fault, PhysicalFault) and not physical:
                    raise RenetError(
                        f"fault '{fault.name}' acts on the scene, not on the image: only a"
                        " simulated world can carry it out"
                    )
                self._stages.append((injection, fault, np.array(rows)))

    def at_work(self, step: int) -> np.ndarray:
        """[n] bool: robots whose camera fails at a control step."""
        failing = np.zeros(self._num_robots, bool)
        for injection, _, rows in self._stages:
            failing[rows] |= injection.at_work(step)
        return failing

    def perturbation(self, step: int) -> ViewPerturbation:
        """The cameras' view of their scene at a control step."""
        view = ViewPerturbation.none(self._num_robots)
        for injection, fault, rows in self._stages:
            if isinstance(fault, PhysicalFault) and injection.at_work(step):
                fault.apply(view, rows, injection.elapsed(step))
        return view

    def apply(self, frames: Frames, step: int, spared: np.ndarray | None = None) -> Frames:
        """The frames after all faults of this control step; called once in each vision tick.

        Args:
            frames: of all robots. step: control step.
            spared: [n] bool, robots whose frames nobody looks at any more; they stay as they are.
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
