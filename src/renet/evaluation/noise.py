"""The paper's noise study: robots on flat ground, VP alone against RENet ("Comparison with Only
the VP Estimator").

All settings, modes and robots run side by side as rows of one batch.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from renet.errors import RenetError
from renet.evaluation import figures, metrics
from renet.evaluation.faults import Injection
from renet.evaluation.lab import Lab
from renet.evaluation.results import output_folder, write_csv, write_json
from renet.evaluation.rollout import MODES, Row, Trace
from renet.evaluation.switches import check_selector
from renet.evaluation.terminal import show
from renet.vocabulary import CONTROL_DT

CLEAN = ("none", 0.0)
TITLES = {
    "vp": "VP estimator alone",
    "renet": "RENet",
    "op": "OP estimator alone",
    "oracle-switch": "switch that knows the fault",
}


@dataclass(frozen=True)
class NoiseCfg:
    """Settings of the noise study; the defaults are the paper's."""

    out: Path = Path("results/noise")
    """Folder for summary.json, summary.csv, noise.png and timeline.png."""
    bundle: Path | None = None
    """Bundle folder; the one that ships with renet by default."""
    robots: int = 20
    """Robots in each setting."""
    steps: int = 450
    """Control steps (0.02 s)."""
    onset: int = 150
    """Control step at which the noise begins."""
    speed: float = 0.6
    """Commanded forward speed, m/s."""
    gaussian: tuple[float, ...] = (0.3, 0.7, 1.0)
    """Standard deviations, image range 1."""
    salt_and_pepper: tuple[float, ...] = (0.1, 0.3, 0.7)
    """Shares of the pixels."""
    modes: tuple[str, ...] = ("vp", "renet")
    """Policy modes to compare: vp, renet, op, oracle-switch."""
    selector: str = "guarded"
    """What `renet` trusts: guarded (all monitors, dwell) or paper (reconstruction alone)."""
    seed: int = 1
    """Of the robots' starts and of the noise."""
    engine: str = "auto"
    """Physics engine: auto, native or warp."""

    def __post_init__(self) -> None:
        unknown = [mode for mode in self.modes if mode not in MODES]
        if unknown:
            raise RenetError(f"unknown mode '{unknown[0]}': choose among {', '.join(MODES)}")
        check_selector(self.selector)
        if not self.settings:
            raise RenetError("no noise level given: set gaussian or salt_and_pepper")
        if self.robots < 1 or not 0 < self.onset < self.steps:
            raise RenetError(
                f"robots {self.robots} must be >= 1 and 0 < onset {self.onset} < steps {self.steps}"
            )

    @property
    def settings(self) -> list[tuple[str, float]]:
        """(noise, level) of every noise setting."""
        return [("gaussian", level) for level in self.gaussian] + [
            ("salt_and_pepper", level) for level in self.salt_and_pepper
        ]


@dataclass
class NoiseResult:
    """What the study found, and what pictures of it need."""

    cfg: NoiseCfg
    summary: dict[str, Any]
    rows: list[Row]
    trace: Trace
    lab: Lab

    def indices(self, mode: str, setting: tuple[str, float]) -> np.ndarray:
        """Rows of one mode and setting, by robot number."""
        wanted = _schedule(setting, self.cfg.onset)
        found = [i for i, r in enumerate(self.rows) if r.mode == mode and r.schedule == wanted]
        return np.array(found)


def run_noise(cfg: NoiseCfg, lab: Lab | None = None) -> NoiseResult:
    """Run the study and write its results to `cfg.out`.

    Args:
        cfg: settings.
        lab: where the robots are; made from `cfg.bundle` by default.

    Raises:
        RenetError: bad settings, a bundle that cannot be used, or a folder not to be written.
    """
    lab = lab or Lab(cfg.bundle, cfg.engine, cfg.selector)
    out = output_folder(cfg.out)
    rows = study_rows(cfg)
    world = lab.world("Renet-Go1-Flat", [row.robot for row in rows], cfg.speed, cfg.seed)
    title, film = f"{len(rows)} robots walk", range(len(rows))
    trace = lab.walk(title, world, rows, cfg.steps, cfg.seed, film)
    result = NoiseResult(cfg, {}, rows, trace, lab)
    result.summary = summarise(result)
    write_json(out / "summary.json", result.summary)
    write_csv(out / "summary.csv", result.summary["runs"] + result.summary["baseline"])
    draw(result, out)
    return result


def study_rows(cfg: NoiseCfg) -> list[Row]:
    """Every robot of every mode and setting, and last the timeline's, whose camera recovers."""
    rows = [
        Row(mode, _schedule(setting, cfg.onset), robot)
        for mode in cfg.modes
        for setting in [CLEAN, *cfg.settings]
        for robot in range(cfg.robots)
    ]
    strongest = cfg.settings[len(cfg.gaussian) - 1]
    passing = Injection(*strongest, cfg.onset, duration=(cfg.steps - cfg.onset) * CONTROL_DT / 2)
    return [*rows, Row("renet", (passing,))]


def _schedule(setting: tuple[str, float], onset: int) -> tuple[Injection, ...]:
    return () if setting == CLEAN else (Injection(*setting, onset),)


def summarise(result: NoiseResult) -> dict[str, Any]:
    """The content of summary.json."""
    cfg, lab = result.cfg, result.lab
    clean = np.concatenate([result.indices(mode, CLEAN) for mode in cfg.modes])
    trusted, failing = result.trace.trusted[:, :, clean], result.trace.failing[:, clean]
    return {
        "study": "noise",
        "runs": [_run(result, mode, s) for mode in cfg.modes for s in cfg.settings],
        "baseline": [_run(result, mode, CLEAN) for mode in cfg.modes],
        "selector": cfg.selector,
        "beta": lab.beta,
        "healthy": {
            "false_switches": metrics.false_switches(trusted, failing),
            "robot_hours": metrics.healthy_hours(failing),
        },
        "settings": vars(cfg),
        "provenance": vars(lab.provenance(cfg.seed)),
    }


def _run(result: NoiseResult, mode: str, setting: tuple[str, float]) -> dict[str, Any]:
    """One row of the summary."""
    cfg, index = result.cfg, result.indices(mode, setting)
    speed = result.trace.speed[:, index]
    low, high = metrics.bootstrap_interval(speed[metrics.window(3.0)].mean(axis=0))
    delay = np.full(len(index), np.nan)
    if mode == "renet" and setting != CLEAN:
        delay = metrics.switch_delay(result.trace.trusted[:, :, index], cfg.onset)
    detected = ~np.isnan(delay)
    return {
        "mode": mode,
        "noise": setting[0],
        "level": setting[1],
        "robots": len(index),
        "falls": int(result.trace.fallen[-1, index].sum()),
        "mean_forward_velocity": metrics.mean_forward_velocity(speed),
        "velocity_ci95_low": low,
        "velocity_ci95_high": high,
        "detection_delay_s": float(np.median(delay[detected])) if detected.any() else None,
        "detected": int(detected.sum()) if mode == "renet" and setting != CLEAN else None,
        "seed": cfg.seed,
    }


def draw(result: NoiseResult, out: Path) -> None:
    """Write noise.png and timeline.png."""
    cfg, trace, lab = result.cfg, result.trace, result.lab
    provenance, speed = lab.provenance(cfg.seed), trace.speed
    curves = {
        mode: {
            setting: speed[:, result.indices(mode, setting)].mean(axis=1)
            for setting in [CLEAN, *cfg.settings]
        }
        for mode in cfg.modes
    }
    figures.speed_over_time(curves, cfg.onset, cfg.speed, TITLES, out / "noise.png", provenance)
    noise = result.rows[-1].schedule[0]
    label = figures.noise_label(noise.fault, noise.level)
    start = cfg.onset * CONTROL_DT
    figures.timeline(
        trace.anomaly[:, -1],
        lab.beta,
        trace.probability[:, -1],
        trace.vision[:, -1],
        [(start, f"{label} begins"), (start + noise.duration, "camera recovers")],
        "One robot loses its camera and gets it back",
        out / "timeline.png",
        provenance,
    )


def main(cfg: NoiseCfg) -> None:
    """`renet evaluate noise`."""
    show_runs(run_noise(cfg).summary)


def show_runs(summary: dict[str, Any]) -> None:
    """Print the study's table."""
    rows = [
        (
            TITLES[run["mode"]],
            figures.noise_label(run["noise"], run["level"]),
            f"{run['falls']} of {run['robots']}",
            f"{run['mean_forward_velocity']:.2f}",
            "-" if (delay := run["detection_delay_s"]) is None else f"{1000 * delay:.0f}",
        )
        for run in summary["baseline"] + summary["runs"]
    ]
    header = ("policy", "noise", "falls", "speed (m/s)", "switch delay (ms)")
    show("Camera noise on flat ground", header, rows)
