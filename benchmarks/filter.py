"""The filter's delay and number of switches for every γ and rate (the paper's filter figure).

`python benchmarks/filter.py` takes 15 s. Robots walk once under the OP estimator while their
cameras fail; the recorded anomaly scores are played through selectors of every γ and rate. The
delay must match the documented formula.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import matplotlib.pyplot as plt
import numpy as np
import tyro

from facts import errors_in_one_line
from renet.errors import RenetError
from renet.evaluation import figures, metrics
from renet.evaluation.evaluator import Evaluator
from renet.evaluation.monitor_log import replay_selector
from renet.evaluation.rollout import Trial
from renet.evaluation.settings import FLAT_GROUND, check_speed
from renet.evaluation.study import Figures, Part, Study, Table
from renet.faults import Injection
from renet.interface import PHYSICS_DT, control_steps
from renet.selector import SelectorSpec, make_selector
from renet.selector.filter import filter_delay


@dataclass(frozen=True)
class FilterStudy(Study):
    """The filter's delay and number of switches against γ and rate."""

    out: Path = Path("results/filter")
    """Folder for summary.json, summary.csv, filter.png and parts/."""
    gammas: tuple[float, ...] = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
    """Weights of a new verdict."""
    rates: tuple[float, ...] = (10.0, 50.0, 200.0)
    """Filter updates per second: whole fractions of 200."""
    robots: int = 20
    """Robots with a camera that fails for good, and as many with noise in 0.1 s of every 0.4 s."""
    onset: float = 2.0
    """Seconds at which the faults begin."""
    seconds: float = 12.0
    """Length of each run."""
    speed: float = 0.6
    """Commanded forward speed, m/s."""

    name: ClassVar[str] = "filter"
    selectable: ClassVar[tuple[str, ...]] = ("gammas", "rates")

    def __post_init__(self) -> None:
        super().__post_init__()
        if (
            self.robots < 1
            or not 0 < self.onset < self.seconds
            or round(self.onset, 1) != self.onset
        ):
            raise RenetError("robots >= 1 and 0 < onset < seconds, in tenths as images, must hold")
        check_speed(self.speed)
        if not (self.gammas and self.rates):
            raise RenetError("give at least one gamma and one rate")
        for gamma in self.gammas:
            SelectorSpec(beta=1.0, gamma=gamma)  # Raises where there is no such filter.
        for rate in self.rates:
            every = 1.0 / (PHYSICS_DT * rate) if rate > 0 else 0.0
            if every < 0.5 or abs(every / round(every) - 1.0) > 1e-6:
                raise RenetError(f"rate {rate} Hz: give 200 Hz or a whole fraction of that")

    @property
    def robots_each(self) -> int:
        """Robots of each kind, after `quick`."""
        return 4 if self.quick else self.robots

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """Anomaly scores [T, 2 N]: N cameras that fail for good, then N that flicker."""
        return {"scores": partial(self._walk, evaluator)}

    def _walk(self, evaluator: Evaluator) -> Part:
        onset = control_steps(self.onset)
        steady = (Injection("gaussian", 1.0, onset),)
        flicker = (Injection("gaussian", 1.0, onset, duration=0.1, period=0.4),)
        robots = range(self.robots_each)
        trials = [Trial("blind", fault, robot) for fault in (steady, flicker) for robot in robots]
        env = evaluator.make_env(FLAT_GROUND, [*robots, *robots], self.speed, self.seed)
        steps = control_steps(self.seconds)
        trace = evaluator.rollout(env, trials, self.seed).run(steps, f"{len(trials)} robots walk")
        return {"scores": trace.anomaly}

    def summarise(self, parts: Mapping[str, Part], evaluator: Evaluator) -> dict[str, Any]:
        """One row for each γ and rate."""
        scores = np.array(parts["scores"]["scores"])
        return {
            "runs": [
                self._run(scores, SelectorSpec(evaluator.paper_beta, gamma, rate))
                for rate in self.rates
                for gamma in self.gammas
            ]
        }

    def _run(self, scores: np.ndarray, spec: SelectorSpec) -> dict[str, Any]:
        """Delay on the cameras that fail, switches on those that flicker."""
        onset, each = control_steps(self.onset), self.robots_each
        trusted = replay_selector(make_selector("switch", spec, scores.shape[1]), scores)
        delay = metrics.switch_delay(trusted[:, :, :each], onset)
        updates = trusted[onset - 1 :, :, each:].reshape(-1, each)
        switched = np.diff(updates, axis=0).sum(axis=0)
        switches = ~np.isnan(delay)
        return {
            "gamma": spec.gamma,
            "rate_hz": spec.rate_hz,
            "delay_s": float(np.median(delay[switches])) if switches.any() else None,
            "formula_s": filter_delay(spec.gamma, spec.rate_hz),
            "detected": int(switches.sum()),
            "switches_per_minute": float(switched.mean() * 60 / (self.seconds - self.onset)),
            "robots": each,
            "seed": self.seed,
        }

    def draw(self, summary: dict[str, Any], parts: Mapping[str, Part]) -> Figures:
        """filter.png: delay and switches against γ, one line for each rate."""
        palette = plt.get_cmap("plasma")(np.linspace(0, 0.85, len(self.rates)))
        figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.8))
        for colour, rate in zip(palette, self.rates, strict=True):
            line = [run for run in summary["runs"] if run["rate_hz"] == rate]
            gamma = [run["gamma"] for run in line]
            delay = [np.nan if run["delay_s"] is None else run["delay_s"] for run in line]
            label = f"{rate:g} Hz"
            left.plot(gamma, delay, "o", color=colour, label=f"{label}, measured", markersize=4)
            formula = [run["formula_s"] for run in line]
            left.plot(gamma, formula, "-", color=colour, linewidth=1, label=f"{label}, formula")
            switches = [run["switches_per_minute"] for run in line]
            right.plot(gamma, switches, "o-", color=colour, markersize=4)
        left.axhline(0.04, color=figures.INK, linestyle=":", linewidth=1)
        left.set(title="(a) Delay of the switch", ylabel="delay (s)", yscale="log")
        right.set(title="(b) Switches, camera flickering", ylabel="switches per minute")
        figures.label_log_ticks(left.yaxis)
        for axis in (left, right):
            axis.set(xlabel="γ", xscale="log")
            figures.label_log_ticks(axis.xaxis)
        # Colours are the same in both.
        figures.legend(figure, left)
        return {"filter.png": figure}

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """The rows."""
        header = ("rate_hz", "gamma", "delay_s", "formula_s", "switches_per_minute")
        rows = [
            tuple("-" if run[name] is None else f"{run[name]:g}" for name in header)
            for run in summary["runs"]
        ]
        return [("The selector's filter", header, rows)]


if __name__ == "__main__":
    with errors_in_one_line():
        cfg = tyro.cli(FilterStudy)
        cfg.main()
        print(f"Results: {cfg.out}")
