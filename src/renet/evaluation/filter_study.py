"""The filter study: delay and number of switches for every γ and rate (paper's filter figure).

Robots walk once, blind, while their cameras suffer; the anomaly scores they leave are played
through selectors of every γ and rate. What is measured must match the documented formula.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from renet.errors import RenetError
from renet.evaluation import figures, metrics
from renet.evaluation.lab import Lab
from renet.evaluation.results import (
    Parts,
    Provenance,
    output_folder,
    write_csv,
    write_json,
)
from renet.evaluation.rollout import UPDATES_PER_STEP, Row, check_speed
from renet.evaluation.switches import ClockedSelector, updates_apart
from renet.evaluation.terminal import show
from renet.faults import Injection
from renet.interface import CONTROL_DT
from renet.selector import SelectorSpec
from renet.selector.filter import LowPassFilter, switch_delay


@dataclass(frozen=True)
class FilterCfg:
    """Settings of the filter study."""

    out: Path = Path("results/filter")
    """Folder for summary.json, summary.csv, filter.png and parts/."""
    bundle: Path | None = None
    """Bundle folder; the one that ships with renet by default."""
    gammas: tuple[float, ...] = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
    """Weights of a new verdict."""
    rates: tuple[float, ...] = (10.0, 50.0, 200.0)
    """Filter updates per second: whole fractions of 200."""
    robots: int = 20
    """Robots with a camera that fails for good, and as many with one that flickers."""
    quick: bool = False
    """4 robots of each instead."""
    onset: int = 100
    """Control step (0.02 s) at which the faults begin."""
    steps: int = 600
    """Control steps of each run."""
    speed: float = 0.6
    """Commanded forward speed, m/s."""
    seed: int = 1
    """Of the robots' starts and of the noise."""
    engine: str = "auto"
    """Physics engine: auto, native or warp."""

    def __post_init__(self) -> None:
        if self.robots < 1 or not 0 < self.onset < self.steps:
            raise RenetError(
                f"robots {self.robots} must be >= 1 and 0 < onset {self.onset} < steps {self.steps}"
            )
        check_speed(self.speed)
        if not (self.gammas and self.rates):
            raise RenetError("give at least one gamma and one rate")
        for gamma in self.gammas:
            LowPassFilter(gamma)
        for rate in self.rates:
            updates_apart(rate)


def run_filter(cfg: FilterCfg, lab: Lab | None = None) -> dict[str, Any]:
    """Run the study, write its results to `cfg.out` and return the summary.

    Raises:
        RenetError: a bundle that cannot be used, or a folder that cannot be written to.
    """
    lab = lab or Lab(cfg.bundle, cfg.engine, "paper")
    given = cfg
    if cfg.quick:
        cfg = replace(cfg, robots=4, quick=False)
    out = output_folder(cfg.out)
    provenance = lab.provenance(cfg.seed)
    parts = Parts(out, cfg, provenance, free=("gammas", "rates"))
    scores = np.array(parts.get("scores", partial(_walk, cfg, lab))["scores"])
    runs = [
        _run(cfg, scores, SelectorSpec(lab.beta, gamma, rate))
        for rate in cfg.rates
        for gamma in cfg.gammas
    ]
    summary = {
        "study": "filter",
        "runs": runs,
        "settings": asdict(given),
        "provenance": vars(provenance),
    }
    write_json(out / "summary.json", summary)
    write_csv(out / "summary.csv", runs)
    draw(cfg, runs, out / "filter.png", provenance)
    return summary


def _walk(cfg: FilterCfg, lab: Lab) -> dict[str, Any]:
    """Anomaly scores [T, 2 N]: N cameras that fail for good, then N that flicker."""
    steady = (Injection("gaussian", 1.0, cfg.onset),)
    flicker = (Injection("gaussian", 1.0, cfg.onset, duration=0.1, period=0.4),)
    rows = [Row("op", fault, robot) for fault in (steady, flicker) for robot in range(cfg.robots)]
    world = lab.world("Renet-Go1-Flat", [row.robot for row in rows], cfg.speed, cfg.seed)
    trace = lab.walk(f"{len(rows)} robots walk", world, rows, cfg.steps, cfg.seed)
    return {"scores": trace.anomaly}


def replay(scores: np.ndarray, spec: SelectorSpec) -> np.ndarray:
    """A selector's answers [T, U, N] to anomaly scores [T, N], as in a rollout."""
    switch = ClockedSelector("paper", spec, scores.shape[1])
    return np.array([[switch.judge(score) for _ in range(UPDATES_PER_STEP)] for score in scores])


def _run(cfg: FilterCfg, scores: np.ndarray, spec: SelectorSpec) -> dict[str, Any]:
    """One γ and rate: delay on the cameras that fail, switches on those that flicker."""
    trusted = replay(scores, spec)
    delay = metrics.switch_delay(trusted[:, :, : cfg.robots], cfg.onset)
    switched = metrics.switches(trusted[cfg.onset - 1 :, :, cfg.robots :])
    seconds = (cfg.steps - cfg.onset) * CONTROL_DT
    found = ~np.isnan(delay)
    return {
        "gamma": spec.gamma,
        "rate_hz": spec.rate_hz,
        "delay_s": float(np.median(delay[found])) if found.any() else None,
        "formula_s": switch_delay(spec.gamma, spec.rate_hz),
        "detected": int(found.sum()),
        "switches_per_minute": float(switched.mean() * 60 / seconds),
        "robots": cfg.robots,
        "seed": cfg.seed,
    }


def draw(cfg: FilterCfg, runs: list[dict[str, Any]], path: Path, provenance: Provenance) -> None:
    """Write filter.png: delay and switches against γ, one line for each rate."""
    palette = plt.get_cmap("plasma")(np.linspace(0, 0.85, len(cfg.rates)))
    with plt.rc_context(figures.STYLE):
        figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.8))
        for colour, rate in zip(palette, cfg.rates, strict=True):
            line = [run for run in runs if run["rate_hz"] == rate]
            gamma = [run["gamma"] for run in line]
            delay = [np.nan if run["delay_s"] is None else run["delay_s"] for run in line]
            label = f"{rate:g} Hz"
            left.plot(gamma, delay, "o", color=colour, label=f"{label}, measured", markersize=4)
            formula = [run["formula_s"] for run in line]
            left.plot(gamma, formula, "-", color=colour, linewidth=1, label=f"{label}, formula")
            switches = [run["switches_per_minute"] for run in line]
            right.plot(gamma, switches, "o-", color=colour, label=label, markersize=4)
        left.axhline(0.04, color=figures.INK, linestyle=":", linewidth=1)
        left.set(title="(a) Delay of the switch", ylabel="delay (s)", yscale="log")
        right.set(title="(b) Switches, camera flickering", ylabel="switches per minute")
        for axis in (left, right):
            axis.set(xlabel="γ", xscale="log")
            axis.legend(fontsize=8)
        figures.save(figure, path, provenance)


def main(cfg: FilterCfg) -> None:
    """`renet evaluate filter`."""
    runs = run_filter(cfg)["runs"]
    header = ("rate_hz", "gamma", "delay_s", "formula_s", "switches_per_minute")
    rows = [["-" if run[name] is None else f"{run[name]:g}" for name in header] for run in runs]
    show("The selector's filter", header, rows)
