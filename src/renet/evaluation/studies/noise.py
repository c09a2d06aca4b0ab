"""The fault study's preset `noise`: the paper's comparison of RENet with the VP estimator alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from renet.evaluation.report import figures
from renet.evaluation.report.page import noise_rows
from renet.evaluation.results import Provenance
from renet.evaluation.rollout import Trial
from renet.evaluation.studies.faults import FaultStudy, Setting
from renet.evaluation.study import Part, Table
from renet.evaluation.trace import Trace
from renet.faults import Injection, fault_class
from renet.interface import CONTROL_DT


@dataclass(frozen=True)
class NoiseStudy(FaultStudy):
    """The paper's noise figure: VP alone against RENet on flat ground, noise until the end."""

    out: Path = Path("results/noise")
    """Folder for summary.json, summary.csv, noise.png, timeline.png and parts/."""
    faults: tuple[str, ...] = (
        *(f"gaussian:{severity}" for severity in (2, 4, 5)),
        *(f"salt_and_pepper:{severity}" for severity in (2, 3, 5)),
    )
    """Noises, NAME:SEVERITY; the paper's are 30, 70, 100 % and 10, 30, 70 %."""
    modes: tuple[str, ...] = ("vp", "renet")
    """Policy modes to compare: vp, renet, op, oracle-switch."""
    onset: float = 3.0
    """Seconds at which the noise begins."""
    fault_end: float = 9.0
    """Seconds at which it is over at the latest."""
    seconds: float = 9.0
    """Length of each run."""
    healthy_minutes: float = 0.0
    """Further robot minutes with a healthy camera, in which false switches are counted."""

    name: ClassVar[str] = "noise"
    quick_robots: ClassVar[int] = 5

    def trials(self, settings: list[Setting], faulty: bool = True) -> list[Trial]:
        """As the fault study's, and one robot more, whose camera recovers half-way."""
        lasts = (self.steps - self.onset_step) * CONTROL_DT / 2
        passing = (Injection.of(*settings[0], self.onset_step, lasts),) if faulty else ()
        return [*super().trials(settings, faulty), Trial("renet", passing)]

    def curves(self, trace: Trace) -> Part:
        """Mean speed over time of each mode, and the timeline of the robot that recovers."""
        each = self.robots_each
        return {
            "speed": {
                mode: trace.speed[:, number * each : (number + 1) * each].mean(axis=1)
                for number, mode in enumerate(self.modes)
            },
            "timeline": {
                name: getattr(trace, name)[:, -1].astype(float)
                for name in ("anomaly", "probability", "vision")
            },
        }

    def draw(
        self, summary: dict[str, Any], parts: Mapping[str, Part], provenance: Provenance
    ) -> None:
        """Write noise.png and timeline.png."""
        batches = {
            (settings[0][0], fault_class(settings[0][0]).level_of(settings[0][1])): parts[name]
            for name, settings in self.batches.items()
        }
        batches = {("none", 0.0): parts[f"no_fault_{self.terrain}"]} | batches
        curves = {
            mode: {setting: np.array(part["speed"][mode]) for setting, part in batches.items()}
            for mode in self.modes
        }
        path = self.out / "noise.png"
        figures.speed_over_time(curves, self.onset_step, self.speed, path, provenance)
        gaussian = [setting for setting in batches if setting[0] == "gaussian"]
        strongest = max(gaussian or list(batches)[1:], key=lambda setting: setting[1])
        line = {name: np.array(v) for name, v in batches[strongest]["timeline"].items()}
        marks = [
            (self.onset, f"{figures.noise_label(*strongest)} begins"),
            ((self.onset + self.seconds) / 2, "camera recovers"),
        ]
        figures.timeline(
            line["anomaly"],
            summary["beta"],
            line["probability"],
            line["vision"] > 0,
            marks,
            "One robot loses its camera and gets it back",
            self.out / "timeline.png",
            provenance,
        )

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Falls, speed and delay by mode and noise."""
        rows = [
            (
                figures.MODE_NAMES[run["mode"]],
                figures.noise_label(run.get("fault", "none"), run.get("level", 0.0)),
                f"{run['falls']} of {run['robots']}",
                f"{run['mean_forward_velocity']:.2f}",
                "-" if (s := run["detection_delay_s"]) is None else f"{1000 * s:.0f}",
            )
            for run in noise_rows(summary)
        ]
        header = ("policy", "noise", "falls", "speed (m/s)", "switch delay (ms)")
        return [("Camera noise on flat ground", header, rows)]
