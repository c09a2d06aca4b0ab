"""The paper's noise study: robots on flat ground, VP alone against RENet ("Comparison with Only
the VP Estimator").

Each setting is one batch: its modes and robots run side by side. Finished settings are kept in
`parts/`, so an interrupted study goes on where it stopped.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from renet.errors import RenetError
from renet.evaluation import figures, metrics
from renet.evaluation.fault_measures import detection
from renet.evaluation.lab import Lab
from renet.evaluation.results import Parts, Provenance, output_folder, write_csv, write_json
from renet.evaluation.rollout import Row, Trace, World, check_modes, check_speed
from renet.evaluation.switches import check_selector
from renet.evaluation.terminal import show
from renet.faults import Injection
from renet.interface import CONTROL_DT

Setting = tuple[str, float]
"""Noise and level."""
CLEAN: Setting = ("none", 0.0)
QUICK_ROBOTS = 5


@dataclass(frozen=True)
class NoiseCfg:
    """Settings of the noise study; the defaults are the paper's."""

    out: Path = Path("results/noise")
    """Folder for summary.json, summary.csv, noise.png, timeline.png and parts/."""
    bundle: Path | None = None
    """Bundle folder; the one that ships with renet by default."""
    robots: int = 20
    """Robots in each setting."""
    quick: bool = False
    """5 robots in each setting instead: a minute."""
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
    selector: str = "monitors"
    """What `renet` trusts: monitors (all of them, dwell) or paper (reconstruction alone)."""
    seed: int = 1
    """Of the robots' starts and of the noise."""
    engine: str = "auto"
    """Physics engine: auto, native or warp."""

    def __post_init__(self) -> None:
        check_modes(self.modes)
        check_speed(self.speed)
        check_selector(self.selector)
        if not self.settings:
            raise RenetError("no noise level given: set gaussian or salt_and_pepper")
        if self.robots < 1 or not 0 < self.onset < self.steps:
            raise RenetError(
                f"robots {self.robots} must be >= 1 and 0 < onset {self.onset} < steps {self.steps}"
            )

    @property
    def settings(self) -> list[Setting]:
        """Every noise setting."""
        return [("gaussian", level) for level in self.gaussian] + [
            ("salt_and_pepper", level) for level in self.salt_and_pepper
        ]

    @property
    def strongest(self) -> Setting:
        """The setting of the timeline."""
        return self.settings[len(self.gaussian) - 1]

    @property
    def each(self) -> int:
        """Robots in each setting and mode, after `quick`."""
        return QUICK_ROBOTS if self.quick else self.robots

    def rows_of(self, mode: str) -> slice:
        """Where a mode's robots are in every batch."""
        first = self.modes.index(mode) * self.each
        return slice(first, first + self.each)


def run_noise(cfg: NoiseCfg, lab: Lab | None = None) -> dict[str, Any]:
    """Run what has not been run yet, write the results to `cfg.out` and return the summary.

    Args:
        cfg: settings.
        lab: where the robots are; made from `cfg.bundle` by default.

    Raises:
        RenetError: bad settings, a bundle that cannot be used, or a folder not to be written.
    """
    lab = lab or Lab(cfg.bundle, cfg.engine, cfg.selector)
    out = output_folder(cfg.out)
    provenance = lab.provenance(cfg.seed)
    parts = Parts(out, cfg, provenance, free=("gaussian", "salt_and_pepper"))

    @cache
    def world() -> World:
        return build_world(cfg, lab)

    def one(setting: Setting, name: str) -> dict[str, Any]:
        return measure(cfg, setting, walk(cfg, lab, world(), setting, name))

    found = {}
    for number, setting in enumerate([CLEAN, *cfg.settings], start=1):
        name = f"{setting[0]}_{setting[1]:g}"
        title = f"{number}/{1 + len(cfg.settings)} {name}"
        found[setting] = parts.get(name, partial(one, setting, title))
    summary = {
        "study": "noise",
        "runs": [found[s]["runs"][m] for m in range(len(cfg.modes)) for s in cfg.settings],
        "baseline": found[CLEAN]["runs"],
        "selector": cfg.selector,
        "beta": lab.beta,
        "healthy": found[CLEAN]["healthy"],
        "settings": asdict(cfg),
        "provenance": vars(provenance),
    }
    write_json(out / "summary.json", summary)
    write_csv(out / "summary.csv", summary["runs"] + summary["baseline"])
    draw(cfg, found, lab.beta, provenance, out)
    return summary


def build_world(cfg: NoiseCfg, lab: Lab) -> World:
    """Flat ground with room for one setting."""
    numbers = [row.robot for row in setting_rows(cfg, CLEAN)]
    return lab.world("Renet-Go1-Flat", numbers, cfg.speed, cfg.seed)


def setting_rows(cfg: NoiseCfg, setting: Setting) -> list[Row]:
    """Every robot of every mode, and last one under RENet whose camera recovers half-way."""
    noise = () if setting == CLEAN else (Injection(*setting, cfg.onset),)
    rest = (cfg.steps - cfg.onset) * CONTROL_DT
    passing = () if setting == CLEAN else (Injection(*setting, cfg.onset, duration=rest / 2),)
    rows = [Row(mode, noise, robot) for mode in cfg.modes for robot in range(cfg.each)]
    return [*rows, Row("renet", passing)]


def walk(
    cfg: NoiseCfg, lab: Lab, world: World, setting: Setting, title: str, film: Sequence[int] = ()
) -> Trace:
    """Walk one setting; the same every time, for one bundle and seed."""
    return lab.walk(title, world, setting_rows(cfg, setting), cfg.steps, cfg.seed, film)


def measure(cfg: NoiseCfg, setting: Setting, trace: Trace) -> dict[str, Any]:
    """What is kept of one setting: a row for each mode, curves, healthy time and a timeline."""
    everybody = slice(0, len(cfg.modes) * cfg.each)
    trusted, failing = trace.trusted[:, :, everybody], trace.failing[:, everybody]
    return {
        "runs": [_run(cfg, setting, mode, trace) for mode in cfg.modes],
        "speed": {mode: trace.speed[:, cfg.rows_of(mode)].mean(axis=1) for mode in cfg.modes},
        "healthy": {
            "false_switches": metrics.false_switches(trusted, failing),
            "robot_hours": metrics.healthy_hours(failing),
        },
        "timeline": {
            name: getattr(trace, name)[:, -1].astype(float)
            for name in ("anomaly", "probability", "vision")
        },
    }


def _run(cfg: NoiseCfg, setting: Setting, mode: str, trace: Trace) -> dict[str, Any]:
    """One row of the summary."""
    index = cfg.rows_of(mode)
    speed = trace.speed[:, index]
    low, high = metrics.bootstrap_interval(speed[metrics.window(3.0)].mean(axis=0))
    delay = np.full(cfg.each, np.nan)
    if mode == "renet" and setting != CLEAN:
        delay = detection(trace.trusted[:, :, index], trace.fallen[:, index], cfg.onset, cfg.steps)
    detected = ~np.isnan(delay)
    return {
        "mode": mode,
        "noise": setting[0],
        "level": setting[1],
        "robots": cfg.each,
        "falls": int(trace.fallen[-1, index].sum()),
        "mean_forward_velocity": metrics.mean_forward_velocity(speed),
        "velocity_ci95_low": low,
        "velocity_ci95_high": high,
        "detection_delay_s": float(np.median(delay[detected])) if detected.any() else None,
        "detected": int(detected.sum()) if mode == "renet" and setting != CLEAN else None,
        "seed": cfg.seed,
    }


def draw(
    cfg: NoiseCfg,
    found: Mapping[Setting, dict[str, Any]],
    beta: float,
    provenance: Provenance,
    out: Path,
) -> None:
    """Write noise.png and timeline.png from the parts by setting."""
    curves = {
        mode: {setting: np.array(part["speed"][mode]) for setting, part in found.items()}
        for mode in cfg.modes
    }
    figures.speed_over_time(curves, cfg.onset, cfg.speed, out / "noise.png", provenance)
    line = {name: np.array(v) for name, v in found[cfg.strongest]["timeline"].items()}
    begins, over = cfg.onset * CONTROL_DT, (cfg.onset + cfg.steps) / 2 * CONTROL_DT
    figures.timeline(
        line["anomaly"],
        beta,
        line["probability"],
        line["vision"] > 0,
        [(begins, f"{figures.noise_label(*cfg.strongest)} begins"), (over, "camera recovers")],
        "One robot loses its camera and gets it back",
        out / "timeline.png",
        provenance,
    )


def main(cfg: NoiseCfg) -> None:
    """`renet evaluate noise`."""
    show_runs(run_noise(cfg))


def show_runs(summary: dict[str, Any]) -> None:
    """Print the study's table."""
    rows = [
        (
            figures.MODE_NAMES[run["mode"]],
            figures.noise_label(run["noise"], run["level"]),
            f"{run['falls']} of {run['robots']}",
            f"{run['mean_forward_velocity']:.2f}",
            "-" if (delay := run["detection_delay_s"]) is None else f"{1000 * delay:.0f}",
        )
        for run in summary["baseline"] + summary["runs"]
    ]
    header = ("policy", "noise", "falls", "speed (m/s)", "switch delay (ms)")
    show("Camera noise on flat ground", header, rows)
