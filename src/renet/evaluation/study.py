"""Base of all studies, from the settings to the written results.

A subclass defines what it varies (its fields), what it measures (`parts` and `summarise`) and its
figures and tables (`draw` and `tables`). This module runs it, continues after an interruption, and
writes `summary.json`, `summary.csv`, figures and `summary.md` with their provenance.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias, get_args

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from renet.errors import RenetError, demand_name
from renet.evaluation import figures
from renet.evaluation.jobs import make_parts
from renet.evaluation.results import (
    PartMaker,
    Provenance,
    Table,
    output_folder,
    plain,
    table_rows,
    write_csv,
    write_json,
    write_summary,
)
from renet.evaluation.rollout import Trial
from renet.evaluation.settings import (
    FLAT_GROUND,
    Conditions,
    StudyMode,
    check_finite,
    check_modes,
    check_once,
    check_speed,
)
from renet.evaluation.trace import Trace
from renet.faults import FaultSchedule
from renet.interface import CONTROL_DT, Engine, control_steps
from renet.motor_models import IDEAL, motors_key
from renet.terminal import ProgressLog, show

if TYPE_CHECKING:
    from renet.evaluation.env import SimEnv
    from renet.evaluation.evaluator import Evaluator

Part = dict[str, Any]
"""Measures of one batch of robots; JSON after `plain`."""
Figures = Mapping[str, Figure]
"""Figures by file name, such as "noise.png"."""
MakeEnv: TypeAlias = "Callable[[tuple[int, ...]], SimEnv]"
"""Function that makes an environment for robots of these numbers."""
_PROCESS_SETTINGS = ("jobs", "shard")
"""Settings that no result depends on."""


class MissingParts(RenetError):
    """Raised after a shard has made its parts while parts of other shards are missing."""


@dataclass(frozen=True)
class Study:
    """Base of studies, with the settings that all of them have."""

    out: Path = Path("results/study")
    """Folder for summary.md, summary.json, summary.csv, figures and parts/."""
    bundle: Path | None = None
    """Bundle folder, or the name of one that ships: go1-parkour (the default), go1-driven,
    go2-parkour, go2-driven; or hf://OWNER/NAME on the Hugging Face Hub."""
    quick: bool = False
    """Take fewer robots and settings."""
    seed: int = 1
    """Seed of the robots' bodies and starts and of the camera faults."""
    engine: Engine = "auto"
    """Physics engine, on the CPU; auto: native."""
    conditions: Conditions = "training"
    """Conditions of the robots. training: those of the bundle's training, with differences between
    motors, joints and mounts, late images, sensor noise and pushes; nominal: hardly any of them."""
    motors: str = IDEAL
    """Motors of the robots. ideal: MuJoCo's servos. go1: a network of a real Go1's motors. Or a
    file of `renet identify`."""
    jobs: int = 1
    """Number of processes that make the study's parts, each with its share of the processors."""
    shard: str | None = None
    """I/N, such as 1/2: make only the I-th of N shares of the parts, for several computers. With
    all shares in one folder parts/, the command without --shard writes the results."""

    name: ClassVar[str]
    """Name of the study, and of its folder in the results."""
    selectable: ClassVar[tuple[str, ...]] = ()
    """Settings that select which parts are made, and that no part's numbers depend on."""
    unused: ClassVar[tuple[str, ...]] = ()
    """Settings of other studies that this one has no use for; it refuses other values than their
    defaults, and the command line refuses the options."""

    def __post_init__(self) -> None:
        if useless := self.changed(self.unused):
            raise RenetError(f"the study {self.name} has no use for {useless}: leave it out")
        check_finite(self)
        check_once(self)
        demand_name("conditions", self.conditions, get_args(Conditions))
        if self.jobs < 1:
            raise RenetError(f"jobs must be at least 1, got {self.jobs}")
        # Raises for a shard that is not I/N.
        _ = self.shard_slice

    @property
    def shard_slice(self) -> slice:
        """Slice of the groups of parts that this process makes."""
        if self.shard is None:
            return slice(None)
        number, _, count = self.shard.partition("/")
        if not (number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
            raise RenetError(f"shard {self.shard!r}: write I/N, such as 1/2 and 2/2")
        return slice(int(number) - 1, None, int(count))

    def changed(self, names: Sequence[str]) -> str:
        """Name the options among these settings that are not at their defaults, in words."""
        defaults = {field.name: field.default for field in fields(self)}
        options = []
        for name in names:
            if getattr(self, name) != defaults[name]:
                options.append(f"--{name.replace('_', '-')}")
        return " and ".join(options)

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """Return the function that runs each batch of robots, by the name of the batch's part."""
        raise NotImplementedError

    def part_groups(self, names: Sequence[str]) -> list[list[str]]:
        """Return the names of the parts in groups, each of which one process makes.

        By default every part is a group. A study groups parts whose robots walk side by side.
        """
        return [[name] for name in names]

    def summarise(self, parts: Mapping[str, Part], evaluator: Evaluator) -> dict[str, Any]:
        """Return the summary's content beside settings and provenance; `runs` is its list of rows.

        By default there is nothing else, and the rows are the rows of all parts, in order.
        """
        runs = []
        for part in parts.values():
            runs += part["runs"]
        return {"runs": runs}

    def draw(self, summary: dict[str, Any], parts: Mapping[str, Part]) -> Figures:
        """Draw the figures of a summary, by file name, which `run` saves; none by default."""
        return {}

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Make the tables of a summary, for the command line and summary.md."""
        raise NotImplementedError

    def make_evaluator(self) -> Evaluator:
        """Make the evaluator of the settings' bundle and conditions."""
        from renet.evaluation.evaluator import Evaluator

        return Evaluator(self.bundle, self.engine, self.conditions, self.motors)

    def file_digests(self) -> dict[str, str]:
        """Return hashes of the files that settings name, by the setting, for parts' keys."""
        return {"motors": motors_key(self.motors)}

    def part_maker(self, evaluator: Evaluator | None = None) -> PartMaker:
        """Make the maker of the study's parts; the evaluator is the settings' by default."""
        evaluator = evaluator or self.make_evaluator()
        provenance = evaluator.provenance(self.seed)
        # Numbers depend on the study, on all settings but these, and on the bundle and the code.
        free = {"out", "bundle", *_PROCESS_SETTINGS, *self.selectable}
        key = {name: value for name, value in asdict(self).items() if name not in free}
        # Presets of a study have the same settings.
        key["study"] = self.name
        # A given evaluator has conditions of its own.
        key["conditions"] = evaluator.conditions
        for name in ("bundle_hash", "renet_version", "commit"):
            key[name] = getattr(provenance, name)
        key["training_sha256"] = evaluator.training_sha256
        # A file's content counts, not its name.
        key |= self.file_digests()
        key["policy"] = type(evaluator).make_policy.__qualname__
        folder = output_folder(output_folder(self.out) / "parts")
        return PartMaker(folder, key, self.parts(evaluator))

    def run(self, evaluator: Evaluator | None = None) -> dict[str, Any]:
        """Run the parts that are missing, write the results to `out` and return the summary.

        Args:
            evaluator: Evaluator of the policy, whose own conditions hold; made from the settings by
                default.

        Raises:
            RenetError: The bundle cannot be used, the folder cannot be written to, or a kept part
                is damaged.
            MissingParts: This shard is made, and others are not.
        """
        # An evaluator cannot be sent to another process.
        if evaluator is not None and self.jobs > 1:
            raise RenetError("each of several jobs makes its evaluator: override make_evaluator")
        evaluator = evaluator or self.make_evaluator()
        make = self.part_maker(evaluator)
        # A damaged part is told before hours go into the others.
        make.check_kept()
        self._make_shard(make)
        if missing := make.missing(make.makers):
            raise MissingParts(
                f"shard {self.shard} is made; {len(missing)} of {len(make.makers)} parts are"
                f" missing in {make.folder}: make the other shards there, or copy their parts"
                " there, then give the command without --shard"
            )
        parts = {name: make(name) for name in make.makers}
        provenance = evaluator.provenance(self.seed)
        summary = self._summary(parts, evaluator, provenance)
        self._write(summary, parts, provenance)
        return summary

    def _summary(
        self, parts: Mapping[str, Part], evaluator: Evaluator, provenance: Provenance
    ) -> dict[str, Any]:
        """Make the summary with settings and provenance, in JSON's types."""
        summary: dict[str, Any] = {"study": self.name}
        summary |= self.summarise(parts, evaluator)
        settings = asdict(self)
        for name in _PROCESS_SETTINGS:
            del settings[name]
        settings["conditions"] = evaluator.conditions
        summary |= {"settings": settings, "provenance": vars(provenance)}
        return plain(summary)

    def _write(
        self, summary: dict[str, Any], parts: Mapping[str, Part], provenance: Provenance
    ) -> None:
        """Write the summary's files and figures to `out`."""
        write_json(self.out / "summary.json", summary)
        write_csv(self.out / "summary.csv", table_rows(summary["runs"]))
        # matplotlib makes ticks when a figure is saved: the style must hold until then.
        with plt.rc_context(figures.STYLE):
            drawings = self.draw(summary, parts)
            for name, figure in drawings.items():
                figures.save_figure(figure, self.out / name, provenance)
        tables = self.tables(summary)
        write_summary(self.out / "summary.md", self.name, tables, list(drawings), provenance)

    def _make_shard(self, make: PartMaker) -> None:
        """Make the missing parts of this shard, or of the whole study without shards."""
        groups = []
        for group in self.part_groups(list(make.makers))[self.shard_slice]:
            names = make.missing(group)
            if names:
                groups.append(names)
        # More jobs than groups would have nothing to do.
        jobs = min(self.jobs, len(groups))
        if jobs > 1:
            make_parts(self.part_maker, groups, jobs)
            return
        log = ProgressLog(sum(map(len, groups)))
        for names in groups:
            with log.making(len(names)):
                for name in names:
                    make(name)

    def main(self) -> str | None:
        """Run the study and print its tables, or the number of missing parts after a shard."""
        try:
            summary = self.run()
        except MissingParts as missing:
            print(missing)
        else:
            for table in self.tables(summary):
                show(*table)
        return None


@dataclass(frozen=True)
class WalkingStudy(Study):
    """Base of studies of robots that are commanded to walk straight ahead, in several modes."""

    modes: tuple[StudyMode, ...] = ("camera", "memory", "blind")
    """Policy modes to compare."""
    robots: int = 20
    """Number of robots in each setting and mode; with `quick` a few at most."""
    speed: float = 0.6
    """Commanded forward speed, m/s."""
    seconds: float = 8.0
    """Length of each run, s."""

    quick_robots: ClassVar[int] = 5
    """Largest number of robots in each setting and mode with `quick`."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_modes(self.modes)
        check_speed(self.speed)
        if self.robots < 1:
            raise RenetError(f"robots must be at least 1, got {self.robots}")
        if self.steps < 1:
            raise RenetError(f"seconds must be at least {CONTROL_DT}, got {self.seconds}")

    @property
    def steps(self) -> int:
        """Control steps of a run."""
        return control_steps(self.seconds)

    @property
    def robots_each(self) -> int:
        """Number of robots in each setting and mode, with `quick` taken into account."""
        return min(self.robots, self.quick_robots) if self.quick else self.robots

    def trial_group(
        self, mode: str, schedule: FaultSchedule = (), ground: str = FLAT_GROUND
    ) -> list[Trial]:
        """Return the trials of all robots of one setting in one mode; by default without faults."""
        return [Trial(mode, schedule, robot, ground) for robot in range(self.robots_each)]

    def trials_on(self, grounds: Sequence[str], schedule: FaultSchedule = ()) -> list[Trial]:
        """Return all robots' trials: a group for each mode on each ground, ground by ground."""
        trials = []
        for ground, mode in product(grounds, self.modes):
            trials += self.trial_group(mode, schedule, ground)
        return trials

    def walk(
        self, evaluator: Evaluator, env: Any, trials: Sequence[Trial], title: str, **options: Any
    ) -> Trace:
        """Run trials, each on its ground, for the study's `seconds`.

        Args:
            evaluator: Evaluator of the policy.
            env: Environment of the trials' robots, as `Evaluator.make_env` makes it.
            trials: One for each robot.
            title: Title of the progress.
            options: Further arguments of `Rollout.run`.
        """
        env.place_on([trial.ground for trial in trials])
        rollout = evaluator.rollout(env, trials, self.seed)
        return rollout.run(self.steps, title, **options)
