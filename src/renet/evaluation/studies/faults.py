"""The fault study: every camera fault on every ground, in every mode (docs/benchmark.md).

Faults begin on the way to an obstacle and half a second before its edge, and end before the run
does, so that leaving vision and returning to it are both measured. One fault is one batch of
robots; each has a twin in a batch without faults. Falls are judged by true poses.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from itertools import count
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np

from renet.errors import RenetError
from renet.evaluation import metrics
from renet.evaluation.env import FLAT, SimEnv, grounds_env_cfg
from renet.evaluation.evaluator import Evaluator
from renet.evaluation.monitor_log import MonitorLog, combined_score, healthy_series, replay
from renet.evaluation.report import fault_figures
from renet.evaluation.results import write_json
from renet.evaluation.rollout import StepResult, Trial
from renet.evaluation.studies import fault_metrics
from renet.evaluation.studies.benchmark import GROUNDS, ONSETS, result
from renet.evaluation.studies.fault_findings import findings
from renet.evaluation.study import Figures, Part, Table, WalkingStudy
from renet.evaluation.trace import Trace
from renet.faults import FAULTS, SEVERITIES, Injection, fault_class
from renet.faults.physical import Glass
from renet.interface import CONTROL_DT, STEPS_PER_TICK
from renet.selector.calibration import decluster
from renet.tasks.config.go1 import GO1

HEALTHY_ROBOTS = 64
"""Robots side by side in the run without faults."""


class Setting(NamedTuple):
    """What happens to a group of robots."""

    ground: str
    onset: float
    """Seconds."""
    fault: str
    severity: int

    @property
    def step(self) -> int:
        """Control step at which the fault begins."""
        return round(self.onset / CONTROL_DT)


@dataclass(frozen=True)
class FaultStudy(WalkingStudy):
    """Every way a depth camera fails, on grounds where sight matters, in every mode.

    `--preset noise` is the paper's noise figure: VP alone against RENet under six noises.
    """

    out: Path = Path("results/faults")
    """Folder for summary.json, summary.csv, result.json, figures and parts/."""
    faults: tuple[str, ...] = tuple(FAULTS)
    """Faults to inject: NAME at all severities, or NAME:SEVERITY."""
    severities: tuple[int, ...] = SEVERITIES
    """Severities of faults that name none, 1 to 5."""
    grounds: tuple[str, ...] = tuple(GROUNDS)
    """flat, or a kind of tile: rough, obstacles, stairs_up, stairs_down, gap, platform. Flat ground
    alone has no end, and among others is a tile as they are."""
    level: int | None = None
    """Of all tiles, 1 to 10; each ground's own of the benchmark by default."""
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
    quick_severities: ClassVar[tuple[int, ...]] = (5,)

    def __post_init__(self) -> None:
        for fault, severity in (s[2:] for batch in self.batches.values() for s in batch):
            fault_class(fault).level_of(severity)
        super().__post_init__()
        if not any(self.batches.values()):
            raise RenetError("give a fault, a severity, a ground and an onset that fit together")
        if self.lasts <= 0 or self.healthy_minutes < 0:
            raise RenetError(
                f"lasts {self.lasts} must be positive, healthy minutes {self.healthy_minutes} >= 0"
            )
        if not 0 < min(self.onsets) <= max(self.onsets) + self.lasts <= self.seconds + 1e-6:
            raise RenetError(
                f"0 < onsets {self.onsets} + lasts {self.lasts} <= seconds {self.seconds} must hold"
            )
        grounds_env_cfg(self.levels, GO1)

    @property
    def levels(self) -> dict[str, int]:
        """Level of each ground."""
        return {g: self.level or GROUNDS.get(g, GROUNDS["obstacles"]) for g in self.grounds}

    @property
    def batches(self) -> dict[str, list[Setting]]:
        """Settings that run side by side, by the name of their part."""
        severities = self.quick_severities if self.quick else self.severities
        found = {}
        for text in self.faults:
            fault, _, severity = text.partition(":")
            if severity and not severity.isdecimal():
                raise RenetError(f"cannot read the fault {text!r}: write NAME or NAME:SEVERITY")
            found[text.replace(":", "_")] = [
                Setting(ground, onset, fault, number)
                for ground in self.grounds
                # Glass needs obstacles that can be glass.
                if fault != Glass.name or ground in Glass.terrains
                for onset in self.onsets_on(ground)
                for number in ([int(severity)] if severity else severities)
            ]
        return {name: settings for name, settings in found.items() if settings}

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
    def looking(self) -> list[str]:
        """Modes that a fault can matter to: what OP does is what its twin does."""
        return [mode for mode in self.modes if mode != "op"]

    def trials(self, settings: Sequence[Setting]) -> list[Trial]:
        """Every robot of every mode that looks, setting by setting."""
        return [
            Trial(mode, (Injection.of(*setting[2:], setting.step, self.lasts),), robot)
            for setting in settings
            for mode in self.looking
            for robot in range(self.robots_each)
        ]

    @property
    def twin_settings(self) -> list[tuple[str, str]]:
        """Ground and mode of every group of robots without faults."""
        return [(ground, mode) for ground in self.grounds for mode in self.modes]

    def twins(self) -> list[Trial]:
        """Every robot of every mode on every ground, without faults."""
        each = range(self.robots_each)
        return [Trial(mode, robot=robot) for _, mode in self.twin_settings for robot in each]

    def make_env(self, evaluator: Evaluator, robots: tuple[int, ...]) -> SimEnv:
        """Robots of these numbers, on no ground yet."""
        endless = self.grounds == (FLAT,)
        cfg = FLAT if endless else grounds_env_cfg(self.levels, evaluator.robot)
        return evaluator.make_env(cfg, robots, self.speed, self.seed)

    def walk(
        self, evaluator: Evaluator, make: Any, title: str, trials: Sequence[Trial], grounds, **more
    ) -> Trace:
        """Run trials, each on one of `grounds`, until all robots are done."""
        env = make(tuple(trial.robot for trial in trials))
        if self.grounds != (FLAT,):
            env.place_on(grounds)
        least = round((max(self.onsets) + self.lasts) / CONTROL_DT) + STEPS_PER_TICK
        done, taken = np.zeros(len(trials), bool), count(1)

        def everybody_done(result: StepResult) -> bool:
            done[:] |= result.ended
            return next(taken) > least and bool(done.all())

        return evaluator.rollout(
            title, env, trials, self.steps, self.seed, on_step=everybody_done, **more
        )

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """One batch for each fault, one without faults, and healthy walking."""
        make = cache(partial(self.make_env, evaluator))
        parts: dict[str, Callable[[], Part]] = {
            name: partial(self._run_batch, evaluator, make, name) for name in self.batches
        }
        parts["no_fault"] = partial(self._run_twins, evaluator, make)
        if self.healthy_minutes > 0:
            parts["healthy"] = partial(self._run_healthy, evaluator)
        return parts

    def _run_batch(self, evaluator: Evaluator, make: Any, name: str) -> Part:
        """All settings and modes of one fault."""
        settings, each = self.batches[name], self.robots_each
        trials = self.trials(settings)
        log = MonitorLog(len(trials))
        title = f"{list(self.batches).index(name) + 1}/{len(self.batches)} {name}"
        grounds = [s.ground for s in settings for _ in range(each * len(self.looking))]
        # A robot that a preset adds belongs to the first setting.
        grounds += [settings[0].ground] * (len(trials) - len(grounds))
        trace = self.walk(evaluator, make, title, trials, grounds, on_update=log)
        scores = log.scores
        paper = replay(evaluator.make_selector(len(trials), "paper"), trace.anomaly)
        healthy_ticks = round(min(self.onsets) / CONTROL_DT) // STEPS_PER_TICK
        combined = combined_score(scores, evaluator.thresholds, healthy_ticks)
        runs, seen = [], {}
        for number, setting in enumerate(settings):
            over = setting.step + round(self.lasts / CONTROL_DT)
            end = fault_metrics.end_of(*setting[2:], setting.step, over)

            def batch(rows: slice, onset=setting.step, end=end) -> fault_metrics.Batch:
                recorded = (paper[..., rows], scores["reconstruction"][:, rows], combined[:, rows])
                return fault_metrics.Batch(trace.robots(rows), *recorded, onset, end)

            for place, mode in enumerate(self.looking, start=number * len(self.looking)):
                own = batch(slice(place * each, (place + 1) * each))
                seen.setdefault(setting.severity, []).append(own)
                runs.append(
                    self.labels(setting, mode)
                    | fault_metrics.survival(own.trace, over)
                    | fault_metrics.noticing(own)
                    | {"values": fault_metrics.robot_measures(own.trace, own.onset, self.speed)}
                )
        curves = {
            severity: {"fault": settings[0].fault, "severity": severity}
            | fault_metrics.separability(batches)
            for severity, batches in seen.items()
        }
        for run in runs:
            found = curves[run["severity"]]
            run |= {key: value for key, value in found.items() if key.startswith("auc_")}
        return {"runs": runs, "roc": list(curves.values())} | self.curves(trace, self.looking)

    def labels(self, setting: Setting, mode: str) -> dict[str, Any]:
        """What a row of the summary begins with."""
        model = fault_class(setting.fault)
        named = {"fault": setting.fault, "severity": setting.severity}
        named |= {"level": model.level_of(setting.severity), "unit": model.unit}
        named |= {"ground": setting.ground, "ground_level": self.levels[setting.ground]}
        return named | {"onset": setting.onset, "mode": mode, "seed": self.seed}

    def curves(self, trace: Trace, modes: Sequence[str]) -> Part:
        """Further contents of the part of a batch whose robots walk in `modes`; none here."""
        del trace, modes
        return {}

    def _run_twins(self, evaluator: Evaluator, make: Any) -> Part:
        """Every fault's twins, with cameras that never fail."""
        each = self.robots_each
        grounds = [ground for ground, _ in self.twin_settings for _ in range(each)]
        trace = self.walk(evaluator, make, "no fault", self.twins(), grounds)
        runs, calm = [], np.zeros(len(grounds), bool)
        for number, (ground, mode) in enumerate(self.twin_settings):
            rows = slice(number * each, (number + 1) * each)
            own = trace.robots(rows)
            calm[rows] = ground == self.grounds[0]
            named = {"mode": mode, "ground": ground, "ground_level": self.levels[ground]}
            values = {
                str(onset): fault_metrics.robot_measures(own, round(onset / CONTROL_DT), self.speed)
                for onset in self.onsets
            }
            runs.append(named | fault_metrics.survival(own) | {"values": values})
        simple = np.flatnonzero(calm)
        gone = trace.over[:, simple]
        return {
            "runs": runs,
            "false_switches": metrics.false_switches(trace.trusted[..., simple], gone),
            "healthy_robot_hours": metrics.healthy_hours(gone),
        } | self.curves(trace, self.modes)

    def _run_healthy(self, evaluator: Evaluator) -> Part:
        """RENet with a camera that never fails: every departure from vision is a false switch."""
        minutes = self.healthy_minutes / (4 if self.quick else 1)
        robots = min(HEALTHY_ROBOTS, max(1, round(minutes)))
        steps = max(round(60 * minutes / robots / CONTROL_DT), STEPS_PER_TICK)
        # Another seed than the calibration's and the faults', for robots not seen there.
        seed = self.seed + 1000
        log = MonitorLog(robots)
        env = evaluator.make_env(FLAT, range(robots), self.speed, seed)
        trials = [Trial("renet", (), robot) for robot in range(robots)]
        trace = evaluator.rollout("healthy cameras", env, trials, steps, seed, on_update=log)
        series = healthy_series(log, trace)
        return {
            "false_switches": metrics.false_switches(trace.trusted, trace.failing),
            "robot_hours": metrics.healthy_hours(trace.failing),
            "falls": int(trace.fell.sum()),
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
        each = len(self.looking)
        runs = [
            row
            for name, settings in self.batches.items()
            for number, setting in enumerate(settings)
            for row in self._rows(
                setting, parts[name]["runs"][number * each : (number + 1) * each], twins
            )
        ]
        first = str(self.onsets[0])
        baseline = [
            {k: v for k, v in run.items() if k != "values"}
            | {"measures": fault_metrics.estimates(run["values"][first], run["values"][first])}
            for run in twins.values()
        ]
        # The seconds before the faults are the same in all batches: those of the twins count once.
        calm = [parts["no_fault"]] + [parts[name] for name in parts if name == "healthy"]
        hours = sum(part.get("robot_hours", part.get("healthy_robot_hours", 0)) for part in calm)
        switches = sum(part["false_switches"] for part in calm)
        healthy = {
            "false_switches": switches,
            "robot_hours": hours,
            "false_switches_per_hour": switches / hours if hours else math.nan,
            "upper_95_per_hour": metrics.poisson_upper(switches) / hours if hours else math.nan,
            "alarms_by_monitor": parts["healthy"]["alarms"] if "healthy" in parts else {},
        }
        return {
            "runs": runs,
            "baseline": baseline,
            **findings(runs, baseline, healthy),
            "healthy": healthy,
            "beta": evaluator.beta,
            "robots": self.robots_each,
            "run_seconds": self.steps * CONTROL_DT,
        }

    def _rows(
        self, setting: Setting, runs: list[dict[str, Any]], twins: Mapping[tuple[str, str], Any]
    ) -> list[dict[str, Any]]:
        """The rows of a setting in the order of the modes, each compared with its twins."""
        rows, own = [], {run["mode"]: run for run in runs}
        op = twins.get((setting.ground, "op"), {}).get("values", {}).get(str(setting.onset))
        for mode in self.modes:
            twin = twins[setting.ground, mode]
            calm = twin["values"][str(setting.onset)]
            row = own.get(mode)
            if row is None:
                unseen = dict.fromkeys(runs[0] if runs else ())
                unseen |= {"detected": 0, "detected_by_paper": 0, "vision_active_at_onset": 0}
                row = unseen | twin | self.labels(setting, mode) | {"values": calm}
            values = row["values"]
            rows.append(
                {k: v for k, v in row.items() if k != "values"}
                | fault_metrics.pair_counts(values, calm)
                | fault_metrics.beside_op(values if mode == "renet" else None, op)
                | {"measures": fault_metrics.estimates(values, calm)}
            )
        return rows

    def run(self, evaluator: Evaluator | None = None) -> dict[str, Any]:
        """Run the study; where its onsets are the benchmark's, write result.json as well."""
        summary = super().run(evaluator)
        if set(self.onsets) <= set(ONSETS):
            write_json(self.out / "result.json", result(summary))
        return summary

    def draw(self, summary: dict[str, Any], parts: Mapping[str, Part]) -> Figures:
        """crossed.png, survival.png, detection.png, roc.png and gallery.png."""
        runs = summary["runs"]
        curves: dict[str, list] = {}
        for name in self.batches:
            for curve in parts[name]["roc"]:
                curves.setdefault(curve["fault"], []).append(curve)
        return {
            "crossed.png": fault_figures.draw_crossed(runs, self.modes),
            "survival.png": fault_figures.draw_survival(runs, self.modes),
            "detection.png": fault_figures.draw_detection(runs),
            "roc.png": fault_figures.draw_roc(curves),
            "gallery.png": fault_figures.draw_gallery(list(curves), self.seed),
        }

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Robots that crossed, by ground and fault, and the claims."""
        share: dict[tuple[str, str], dict[str, list[float]]] = {}
        for run in summary["runs"]:
            group = share.setdefault((run["ground"], run["fault"]), {})
            group.setdefault(run["mode"], []).append(run["measures"]["crossed"]["value"])
        crossed = [
            (*where, *(f"{100 * np.mean(values[mode]):.0f}" for mode in self.modes))
            for where, values in share.items()
        ]
        claims = [
            ("yes" if claim["met"] else "NO", claim["claim"], claim["measured"])
            for claim in summary["claims"]
        ]
        return [
            ("Robots that cross (%)", ("ground", "fault", *self.modes), crossed),
            ("What is claimed, and what was measured", ("met", "claim", "measured"), claims),
        ]
