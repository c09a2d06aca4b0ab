"""Runs a study: what is the same for all of them, from the settings to the written results.

A study says what it varies (its fields), what it measures (`parts` and `summarise`) and how that is
drawn (`draw` and `tables`). Running it, going on after an interruption, and writing
`summary.json`, `summary.csv`, figures and `summary.md` with their provenance is done here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, get_args

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from renet.errors import RenetError, demand_name
from renet.evaluation import figures
from renet.evaluation.jobs import make_parts
from renet.evaluation.results import (
    Table,
    kept,
    output_folder,
    part_path,
    plain,
    write_csv,
    write_json,
    write_summary,
)
from renet.evaluation.rollout import (
    Conditions,
    Mode,
    Trial,
    check_finite,
    check_modes,
    check_speed,
)
from renet.interface import Engine
from renet.motor_models import IDEAL, motors_key
from renet.terminal import show

if TYPE_CHECKING:
    from renet.evaluation.evaluator import Evaluator

Part = dict[str, Any]
"""What is kept of one batch of robots; JSON after `plain`."""
Figures = Mapping[str, Figure]
"""By file name, such as "noise.png"."""
PROCESSES = ("jobs", "shard")
"""Settings on which no result depends."""


class MissingParts(RenetError):
    """A shard's parts are made, and those of other shards are missing."""


@dataclass(frozen=True)
class PartMaker:
    """Makes a study's parts by their names, and keeps them on disk."""

    folder: Path
    key: dict[str, Any]
    """What all parts' numbers depend on."""
    makers: Mapping[str, Callable[[], Part]]

    def missing(self, names: Iterable[str]) -> list[str]:
        """Those of the names whose part is not on disk."""
        return [name for name in names if not part_path(self.folder, name, self.key).exists()]

    def __call__(self, name: str) -> Part:
        """A part, read from disk or made now; raises as `kept`."""
        return kept(self.folder, name, self.key, self.makers[name])


@dataclass(frozen=True)
class Study:
    """Settings that every study has; a subclass is one study."""

    out: Path = Path("results/study")
    """Folder for summary.md, summary.json, summary.csv, figures and parts/."""
    bundle: Path | None = None
    """Bundle folder, or the name of one that ships: go1-parkour (the default), go2-parkour; or
    hf://OWNER/NAME on the Hugging Face Hub."""
    quick: bool = False
    """Fewer robots and settings instead."""
    seed: int = 1
    """Seed of the robots' bodies and starts and of the camera faults."""
    engine: Engine = "auto"
    """Physics engine, on the CPU; auto: native."""
    conditions: Conditions = "nominal"
    """What robots meet. training: the differences between motors, joints and mounts, late images,
    noise of sensors and pushes of the bundle's training; nominal: hardly any of them."""
    motors: str = IDEAL
    """Motors of the robots. ideal: MuJoCo's servos. go1: a network of a real Go1's motors. Or a
    file of `renet identify`."""
    jobs: int = 1
    """Processes that make the study's parts, each with its share of the processors."""
    shard: str | None = None
    """I/N, such as 1/2: make only the I-th of N shares of the parts, for several computers. With
    all shares in one folder parts/, the command without --shard writes the results."""

    name: ClassVar[str]
    """Name of the study, and of its folder in the results."""
    selectable: ClassVar[tuple[str, ...]] = ()
    """Settings on which no part's result depends: they select which parts are made."""

    def __post_init__(self) -> None:
        check_finite(self)
        demand_name("conditions", self.conditions, get_args(Conditions))
        if self.jobs < 1:
            raise RenetError(f"jobs must be at least 1, got {self.jobs}")
        _ = self.share

    @property
    def share(self) -> slice:
        """The groups of parts to make, of the list of all."""
        if self.shard is None:
            return slice(None)
        number, _, count = self.shard.partition("/")
        if not (number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
            raise RenetError(f"shard {self.shard!r}: write I/N, such as 1/2 and 2/2")
        return slice(int(number) - 1, None, int(count))

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """Batches of robots by name, each kept on disk once it has run."""
        raise NotImplementedError

    def together(self, names: Sequence[str]) -> list[list[str]]:
        """The parts' names in groups that one process makes one after the other.

        By default each is alone. A study groups parts whose robots walk side by side.
        """
        return [[name] for name in names]

    def summarise(self, parts: Mapping[str, Part], evaluator: Evaluator) -> dict[str, Any]:
        """The summary's content beside settings and provenance; `runs` is its list of rows."""
        raise NotImplementedError

    def draw(self, summary: dict[str, Any], parts: Mapping[str, Part]) -> Figures:
        """Figures of a summary by their file's name, which `run` saves; none by default."""
        return {}

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Tables of a summary, for the command line and summary.md."""
        raise NotImplementedError

    def make_evaluator(self) -> Evaluator:
        """The evaluator of the settings' bundle and conditions."""
        from renet.evaluation.evaluator import Evaluator

        return Evaluator(self.bundle, self.engine, self.conditions, self.motors)

    def file_digests(self) -> dict[str, str]:
        """What stands for settings that name files in the key of parts: the files' contents."""
        return {"motors": motors_key(self.motors)}

    def part_maker(self, evaluator: Evaluator | None = None) -> PartMaker:
        """What makes the study's parts; the evaluator is made from the settings by default."""
        evaluator = evaluator or self.make_evaluator()
        provenance = evaluator.provenance(self.seed)
        free = {"out", "bundle", *PROCESSES, *self.selectable}
        key = {name: value for name, value in asdict(self).items() if name not in free}
        code = ("bundle_hash", "renet_version", "commit")
        key |= {name: getattr(provenance, name) for name in code}
        key |= self.file_digests()
        key["policy"] = type(evaluator).make_policy.__qualname__
        folder = output_folder(output_folder(self.out) / "parts")
        return PartMaker(folder, key, self.parts(evaluator))

    def run(self, evaluator: Evaluator | None = None) -> dict[str, Any]:
        """Run what has not been run yet, write the results to `out` and return the summary.

        The evaluator is made from the settings by default. Raises RenetError for a bundle that
        cannot be used, or a folder that cannot be written to; MissingParts where a shard is made
        and the others are not.
        """
        if evaluator is not None and self.jobs > 1:
            raise RenetError("each of several jobs makes its evaluator: override make_evaluator")
        evaluator = evaluator or self.make_evaluator()
        make = self.part_maker(evaluator)
        self._make_share(make)
        if missing := make.missing(make.makers):
            raise MissingParts(
                f"shard {self.shard} is made; {len(missing)} of {len(make.makers)} parts are"
                f" missing in {make.folder}: make the other shards there, or copy their parts"
                " there, then give the command without --shard"
            )
        parts = {name: make(name) for name in make.makers}
        out, provenance = self.out, evaluator.provenance(self.seed)
        settings = {name: v for name, v in asdict(self).items() if name not in PROCESSES}
        summary = plain(
            {"study": self.name}
            | self.summarise(parts, evaluator)
            | {"settings": settings, "provenance": vars(provenance)}
        )
        write_json(out / "summary.json", summary)
        rows = [
            {k: v for k, v in run.items() if not isinstance(v, (list, dict))}
            for run in summary["runs"]
        ]
        write_csv(out / "summary.csv", rows)
        with plt.rc_context(figures.STYLE):
            drawn = self.draw(summary, parts)
            for name, figure in drawn.items():
                figures.save(figure, out / name, provenance)
        tables = self.tables(summary)
        write_summary(out / "summary.md", self.name, tables, list(drawn), provenance)
        return summary

    def _make_share(self, make: PartMaker) -> None:
        """Make what is missing of this shard's parts, or of all."""
        groups = self.together(list(make.makers))[self.share]
        groups = [names for group in groups if (names := make.missing(group))]
        jobs = min(self.jobs, len(groups))
        if jobs > 1:
            make_parts(self, groups, jobs)
            return
        for name in chain(*groups):
            make(name)

    def main(self) -> None:
        """Run the study and print its tables; of a shard, what is still missing."""
        try:
            summary = self.run()
        except MissingParts as missing:
            print(missing)
            return
        for title, header, rows in self.tables(summary):
            show(title, header, rows)


@dataclass(frozen=True)
class WalkingStudy(Study):
    """A study of robots that are told to walk straight ahead, in several modes."""

    modes: tuple[Mode, ...] = ("camera", "memory", "blind")
    """Policy modes to compare."""
    robots: int = 20
    """Robots in each setting and mode; with `quick` always fewer."""
    speed: float = 0.6
    """Commanded forward speed, m/s."""

    quick_robots: ClassVar[int] = 5

    def __post_init__(self) -> None:
        super().__post_init__()
        check_modes(self.modes)
        check_speed(self.speed)
        if self.robots < 1:
            raise RenetError(f"robots must be at least 1, got {self.robots}")

    @property
    def robots_each(self) -> int:
        """Robots in each setting and mode, after `quick`."""
        return self.quick_robots if self.quick else self.robots

    def trials_on(self, grounds: Sequence[str]) -> list[Trial]:
        """Every robot of every mode on every ground, without faults; a mode's side by side."""
        return [
            Trial(mode, (), robot, ground)
            for ground in grounds
            for mode in self.modes
            for robot in range(self.robots_each)
        ]
