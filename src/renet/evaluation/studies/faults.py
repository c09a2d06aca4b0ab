"""The fault study: every camera fault, severity and policy mode, judged by the true pose.

Every fault begins at one moment and is over at another, or earlier by itself, so that leaving
vision and returning to it are both measured. One fault is one batch of robots; each has a twin in a
batch without faults.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from renet.errors import RenetError
from renet.evaluation import metrics
from renet.evaluation.env import FLAT, SimEnv, terrain_env_cfg
from renet.evaluation.evaluator import Evaluator
from renet.evaluation.monitor_log import SelectorProbe, combined_score, healthy_series
from renet.evaluation.report import fault_figures
from renet.evaluation.results import Provenance
from renet.evaluation.rollout import EvalEnv, Trial, check_modes, check_speed
from renet.evaluation.selectors import check_selector
from renet.evaluation.studies.fault_findings import findings
from renet.evaluation.studies.fault_metrics import Batch, measure, separability
from renet.evaluation.studies.fault_pairs import paired_runs
from renet.evaluation.study import Part, Study, Table
from renet.evaluation.trace import Trace
from renet.faults import FAULTS, SEVERITIES, Injection, fault_class
from renet.faults.physical import Glass
from renet.interface import CONTROL_DT, STEPS_PER_TICK
from renet.selector.calibration import decluster
from renet.tasks.config.go1 import GO1

HEALTHY_ROBOTS = 64
"""Robots side by side in the run without faults."""
Setting = tuple[str, int]
"""Fault and severity."""


@dataclass(frozen=True)
class FaultStudy(Study):
    """Every way a depth camera fails, at every severity, in every mode.

    `--preset noise` is the paper's noise figure: VP alone against RENet under six noises.
    """

    out: Path = Path("results/faults")
    """Folder for summary.json, summary.csv, figures and parts/."""
    faults: tuple[str, ...] = tuple(FAULTS)
    """Faults to inject: NAME at all severities, or NAME:SEVERITY."""
    severities: tuple[int, ...] = SEVERITIES
    """Severities of faults that name none, 1 to 5."""
    modes: tuple[str, ...] = ("vp", "renet", "op")
    """Policy modes to compare: vp, renet, op, oracle-switch."""
    robots: int = 20
    """Robots in each setting."""
    terrain: str = FLAT
    """"flat", or a kind of tile: rough, obstacles, stairs_up, stairs_down, gap, platform."""
    level: int = 3
    """Level of the tile, 1 to 10."""
    speed: float = 0.6
    """Commanded forward speed, m/s."""
    onset: float = 2.0
    """Seconds at which the fault begins."""
    fault_end: float = 6.0
    """Seconds at which it is over at the latest."""
    seconds: float = 8.0
    """Length of each run."""
    healthy_minutes: float = 80.0
    """Robot minutes with a healthy camera, in which false switches are counted; 0: none."""
    selector: str = "monitors"
    """What `renet` trusts: monitors (all of them, with a dwell) or paper (reconstruction alone)."""

    name: ClassVar[str] = "faults"
    selectable: ClassVar[tuple[str, ...]] = ("faults",)
    quick_severities: ClassVar[tuple[int, ...]] = (1, 3, 5)
    quick_robots: ClassVar[int] = 10

    def __post_init__(self) -> None:
        for fault, severity in (setting for batch in self.batches.values() for setting in batch):
            fault_class(fault).level_of(severity)
        check_modes(self.modes)
        check_speed(self.speed)
        if not self.batches or not all(self.batches.values()):
            raise RenetError("give at least one fault and one severity")
        if len({len(batch) for batch in self.batches.values()}) > 1:
            raise RenetError("name a severity with every fault, such as gaussian:4, or with none")
        if self.robots < 1 or not 0 < self.onset < self.fault_end <= self.seconds:
            raise RenetError(
                f"robots {self.robots} must be >= 1 and 0 < onset {self.onset} < fault end"
                f" {self.fault_end} <= seconds {self.seconds}"
            )
        if self.healthy_minutes < 0:
            raise RenetError(f"healthy minutes must be >= 0, got {self.healthy_minutes}")
        check_selector(self.selector)
        terrain_env_cfg(self.terrain, self.level, GO1)

    @property
    def batches(self) -> dict[str, list[Setting]]:
        """Settings that run side by side, by the name of their part."""
        severities = self.quick_severities if self.quick else self.severities
        found = {}
        for text in self.faults:
            fault, _, severity = text.partition(":")
            if severity and not severity.isdecimal():
                raise RenetError(f"cannot read the fault {text!r}: write NAME or NAME:SEVERITY")
            own = [int(severity)] if severity else severities
            found[text.replace(":", "_")] = [(fault, number) for number in own]
        return found

    @property
    def robots_each(self) -> int:
        """Robots in each setting and mode, after `quick`."""
        return self.quick_robots if self.quick else self.robots

    @property
    def steps(self) -> int:
        """Control steps of a run."""
        return round(self.seconds / CONTROL_DT)

    @property
    def onset_step(self) -> int:
        """Control step at which faults begin."""
        return round(self.onset / CONTROL_DT)

    @property
    def end_step(self) -> int:
        """Control step at which every fault is over."""
        return round(self.fault_end / CONTROL_DT)

    def terrain_of(self, fault: str) -> str:
        """Where a fault is studied: glass needs obstacles that can be glass."""
        fits = fault != Glass.name or self.terrain in Glass.terrains
        return self.terrain if fits else Glass.terrains[0]

    def trials(self, settings: list[Setting], faulty: bool = True) -> list[Trial]:
        """Every robot of every mode of every setting, or their twins without faults."""
        lasts = (self.end_step - self.onset_step) * CONTROL_DT
        return [
            Trial(mode, (Injection.of(*setting, self.onset_step, lasts),) if faulty else (), robot)
            for setting in settings
            for mode in self.modes
            for robot in range(self.robots_each)
        ]

    def make_env(self, evaluator: Evaluator, terrain: str) -> SimEnv:
        """Room for one batch on a terrain."""
        numbers = [trial.robot for trial in self.trials(next(iter(self.batches.values())))]
        cfg = terrain_env_cfg(terrain, self.level, evaluator.robot)
        return evaluator.make_env(cfg, numbers, self.speed, self.seed)

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """One batch for each fault, one without faults on each terrain, and healthy walking."""
        env = cache(partial(self.make_env, evaluator))

        def faulty(name: str) -> Part:
            return self._run_batch(evaluator, env(self.terrain_of(self.batches[name][0][0])), name)

        def faultless(terrain: str) -> Part:
            return self._run_twins(evaluator, env(terrain), terrain)

        parts: dict[str, Callable[[], Part]] = {
            name: partial(faulty, name) for name in self.batches
        }
        for terrain in self._terrains:
            parts[f"no_fault_{terrain}"] = partial(faultless, terrain)
        if self.healthy_minutes > 0:
            parts["healthy"] = partial(self._run_healthy, evaluator)
        return parts

    @property
    def _terrains(self) -> list[str]:
        """Every terrain on which a fault is studied."""
        faults = [fault for batch in self.batches.values() for fault, _ in batch]
        return list(dict.fromkeys(self.terrain_of(fault) for fault in faults))

    def _run_batch(self, evaluator: Evaluator, env: EvalEnv, name: str) -> Part:
        """All settings and modes of one batch."""
        settings = self.batches[name]
        trials = self.trials(settings)
        count = len(trials)
        probe = SelectorProbe(count, {"paper": evaluator.make_selector(count, "paper")})
        title = f"{list(self.batches).index(name) + 1}/{len(self.batches)} {name}"
        trace = evaluator.rollout(title, env, trials, self.steps, self.seed, on_update=probe)
        scores = probe.log.scores
        healthy_ticks = self.onset_step // STEPS_PER_TICK
        batch = Batch(
            trace,
            probe.trusted("paper"),
            scores["reconstruction"],
            combined_score(scores, evaluator.thresholds, healthy_ticks),
            self.onset_step,
            self.end_step,
        )
        runs, roc, robots = [], [], self.robots_each
        for number, (fault, severity) in enumerate(settings):
            first = number * robots * len(self.modes)
            last = first + robots * len(self.modes)
            found = separability(batch, slice(first, last), fault, severity)
            areas = {key: value for key, value in found.items() if key.startswith("auc_")}
            model = fault_class(fault)
            for start, mode in zip(range(first, last, robots), self.modes, strict=True):
                labels = {
                    "fault": fault,
                    "severity": severity,
                    "level": model.level_of(severity),
                    "unit": model.unit,
                    "mode": mode,
                    "terrain": self.terrain_of(fault),
                }
                measured = measure(batch, slice(start, start + robots), fault, severity)
                runs.append(labels | measured | areas | {"seed": self.seed})
            roc.append(found)
        fell = trace.fallen[-1, : robots * len(runs)].astype(int)
        return {"runs": runs, "roc": roc, "fell": fell} | self.curves(trace)

    def curves(self, trace: Trace) -> Part:
        """Further contents of a batch's part; none here."""
        del trace
        return {}

    def _run_twins(self, evaluator: Evaluator, env: EvalEnv, terrain: str) -> Part:
        """Every fault's twins, with cameras that never fail."""
        settings = next(iter(self.batches.values()))
        trials = self.trials(settings, faulty=False)
        trace = evaluator.rollout(f"no fault, {terrain}", env, trials, self.steps, self.seed)
        count = len(settings) * len(self.modes) * self.robots_each
        trusted, fallen, speed = trace.trusted[..., :count], trace.fallen[:, :count], trace.speed
        runs = []
        for mode in self.modes:
            index = [n for n, trial in enumerate(trials[:count]) if trial.mode == mode]
            upright, final_speed = ~fallen[-1, index], speed[:, index]
            runs.append(
                {"mode": mode, "terrain": terrain, "robots": len(index)}
                | {"falls": int((~upright).sum()), "survival": float(upright.mean())}
                | metrics.with_interval("survival", upright)
                | {"mean_forward_velocity": metrics.mean_forward_velocity(final_speed)}
                | metrics.with_interval("velocity", final_speed[metrics.window(3.0)].mean(axis=0))
                | {"seed": self.seed}
            )
        return {
            "runs": runs,
            "fell": fallen[-1].astype(int),
            "false_switches": metrics.false_switches(trusted, fallen),
            "healthy_robot_hours": metrics.healthy_hours(fallen),
        } | self.curves(trace)

    def _run_healthy(self, evaluator: Evaluator) -> Part:
        """RENet with a camera that never fails: every departure from vision is a false switch."""
        robots = min(HEALTHY_ROBOTS, max(1, round(self.healthy_minutes)))
        steps = max(round(60 * self.healthy_minutes / robots / CONTROL_DT), STEPS_PER_TICK)
        # Another seed than the calibration's and the faults', for robots not seen there.
        seed = self.seed + 1000
        probe = SelectorProbe(robots, {})
        task = terrain_env_cfg(self.terrain, self.level, evaluator.robot)
        env = evaluator.make_env(task, range(robots), self.speed, seed)
        trials = [Trial("renet", (), robot) for robot in range(robots)]
        trace = evaluator.rollout("healthy cameras", env, trials, steps, seed, on_update=probe)
        series = healthy_series(probe.log, trace)
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
        twins = {terrain: parts[f"no_fault_{terrain}"] for terrain in self._terrains}
        runs = [
            run
            for name, settings in self.batches.items()
            for run in paired_runs(
                parts[name], twins[self.terrain_of(settings[0][0])], self.modes, self.robots_each
            )
        ]
        baseline = [run for part in twins.values() for run in part["runs"]]
        # Not the seconds before the faults, which are the same in all batches, nor the terrain
        # that only glass needs.
        calm = [part for terrain, part in twins.items() if terrain == self.terrain]
        hours = sum(part["healthy_robot_hours"] for part in calm)
        switches = sum(part["false_switches"] for part in calm)
        if "healthy" in parts:
            hours += parts["healthy"]["robot_hours"]
            switches += parts["healthy"]["false_switches"]
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
            "run_seconds": self.steps * CONTROL_DT,
        }

    def draw(
        self, summary: dict[str, Any], parts: Mapping[str, Part], provenance: Provenance
    ) -> None:
        """Write survival.png, detection.png, roc.png and gallery.png."""
        runs, out = summary["runs"], self.out
        fault_figures.draw_survival(runs, self.modes, out / "survival.png", provenance)
        fault_figures.draw_detection(runs, out / "detection.png", provenance)
        curves = {}
        for name, settings in self.batches.items():
            curves.setdefault(settings[0][0], []).extend(parts[name]["roc"])
        fault_figures.draw_roc(curves, out / "roc.png", provenance)
        fault_figures.draw_gallery(list(curves), self.seed, out / "gallery.png", provenance)

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Survival by setting, and the claims."""
        share: dict[Setting, list[str]] = {}
        for run in summary["runs"]:
            shares = share.setdefault((run["fault"], run["severity"]), [])
            shares.append(f"{100 * run['survival']:.0f}")
        survival = [(*setting, *values) for setting, values in share.items()]
        claims = [
            ("yes" if claim["met"] else "NO", claim["claim"], claim["measured"])
            for claim in summary["claims"]
        ]
        title = "Robots on their feet at the end (%)"
        return [
            (title, ("fault", "severity", *self.modes), survival),
            ("What is claimed, and what was measured", ("met", "claim", "measured"), claims),
        ]
