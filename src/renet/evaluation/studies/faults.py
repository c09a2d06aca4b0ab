"""The fault study: every camera fault on every ground, in every mode (docs/measure.md).

Faults begin on the way to an obstacle and shortly before its edge, and end before the run
does, so that leaving vision and returning to it are both measured. One fault is one batch of
robots, each with a twin in a batch without faults. Falls are judged by true poses.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from itertools import chain, product
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from matplotlib.figure import Figure

from renet.errors import RenetError
from renet.evaluation import figures, metrics
from renet.evaluation.monitor_log import MonitorLog, healthy_series, replay_selector
from renet.evaluation.results import group_by, select
from renet.evaluation.rollout import Trial, robot_numbers
from renet.evaluation.settings import FLAT_GROUND, check_grounds
from renet.evaluation.studies import fault_metrics
from renet.evaluation.studies.fault_findings import findings
from renet.evaluation.studies.fault_settings import FAULT_GROUNDS, LISTED, ONSETS, Setting
from renet.evaluation.study import Figures, MakeEnv, Part, Table, WalkingStudy
from renet.evaluation.trace import Trace
from renet.faults import SEVERITIES, fault_class
from renet.faults.physical import Glass
from renet.interface import CONTROL_DT, STEPS_PER_TICK, Terrain, control_steps
from renet.selector.calibration import decluster, lowest_in_a_row
from renet.selector.monitors import MONITORS

if TYPE_CHECKING:
    from renet.evaluation.env import SimEnv
    from renet.evaluation.evaluator import Evaluator

HEALTHY_ROBOTS = 64
"""Largest number of robots side by side in the run without faults."""
SIDE_BY_SIDE = 400
"""Largest number of robots of several faults side by side; beyond it no time is saved per robot."""
Rows = Mapping[tuple[Any, str], dict[str, Any]]
"""Rows of a part, by setting or ground, and mode."""


@dataclass(frozen=True)
class FaultStudy(WalkingStudy):
    """Inject every camera fault on several grounds, in every mode.

    `--preset noise` is the paper's noise figure: modes camera and memory under six noises.
    """

    out: Path = Path("results/faults")
    """Folder for summary.md, summary.json, summary.csv, figures and parts/."""
    faults: tuple[str, ...] = LISTED
    """Faults to inject: NAME at all severities, or NAME:SEVERITY; by default 29 of them."""
    severities: tuple[int, ...] = SEVERITIES
    """Severities of faults that name none, 1 to 5."""
    grounds: tuple[Terrain, ...] = tuple(FAULT_GROUNDS)
    """Kinds of ground. Flat ground alone is endless; beside others it is a tile of their size."""
    level: int | None = None
    """Level of all tiles, 1 to 10; by default one for each ground (docs/measure.md)."""
    onsets: tuple[float, ...] = tuple(ONSETS)
    """Times at which faults begin, s; on flat ground only the first."""
    lasts: float = 4.0
    """Longest duration of a fault, s."""
    seconds: float = 10.0
    """Longest run, s; it ends when every robot has left its tile or fallen."""
    healthy_minutes: float = 80.0
    """Robot minutes on flat ground with a healthy camera, in which false switches are counted."""

    name: ClassVar[str] = "faults"
    selectable: ClassVar[tuple[str, ...]] = ("faults",)
    retires: ClassVar[bool] = True
    """True to stop simulating robots whose first try is over."""

    def __post_init__(self) -> None:
        # Raises for faults and severities that are unknown.
        for settings in self.batches.values():
            for setting in settings:
                _ = setting.level
        super().__post_init__()
        if not self.vision_modes:
            raise RenetError(f"modes {self.modes}: no camera fault matters to blind, add a mode")
        if not any(self.batches.values()):
            raise RenetError("give a fault, a severity, a ground and an onset that fit together")
        if self.lasts <= 0 or self.healthy_minutes < 0:
            raise RenetError(
                f"lasts {self.lasts} must be positive, healthy minutes {self.healthy_minutes} >= 0"
            )
        if min(self.onsets) < CONTROL_DT or max(self.onsets) + self.lasts > self.seconds + 1e-6:
            raise RenetError(
                f"{CONTROL_DT} <= onsets {self.onsets}, and + lasts {self.lasts} <= seconds"
                f" {self.seconds}, must hold"
            )
        check_grounds(self.levels)

    @property
    def levels(self) -> dict[str, int]:
        """Level of each ground."""
        levels = FAULT_GROUNDS if self.level is None else dict.fromkeys(self.grounds, self.level)
        return {ground: levels.get(ground, FAULT_GROUNDS["obstacles"]) for ground in self.grounds}

    @property
    def batches(self) -> dict[str, list[Setting]]:
        """Settings that run side by side, by the name of their part."""
        batches = {}
        for text in self.faults:
            fault, _, severity = text.partition(":")
            if severity and not severity.isdecimal():
                raise RenetError(f"cannot read the fault {text!r}: write NAME or NAME:SEVERITY")
            if severity:
                severities: tuple[int, ...] = (int(severity),)
            else:
                # `quick` takes the most severe one.
                severities = tuple(sorted(self.severities))[-1:] if self.quick else self.severities
            settings = self._settings_of(fault, severities)
            if settings:
                batches[text.replace(":", "_")] = settings
        return batches

    def _settings_of(self, fault: str, severities: Sequence[int]) -> list[Setting]:
        """Return the settings of one fault, by ground, onset and severity."""
        settings = []
        for ground in self.grounds:
            # Glass needs obstacles that can be glass.
            if fault == Glass.name and ground not in Glass.terrains:
                continue
            for onset, severity in product(self.onsets_on(ground), severities):
                settings.append(Setting(ground, onset, fault, severity))
        return settings

    def onsets_on(self, ground: str) -> tuple[float, ...]:
        """Return the times at which faults begin on a ground, s."""
        # Flat ground has no edge; `quick` takes the onset before it elsewhere.
        if ground == FLAT_GROUND:
            return self.onsets[:1]
        return self.onsets[-1:] if self.quick else self.onsets

    @property
    def least_steps(self) -> int:
        """Control steps after which a run ends as soon as all first tries are over."""
        return control_steps(max(self.onsets) + self.lasts) + STEPS_PER_TICK

    @property
    def vision_modes(self) -> list[str]:
        """Modes that use the camera; a blind robot walks as its twin does."""
        return [mode for mode in self.modes if mode != "blind"]

    def groups(self, settings: Sequence[Setting]) -> list[tuple[Setting, str]]:
        """Return the setting and mode of each group of robots in a batch."""
        return list(product(settings, self.vision_modes))

    def trials(self, settings: Sequence[Setting]) -> list[Trial]:
        """Return the trials of every robot of a batch, group by group."""
        trials = []
        for setting, mode in self.groups(settings):
            trials += self.trial_group(mode, (setting.injection(self.lasts),), setting.ground)
        return trials

    def make_env(self, evaluator: Evaluator, robots: tuple[int, ...]) -> SimEnv:
        """Make an environment for robots of these numbers, not yet on their grounds."""
        task = FLAT_GROUND if self.grounds == (FLAT_GROUND,) else self.levels
        return evaluator.make_env(task, robots, self.speed, self.seed)

    def walk(
        self, evaluator: Evaluator, env: Any, trials: Sequence[Trial], title: str, **options: Any
    ) -> Trace:
        """Run trials, each on its ground, until all first tries are over."""
        options |= {"until_ended": self.least_steps, "retire": self.retires}
        return super().walk(evaluator, env, trials, title, **options)

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """Return one part for each fault, one without faults, and one of healthy walking."""
        # Batches of the same robots share an environment, and faults of a group share a run.
        make_env = cache(partial(self.make_env, evaluator))
        parts: dict[str, Callable[[], Part]] = {}
        for names in self._fault_groups():
            walk = cache(partial(self._run_faults, evaluator, make_env, names))
            for name in names:
                parts[name] = partial(_part_of, walk, name)
        parts["no_fault"] = partial(self._run_twins, evaluator, make_env)
        if self.healthy_minutes > 0:
            parts["healthy"] = partial(self._run_healthy, evaluator)
        return parts

    def part_groups(self, names: Sequence[str]) -> list[list[str]]:
        """Group faults that walk side by side; each other part is a group of its own."""
        others = [[name] for name in names if name not in self.batches]
        return self._fault_groups() + others

    def _fault_groups(self) -> list[list[str]]:
        """Group the names of the faults' parts by at most `SIDE_BY_SIDE` robots, or one fault.

        All faults of a group begin with the same ground, for the position of a robot's first twin
        determines how the starts of the others are rounded.
        """
        groups: list[list[str]] = []
        ground = ""
        robots = 0
        for name, settings in self.batches.items():
            count = len(self.trials(settings))
            if settings[0].ground == ground and robots + count <= SIDE_BY_SIDE:
                groups[-1].append(name)
                robots += count
            else:
                groups.append([name])
                ground = settings[0].ground
                robots = count
        return groups

    def _run_faults(
        self, evaluator: Evaluator, make_env: MakeEnv, names: Sequence[str]
    ) -> dict[str, Part]:
        """Walk all settings and modes of some faults side by side; returns each fault's part."""
        trials = {name: self.trials(self.batches[name]) for name in names}
        everybody = list(chain(*trials.values()))
        title = f"{list(self.batches).index(names[-1]) + 1}/{len(self.batches)} {names[-1]}"
        env = make_env(tuple(robot_numbers(everybody)))
        trace = self.walk(evaluator, env, everybody, title)
        # What mode switch would have answered to the same images.
        paper = replay_selector(evaluator.make_selector("switch", len(everybody)), trace.anomaly)
        parts = {}
        start = 0
        for name, group in trials.items():
            rows = slice(start, start + len(group))
            parts[name] = self._fault_part(name, trace.robots(rows), paper[..., rows])
            start += len(group)
        return parts

    def _fault_part(self, name: str, trace: Trace, paper: np.ndarray) -> Part:
        """Make the part of one fault.

        Args:
            name: Name of the part.
            trace: Trace of its robots, [T, N].
            paper: Answers of the paper's selector, [T, U, N].
        """
        each = self.robots_each
        runs = []
        for number, (setting, _) in enumerate(self.groups(self.batches[name])):
            rows = slice(number * each, (number + 1) * each)
            over = setting.step + control_steps(self.lasts)
            end = fault_metrics.end_of(setting, over)
            group = trace.robots(rows)
            run = fault_metrics.survival(group, over)
            run |= fault_metrics.noticing(group, paper[..., rows], setting.step, end)
            run["values"] = self.measures(group, setting.step)
            runs.append(run)
        return {"runs": runs} | self.curves(trace, self.vision_modes)

    def measures(self, trace: Trace, onset: int) -> dict[str, np.ndarray]:
        """Measure each robot, [N] each, from a control step on."""
        return fault_metrics.robot_measures(trace, onset, self.speed, self.steps)

    def curves(self, trace: Trace, modes: Sequence[str]) -> Part:
        """Return further contents of a batch's part, for presets; `modes` are its robots' modes."""
        return {}

    def _run_twins(self, evaluator: Evaluator, make_env: MakeEnv) -> Part:
        """Walk the twins of all faults' robots, with cameras that never fail."""
        each = self.robots_each
        trials = self.trials_on(self.grounds)
        env = make_env(tuple(robot_numbers(trials)))
        trace = self.walk(evaluator, env, trials, "no fault")
        runs = []
        until = control_steps(max(self.onsets) + self.lasts)
        for trial, group in zip(trials[::each], trace.groups(each), strict=True):
            level = self.levels[trial.ground]
            labels = {"mode": trial.mode, "ground": trial.ground, "ground_level": level}
            values = {}
            for onset in self.onsets:
                values[str(onset)] = self.measures(group, control_steps(onset))
            runs.append(labels | fault_metrics.survival(group, until) | {"values": values})
        # False switches are counted on the first ground in mode memory only: with healthy cameras
        # the robots of the other modes walk alike, and would count again.
        first = self.modes.index("memory") if "memory" in self.modes else 0
        simple = trace.robots(slice(first * each, (first + 1) * each))
        return {
            "runs": runs,
            "false_switches": metrics.false_switches(simple.trusted, simple.over),
            "healthy_robot_hours": metrics.healthy_hours(simple.over),
        } | self.curves(trace, self.modes)

    def _run_healthy(self, evaluator: Evaluator) -> Part:
        """Walk in mode memory with healthy cameras, where leaving vision is a false switch."""
        minutes = self.healthy_minutes / (4 if self.quick else 1)
        robots = min(HEALTHY_ROBOTS, max(1, round(minutes)))
        steps = max(control_steps(60 * minutes / robots), STEPS_PER_TICK)
        # Robots that neither the calibration nor the faults had.
        seed = self.seed + 1000
        env = evaluator.make_env(FLAT_GROUND, range(robots), self.speed, seed)
        trials = [Trial("memory", (), robot) for robot in range(robots)]
        rollout = evaluator.rollout(env, trials, seed)
        log = MonitorLog(robots)
        rollout.on_update = log
        trace = rollout.run(steps, "healthy cameras")
        series = healthy_series(log, trace)
        alarms = {}
        for name, threshold in evaluator.thresholds.items():
            # A score that equals the threshold is an alarm, too.
            below = np.nextafter(threshold, -np.inf)
            # Some monitors need several scores in a row.
            needed = MONITORS[name].in_a_row
            lowest = [lowest_in_a_row(run, needed) for run in series[name]]
            alarms[name] = sum(len(decluster(run, below)) for run in lowest)
        return {
            "false_switches": metrics.false_switches(trace.trusted, trace.failing),
            "robot_hours": metrics.healthy_hours(trace.failing),
            "alarms": alarms,
        }

    def summarise(self, parts: Mapping[str, Part], evaluator: Evaluator) -> dict[str, Any]:
        """Compare the rows with their twins, and find harmful and missed settings."""
        twins = {(run["ground"], run["mode"]): run for run in parts["no_fault"]["runs"]}
        runs = []
        for name, settings in self.batches.items():
            rows = dict(zip(self.groups(settings), parts[name]["runs"], strict=True))
            for setting, mode in product(settings, self.modes):
                runs.append(self._row(setting, mode, rows, twins))
        # Without a fault a robot is its own twin.
        first = str(self.onsets[0])
        baseline = []
        for run in twins.values():
            values = run["values"][first]
            baseline.append(run | {"measures": fault_metrics.estimates(values, values)})
        by_robot = fault_metrics.by_robot(runs)
        # The values of single robots are too long for a summary.
        for run in [*runs, *baseline]:
            del run["values"]
        healthy = _healthy_walks(parts["no_fault"], parts.get("healthy", {}))
        return {
            "runs": runs,
            "by_robot": by_robot,
            "baseline": baseline,
            **findings(runs, baseline, healthy),
            "healthy": healthy,
            "beta": evaluator.beta,
            "robots": self.robots_each,
        }

    def _row(self, setting: Setting, mode: str, runs: Rows, twins: Rows) -> dict[str, Any]:
        """Make the row of a setting in one mode, compared with its twins.

        Args:
            setting: The setting.
            mode: The mode.
            runs: Rows of the fault's part, by setting and mode.
            twins: Rows without faults, by ground and mode.
        """
        twin = twins[setting.ground, mode]
        onset = str(setting.onset)
        twin_values = twin["values"][onset]
        measured: dict[str, Any] | None = runs.get((setting, mode))
        if measured is None:
            # Mode blind, which a fault does not change: the row is the twins'.
            measured = dict.fromkeys(next(iter(runs.values())))
            measured |= {"detected": 0, "detected_by_paper": 0, "vision_active_at_onset": 0}
            measured |= twin | {"values": twin_values}
        row = {
            "fault": setting.fault,
            "severity": setting.severity,
            "level": setting.level,
            "unit": fault_class(setting.fault).unit,
            "ground": setting.ground,
            "ground_level": self.levels[setting.ground],
            "onset": setting.onset,
            "mode": mode,
            "seed": self.seed,
            **measured,
        }
        values = row["values"]
        # Mode memory is compared with mode blind on the same ground.
        blind = twins.get((setting.ground, "blind"))
        beside = blind["values"][onset] if blind is not None and mode == "memory" else None
        row |= fault_metrics.pair_counts(values, twin_values)
        row |= fault_metrics.beside_op(values, beside)
        row["measures"] = fault_metrics.estimates(values, twin_values)
        return row

    def draw(self, summary: dict[str, Any], parts: Mapping[str, Part]) -> Figures:
        """Draw crossed.png, survival.png and detection.png."""
        runs = summary["runs"]
        modes = {mode: select(runs, mode=mode) for mode in self.modes}
        # Only robots in mode memory obey the monitors; without that mode, all rows are shown.
        rows = modes.get("memory") or runs
        detection = {
            "monitors of mode memory": _noticed_cells(rows, "detected"),
            "rule of mode switch": _noticed_cells(rows, "detected_by_paper"),
        }
        return {
            "crossed.png": crossed_table(modes),
            "survival.png": figures.colour_tables(
                _mode_panels(modes, itemgetter("survival"), "severity"),
                "Robots on their feet (%), all grounds and onsets together",
                "severity",
            ),
            "detection.png": figures.colour_tables(
                detection,
                "Robots with vision that noticed the fault while it lasted (%)",
                "severity",
            ),
        }

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Tabulate robots that crossed, the claims, and harmful and missed settings."""
        crossed: list[tuple[Any, ...]] = []
        for place, runs in group_by(summary["runs"], "ground", "fault").items():
            row = list(place)
            for mode in self.modes:
                shares = list(map(_crossed, select(runs, mode=mode)))
                row.append(f"{100 * np.mean(shares):.0f}")
            crossed.append(tuple(row))
        claims: list[tuple[Any, ...]] = []
        for claim in summary["claims"]:
            claims.append(("yes" if claim["met"] else "NO", claim["claim"], claim["measured"]))
        harmful: list[tuple[Any, ...]] = []
        for finding in select(summary["harmful"], beyond_chance=True):
            shares = (f"{100 * finding['memory']:.0f}", f"{100 * finding['blind']:.0f}")
            harmful.append((figures.setting_label(finding), *shares))
        missed: list[tuple[Any, ...]] = []
        for finding in select(summary["missed"], beyond_chance=True):
            counts = (finding["undetected"], finding["vp_falls"], finding["vp_spared"])
            missed.append((figures.setting_label(finding), *counts))
        tables: list[Table] = [
            ("Robots that cross (%)", ("ground", "fault", *self.modes), crossed),
        ]
        if claims:
            title = "What is claimed, and what was measured"
            tables.append((title, ("met", "claim", "measured"), claims))
        if harmful:
            title = "On their feet (%): fewer in mode memory than blind, beyond chance"
            tables.append((title, ("setting", "memory", "blind"), harmful))
        if missed:
            title = "Faults that robots do not notice, and that make mode camera fall beyond chance"
            header = ("setting", "do not notice", "fall by it in camera", "spared")
            tables.append((title, header, missed))
        return tables


def _part_of(walk: Callable[[], Mapping[str, Part]], name: str) -> Part:
    """Return the part of one fault of a group that walks together."""
    return walk()[name]


def _healthy_walks(no_fault: Part, healthy: Part) -> dict[str, Any]:
    """Add up false switches with healthy cameras, of the faults' twins and of further walks."""
    # The time before the faults is the same in all batches, so it counts once, in the twins' batch.
    hours = no_fault["healthy_robot_hours"] + healthy.get("robot_hours", 0)
    switches = no_fault["false_switches"] + healthy.get("false_switches", 0)
    return {
        "false_switches": switches,
        "robot_hours": hours,
        "false_switches_per_hour": switches / hours if hours else math.nan,
        "upper_95_per_hour": metrics.poisson_upper(switches) / hours if hours else math.nan,
        "alarms_by_monitor": healthy.get("alarms", {}),
    }


def crossed_table(modes: Mapping[str, list[dict[str, Any]]]) -> Figure:
    """Draw a coloured table of the robots that cross, by fault and ground; rows are by mode."""
    title = "Robots that cross (%), all severities and onsets together"
    panels = _mode_panels(modes, _crossed, "ground")
    return figures.colour_tables(panels, title, width=0.34, rotation=90)


def _crossed(run: dict[str, Any]) -> float:
    """Return the share of a row's robots that crossed."""
    return run["measures"]["crossed"]["value"]


def _noticed_cells(runs: list[dict[str, Any]], name: str) -> figures.Cells:
    """Return shares of the robots that see that noticed a fault; `name` is their count's column."""
    return figures.mean_cells(
        runs, lambda run: run[name] / (run["vision_active_at_onset"] or np.nan)
    )


def _mode_panels(
    modes: Mapping[str, list[dict[str, Any]]], share: Callable[[Any], float], heading: str
) -> Mapping[str, figures.Cells]:
    """Return the cells of a share for each mode, with mode blind as a row of the others' tables.

    Args:
        modes: Rows of a summary by mode.
        share: Share of a row.
        heading: Column of the rows whose values are the cells' headings.
    """
    tables = {}
    for mode, runs in modes.items():
        tables[mode] = dict(figures.mean_cells(runs, share, heading))
    if "blind" not in modes or len(modes) == 1:
        return tables
    # Mode blind sees no fault: it needs one row only, at the foot of the others' tables, in which
    # its walk on a ground counts once, however many faults are studied there.
    del tables["blind"]
    walks = {}
    for run in modes["blind"]:
        place = (run["ground"], run["onset"], run[heading])
        walks[place] = run | {"fault": "blind, any fault"}
    row = figures.mean_cells(list(walks.values()), share, heading)
    for table in tables.values():
        table.update(row)
    return tables
