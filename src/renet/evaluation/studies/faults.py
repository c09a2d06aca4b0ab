"""The fault study: every camera fault on every ground, in every mode (docs/measure.md).

Faults begin on the way to an obstacle and half a second before its edge, and end before the run
does, so that leaving vision and returning to it are both measured. One fault is one batch of
robots; each has a twin in a batch without faults. Falls are judged by true poses.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from renet.errors import RenetError
from renet.evaluation import figures, metrics
from renet.evaluation.monitor_log import MonitorLog, healthy_series, replay
from renet.evaluation.results import grouped
from renet.evaluation.rollout import FLAT, Trial, check_grounds
from renet.evaluation.studies import fault_metrics
from renet.evaluation.studies.fault_findings import findings
from renet.evaluation.studies.fault_settings import GROUNDS, LISTED, ONSETS, Setting
from renet.evaluation.study import Figures, Part, Table, WalkingStudy
from renet.evaluation.trace import Trace
from renet.faults import SEVERITIES, fault_class
from renet.faults.physical import Glass
from renet.interface import CONTROL_DT, STEPS_PER_TICK, Terrain
from renet.selector.calibration import decluster

if TYPE_CHECKING:
    from renet.evaluation.env import SimEnv
    from renet.evaluation.evaluator import Evaluator

HEALTHY_ROBOTS = 64
"""Robots side by side in the run without faults."""
SIDE_BY_SIDE = 400
"""Most robots of several faults that walk side by side; more cost no less time each."""
Rows = Mapping[tuple[Any, str], dict[str, Any]]
"""Rows of a part, by setting or ground, and mode."""


@dataclass(frozen=True)
class FaultStudy(WalkingStudy):
    """Every way a depth camera fails, on several grounds, in every mode.

    `--preset noise` is the paper's noise figure: modes camera and memory under six noises.
    """

    out: Path = Path("results/faults")
    """Folder for summary.md, summary.json, summary.csv, figures and parts/."""
    faults: tuple[str, ...] = LISTED
    """Faults to inject: NAME at all severities, or NAME:SEVERITY; by default 29 of them."""
    severities: tuple[int, ...] = SEVERITIES
    """Severities of faults that name none, 1 to 5."""
    grounds: tuple[Terrain, ...] = tuple(GROUNDS)
    """Flat ground alone is endless; beside others it is a tile like theirs."""
    level: int | None = None
    """Level of all tiles, 1 to 10; by default one for each ground (docs/measure.md)."""
    onsets: tuple[float, ...] = tuple(ONSETS)
    """Seconds at which faults begin; on flat ground only the first."""
    lasts: float = 4.0
    """Seconds after which a fault is over at the latest."""
    seconds: float = 10.0
    """Length of each run, at most: it ends when every robot has left its tile or fallen."""
    healthy_minutes: float = 80.0
    """Robot minutes on flat ground with a healthy camera, in which false switches are counted."""

    name: ClassVar[str] = "faults"
    selectable: ClassVar[tuple[str, ...]] = ("faults",)
    retires: ClassVar[bool] = True
    """Whether nothing is measured of a robot whose first try is over."""

    def __post_init__(self) -> None:
        _ = [setting.level for settings in self.batches.values() for setting in settings]
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
        levels = GROUNDS if self.level is None else dict.fromkeys(self.grounds, self.level)
        return {ground: levels.get(ground, GROUNDS["obstacles"]) for ground in self.grounds}

    @property
    def batches(self) -> dict[str, list[Setting]]:
        """Settings that run side by side, by the name of their part."""
        severities = (5,) if self.quick else self.severities
        batches = {}
        for text in self.faults:
            fault, _, severity = text.partition(":")
            if severity and not severity.isdecimal():
                raise RenetError(f"cannot read the fault {text!r}: write NAME or NAME:SEVERITY")
            batches[text.replace(":", "_")] = [
                Setting(ground, onset, fault, number)
                for ground in self.grounds
                # Glass needs obstacles that can be glass.
                if fault != Glass.name or ground in Glass.terrains
                for onset in self.onsets_on(ground)
                for number in ([int(severity)] if severity else severities)
            ]
        return {name: settings for name, settings in batches.items() if settings}

    def onsets_on(self, ground: str) -> tuple[float, ...]:
        """When faults begin: flat ground has no edge, and `quick` takes the onset before it."""
        if ground == FLAT:
            return self.onsets[:1]
        return self.onsets[-1:] if self.quick else self.onsets

    @property
    def steps(self) -> int:
        """Control steps of a run."""
        return round(self.seconds / CONTROL_DT)

    @property
    def vision_modes(self) -> list[str]:
        """Modes that use the camera; a blind robot walks as its twin does."""
        return [mode for mode in self.modes if mode != "blind"]

    def groups(self, settings: Sequence[Setting]) -> list[tuple[Setting, str]]:
        """Setting and mode of each group of robots in a batch."""
        return [(setting, mode) for setting in settings for mode in self.vision_modes]

    def trials(self, settings: Sequence[Setting]) -> list[Trial]:
        """Every robot of a batch, group by group."""
        return [
            Trial(mode, (setting.injection(self.lasts),), robot, setting.ground)
            for setting, mode in self.groups(settings)
            for robot in range(self.robots_each)
        ]

    def make_env(self, evaluator: Evaluator, robots: tuple[int, ...]) -> SimEnv:
        """Robots of these numbers, on no ground yet."""
        task = FLAT if self.grounds == (FLAT,) else self.levels
        return evaluator.make_env(task, robots, self.speed, self.seed)

    def walk(self, evaluator: Evaluator, env: SimEnv, title: str, trials: Sequence[Trial]) -> Trace:
        """Run trials, each on its ground, until all robots are done."""
        if self.grounds != (FLAT,):
            env.place_on([trial.ground for trial in trials])
        least = round((max(self.onsets) + self.lasts) / CONTROL_DT) + STEPS_PER_TICK
        rollout = evaluator.rollout(env, trials, self.seed)
        return rollout.run(self.steps, title, until_ended=least, retire=self.retires)

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """One part for each fault, one without faults, and healthy walking."""
        make = cache(partial(self.make_env, evaluator))
        parts: dict[str, Callable[[], Part]] = {}
        for names in self._fault_groups():
            walk = cache(partial(self._run_faults, evaluator, make, names))
            parts |= {name: partial(_part_of, walk, name) for name in names}
        parts["no_fault"] = partial(self._run_twins, evaluator, make)
        if self.healthy_minutes > 0:
            parts["healthy"] = partial(self._run_healthy, evaluator)
        return parts

    def together(self, names: Sequence[str]) -> list[list[str]]:
        """Faults walk side by side; the other parts are alone."""
        return [*self._fault_groups(), *([name] for name in names if name not in self.batches)]

    def _fault_groups(self) -> list[list[str]]:
        """Names of the faults' parts in groups of at most `SIDE_BY_SIDE` robots, or of one fault.

        In a group, all begin on the same ground: where the first twin of a robot stands decides
        how the starts of the others are rounded.
        """
        groups: list[list[str]] = []
        ground, robots = "", 0
        for name, settings in self.batches.items():
            count = len(self.trials(settings))
            if settings[0].ground == ground and robots + count <= SIDE_BY_SIDE:
                groups[-1].append(name)
                robots += count
            else:
                groups.append([name])
                ground, robots = settings[0].ground, count
        return groups

    def _run_faults(self, evaluator: Evaluator, make: Any, names: Sequence[str]) -> dict[str, Part]:
        """All settings and modes of some faults, side by side; the part of each fault."""
        trials = {name: self.trials(self.batches[name]) for name in names}
        everybody = list(chain(*trials.values()))
        title = f"{list(self.batches).index(names[-1]) + 1}/{len(self.batches)} {names[-1]}"
        env = make(tuple(trial.robot for trial in everybody))
        trace = self.walk(evaluator, env, title, everybody)
        paper = replay(evaluator.make_selector("switch", len(everybody)), trace.anomaly)
        ends = np.cumsum([len(group) for group in trials.values()]).tolist()
        parts = {}
        for name, start, end in zip(names, [0, *ends], ends, strict=False):
            rows = slice(start, end)
            parts[name] = self._fault_part(name, trace.robots(rows), paper[..., rows])
        return parts

    def _fault_part(self, name: str, trace: Trace, paper: np.ndarray) -> Part:
        """The part of one fault, from its robots' trace and what the paper's selector answered."""
        settings, each = self.batches[name], self.robots_each
        runs = []
        for number, (setting, _) in enumerate(self.groups(settings)):
            rows = slice(number * each, (number + 1) * each)
            over = setting.step + round(self.lasts / CONTROL_DT)
            end = fault_metrics.end_of(setting, over)
            group = trace.robots(rows)
            runs.append(
                fault_metrics.survival(group, over)
                | fault_metrics.noticing(group, paper[..., rows], setting.step, end)
                | {"values": self.measures(group, setting.step)}
            )
        return {"runs": runs} | self.curves(trace, self.vision_modes)

    def measures(self, trace: Trace, onset: int) -> dict[str, np.ndarray]:
        """Every measure of each robot, [N], from a control step on."""
        return fault_metrics.robot_measures(trace, onset, self.speed, self.steps)

    def curves(self, trace: Trace, modes: Sequence[str]) -> Part:
        """Further contents of the part of a batch whose robots walk in `modes`; none here."""
        return {}

    def _run_twins(self, evaluator: Evaluator, make: Any) -> Part:
        """Every fault's twins, with cameras that never fail."""
        each, trials = self.robots_each, self.trials_on(self.grounds)
        env = make(tuple(trial.robot for trial in trials))
        trace = self.walk(evaluator, env, "no fault", trials)
        runs = []
        until = round((max(self.onsets) + self.lasts) / CONTROL_DT)
        for trial, group in zip(trials[::each], trace.groups(each), strict=True):
            level = self.levels[trial.ground]
            labels = {"mode": trial.mode, "ground": trial.ground, "ground_level": level}
            values = {
                str(onset): self.measures(group, round(onset / CONTROL_DT)) for onset in self.onsets
            }
            runs.append(labels | fault_metrics.survival(group, until) | {"values": values})
        # The first ground's robots come first. Other modes walk alike: they would count again.
        first = self.modes.index("memory") if "memory" in self.modes else 0
        simple = trace.robots(slice(first * each, (first + 1) * each))
        return {
            "runs": runs,
            "false_switches": metrics.false_switches(simple.trusted, simple.over),
            "healthy_robot_hours": metrics.healthy_hours(simple.over),
        } | self.curves(trace, self.modes)

    def _run_healthy(self, evaluator: Evaluator) -> Part:
        """Mode memory with a camera that never fails: leaving vision is a false switch."""
        minutes = self.healthy_minutes / (4 if self.quick else 1)
        robots = min(HEALTHY_ROBOTS, max(1, round(minutes)))
        steps = max(round(60 * minutes / robots / CONTROL_DT), STEPS_PER_TICK)
        # Another seed than the calibration's and the faults', for robots not seen there.
        seed = self.seed + 1000
        env = evaluator.make_env(FLAT, range(robots), self.speed, seed)
        trials = [Trial("memory", (), robot) for robot in range(robots)]
        rollout = evaluator.rollout(env, trials, seed)
        rollout.on_update = log = MonitorLog(robots)
        trace = rollout.run(steps, "healthy cameras")
        series = healthy_series(log, trace)
        return {
            "false_switches": metrics.false_switches(trace.trusted, trace.failing),
            "robot_hours": metrics.healthy_hours(trace.failing),
            "alarms": {
                name: sum(
                    len(decluster(run, np.nextafter(threshold, -np.inf))) for run in series[name]
                )
                for name, threshold in evaluator.thresholds.items()
            },
        }

    def summarise(self, parts: Mapping[str, Part], evaluator: Evaluator) -> dict[str, Any]:
        """Rows compared with their twins, claims, and what went wrong."""
        twins = {(run["ground"], run["mode"]): run for run in parts["no_fault"]["runs"]}
        runs = []
        for name, settings in self.batches.items():
            rows = dict(zip(self.groups(settings), parts[name]["runs"], strict=True))
            runs += [
                self._row(setting, mode, rows, twins) for setting in settings for mode in self.modes
            ]
        first = str(self.onsets[0])
        baseline = [
            run | {"measures": fault_metrics.estimates(run["values"][first], run["values"][first])}
            for run in twins.values()
        ]
        by_robot = fault_metrics.by_robot(runs)
        for run in [*runs, *baseline]:
            del run["values"]
        # The seconds before the faults are the same in all batches: those of the twins count once.
        calm, walks = parts["no_fault"], parts.get("healthy", {})
        hours = calm["healthy_robot_hours"] + walks.get("robot_hours", 0)
        switches = calm["false_switches"] + walks.get("false_switches", 0)
        healthy = {
            "false_switches": switches,
            "robot_hours": hours,
            "false_switches_per_hour": switches / hours if hours else math.nan,
            "upper_95_per_hour": metrics.poisson_upper(switches) / hours if hours else math.nan,
            "alarms_by_monitor": walks.get("alarms", {}),
        }
        return {
            "runs": runs,
            "by_robot": by_robot,
            "baseline": baseline,
            **findings(runs, baseline, healthy),
            "healthy": healthy,
            "beta": evaluator.beta,
            "robots": self.robots_each,
            "run_seconds": self.steps * CONTROL_DT,
        }

    def _row(self, setting: Setting, mode: str, runs: Rows, twins: Rows) -> dict[str, Any]:
        """The row of a setting in one mode, compared with its twins (by ground and mode)."""
        twin, onset = twins[setting.ground, mode], str(setting.onset)
        calm = twin["values"][onset]
        measured: dict[str, Any] | None = runs.get((setting, mode))
        if measured is None:  # Mode blind, which a fault does not change.
            measured = dict.fromkeys(next(iter(runs.values())))
            measured |= {"detected": 0, "detected_by_paper": 0, "vision_active_at_onset": 0}
            measured |= twin | {"values": calm}
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
        values, op = row["values"], twins.get((setting.ground, "blind"))
        beside = op["values"][onset] if op is not None and mode == "memory" else None
        return (
            row
            | fault_metrics.pair_counts(values, calm)
            | fault_metrics.beside_op(values, beside)
            | {"measures": fault_metrics.estimates(values, calm)}
        )

    def draw(self, summary: dict[str, Any], parts: Mapping[str, Part]) -> Figures:
        """crossed.png, survival.png and detection.png."""
        runs, cells = summary["runs"], figures.mean_cells
        modes = {mode: [r for r in runs if r["mode"] == mode] for mode in self.modes}
        obeying = modes.get("memory") or runs
        selectors = {
            "monitors of mode memory": "detected",
            "rule of mode switch": "detected_by_paper",
        }

        def noticed(name: str) -> figures.Cells:
            return cells(obeying, lambda r: r[name] / (r["vision_active_at_onset"] or np.nan))

        def panels(share: Callable[[Any], float], column: str = "severity") -> Any:
            tables = {mode: dict(cells(rows, share, column)) for mode, rows in modes.items()}
            # Blind robots see no fault: one row at the foot of the others' tables.
            blind = tables.pop("blind", {}) if len(tables) > 1 else {}
            row = {("blind, any fault", name): cell for (_, name), cell in blind.items()}
            return {mode: table | row for mode, table in tables.items()}

        return {
            "crossed.png": figures.colour_tables(
                panels(_crossed, "ground"),
                "Robots that cross (%), all severities and onsets together",
                width=0.62,
            ),
            "survival.png": figures.colour_tables(
                panels(lambda run: run["survival"]),
                "Robots on their feet (%), all grounds and onsets together",
                "severity",
            ),
            "detection.png": figures.colour_tables(
                {selector: noticed(name) for selector, name in selectors.items()},
                "Robots with vision that noticed the fault while it lasted (%)",
                "severity",
            ),
        }

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Robots that crossed, by ground and fault, and the claims."""

        def share(runs: list[Any], mode: str) -> str:
            return f"{100 * np.mean([_crossed(run) for run in runs if run['mode'] == mode]):.0f}"

        crossed = [
            (*where, *(share(runs, mode) for mode in self.modes))
            for where, runs in grouped(summary["runs"], "ground", "fault").items()
        ]
        claims = [
            ("yes" if claim["met"] else "NO", claim["claim"], claim["measured"])
            for claim in summary["claims"]
        ]
        harmful = [
            (figures.setting_label(h), f"{100 * h['memory']:.0f}", f"{100 * h['blind']:.0f}")
            for h in summary["harmful"]
            if h["beyond_chance"]
        ]
        missed = [
            (figures.setting_label(m), m["undetected"], m["vp_falls"], m["vp_spared"])
            for m in summary["missed"]
            if m["beyond_chance"]
        ]
        tables: list[Table] = [
            ("Robots that cross (%)", ("ground", "fault", *self.modes), crossed),
            ("What is claimed, and what was measured", ("met", "claim", "measured"), claims),
        ]
        if harmful:
            title = "On their feet (%): fewer in mode memory than blind, beyond chance"
            tables.append((title, ("setting", "memory", "blind"), harmful))
        if missed:
            title = "Faults that robots do not notice, and that make mode camera fall beyond chance"
            header = ("setting", "do not notice", "fall by it in camera", "spared")
            tables.append((title, header, missed))
        return tables


def _part_of(walk: Callable[[], Mapping[str, Part]], name: str) -> Part:
    return walk()[name]


def _crossed(run: dict[str, Any]) -> float:
    return run["measures"]["crossed"]["value"]
