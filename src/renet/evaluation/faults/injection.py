"""When which robot's camera fails: schedules, and the injector that carries them out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from renet.errors import RenetError
from renet.evaluation.faults.catalogue import FAULTS, fault_class
from renet.evaluation.faults.stream import Fault, Frames
from renet.evaluation.faults.view import PhysicalFault, View
from renet.vocabulary import CONTROL_DT

FOREVER = float("inf")


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
    """Seconds it is at work."""
    period: float = FOREVER
    """Seconds from one onset to the next; infinity: it comes once."""

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
        """Seconds since the (latest) onset at a control step; -1 where it is not at work."""
        time = (step - self.onset) * CONTROL_DT
        if time < 0:
            return -1.0
        if self.period < FOREVER:
            time %= self.period
        return time if time < self.duration else -1.0


Schedule = tuple[Injection, ...]
"""What happens to one camera; several injections act one after the other on the same frames."""


class Injector:
    """Spoils the frames of a batch of robots, each by its own schedule."""

    def __init__(
        self,
        schedules: Sequence[Schedule],
        streams: Sequence[int],
        seed: int,
        physical: bool = False,
    ) -> None:
        """Robots with the same stream number and seed draw the same noise, whatever their row.

        Args:
            schedules: one for each robot.
            streams: one random stream number for each robot.
            seed: of the whole study.
            physical: the cameras belong to a world that carries out physical faults.

        Raises:
            RenetError: a physical fault for any other camera.
        """
        self._num_robots, self._physical = len(schedules), physical
        self._streams, self._seed = list(streams), seed
        self._stages: list[tuple[Injection, Fault, np.ndarray]] = []
        for place in range(max((len(s) for s in schedules), default=0)):
            groups: dict[Injection, list[int]] = {}
            for row, schedule in enumerate(schedules):
                if place < len(schedule):
                    groups.setdefault(schedule[place], []).append(row)
            for injection, rows in groups.items():
                self._add(injection, rows, place)

    def _add(self, injection: Injection, rows: Sequence[int], place: int) -> None:
        rngs = [np.random.default_rng([self._seed, place, self._streams[row]]) for row in rows]
        fault = FAULTS[injection.fault](injection.level, rngs)
        if isinstance(fault, PhysicalFault) and not self._physical:
            raise RenetError(
                f"fault '{fault.name}' acts on the scene, not on the image: only a"
                " simulated world can carry it out"
            )
        self._stages.append((injection, fault, np.array(rows)))

    def add(self, injection: Injection, rows: Sequence[int] | None = None) -> None:
        """Let the cameras of `rows`, of all robots by default, fail from `injection.onset` on.

        May be called at any time, so that faults can be commanded while robots walk; see
        `injection_of_verb`. Acts after the faults that are there already.

        Raises:
            RenetError: a physical fault for a camera whose world cannot carry it out.
        """
        self._add(injection, range(self._num_robots) if rows is None else rows, len(self._stages))

    def clear(self) -> None:
        """Heal every camera at once: PX4's `ok`."""
        self._stages = []

    def at_work(self, step: int) -> np.ndarray:
        """[n] bool: the robots whose camera is failing at a control step."""
        failing = np.zeros(self._num_robots, bool)
        for injection, fault, rows in self._stages:
            failing[rows] |= 0 <= injection.elapsed(step) < fault.lasts
        return failing

    def view(self, step: int) -> View:
        """How the cameras see their scene at a control step."""
        view = View.true(self._num_robots)
        for injection, fault, rows in self._stages:
            if isinstance(fault, PhysicalFault) and injection.elapsed(step) >= 0:
                fault.bend(view, rows)
        return view

    def apply(self, frames: Frames, step: int) -> Frames:
        """The frames after every fault at work at this control step; call once per vision tick."""
        frames = frames.copy()
        for injection, fault, rows in self._stages:
            time = injection.elapsed(step)
            time = time if time < fault.lasts else -1.0
            spoilt = fault.corrupt(frames.rows(rows), np.full(len(rows), time))
            if time >= 0:
                frames.write(rows, spoilt)
        return frames


VERBS = {
    "off": "unplugged",
    "stuck": "frozen",
    "garbage": "gaussian",
    "wrong": "wrong_scale",
    "slow": "dropped",
    "delayed": "latency",
    "intermittent": "unplugged",
}
"""PX4's failure injection verbs, and the fault each one is for a depth camera."""


def injection_of_verb(
    verb: str, severity: int = 5, onset: int = 0, sensor: str = "depth"
) -> Injection:
    """The injection a failure verb asks for; refuses what no fault model stands for.

    Args:
        verb: one of `VERBS`.
        severity: 1 to 5. `intermittent`: the share of every 2 s without frames, in steps of 15 %.
        onset: control step.
        sensor: only "depth" can fail.

    Raises:
        RenetError: unknown verb, or a sensor that has no fault models.
    """
    if sensor != "depth":
        raise RenetError(f"failure '{verb}' of sensor '{sensor}': only 'depth' can be made to fail")
    if verb not in VERBS:
        raise RenetError(f"unknown failure verb '{verb}': choose one of {', '.join(VERBS)}")
    injection = Injection.of(VERBS[verb], severity, onset)
    if verb == "intermittent":
        return Injection("unplugged", FOREVER, onset, duration=0.3 * severity, period=2.0)
    return injection
