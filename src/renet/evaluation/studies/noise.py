"""The fault study's preset `noise`: the paper's noise figure, modes camera and memory."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from renet.errors import RenetError
from renet.evaluation import figures
from renet.evaluation.rollout import FLAT_GROUND, StudyMode, Trial
from renet.evaluation.studies.faults import FaultStudy, Setting
from renet.evaluation.study import Figures, Part, Table
from renet.evaluation.trace import Trace
from renet.interface import Terrain


@dataclass(frozen=True)
class NoiseStudy(FaultStudy):
    """Draw the paper's noise figure: modes camera and memory on flat ground, under six noises."""

    out: Path = Path("results/noise")
    """Folder for summary.md, summary.json, summary.csv, noise.png, timeline.png and parts/."""
    faults: tuple[str, ...] = (
        "gaussian:2",
        "gaussian:4",
        "gaussian:5",
        "salt_and_pepper:2",
        "salt_and_pepper:3",
        "salt_and_pepper:5",
    )
    """Noises, NAME:SEVERITY; the paper's are 30, 70, 100 % and 10, 30, 70 %."""
    modes: tuple[StudyMode, ...] = ("camera", "memory")
    grounds: tuple[Terrain, ...] = (FLAT_GROUND,)
    """Endless flat ground, or one kind of tile: see `faults`."""
    onsets: tuple[float, ...] = (3.0,)
    """Time at which the noise begins, s."""
    lasts: float = 6.0
    """Duration of the noise, s."""
    seconds: float = 9.0
    """Length of each run, s."""
    healthy_minutes: float = 0.0
    """Further robot minutes with a healthy camera, in which false switches are counted."""

    name: ClassVar[str] = "noise"
    retires: ClassVar[bool] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if max(map(len, self.batches.values())) > 1:
            raise RenetError("give the noise study one ground, one onset, and NAME:SEVERITY")

    def trials(self, settings: Sequence[Setting]) -> list[Trial]:
        """The fault study's trials, and one robot more, whose camera recovers half-way."""
        passing = settings[0].injection(self.lasts / 2)
        return [*super().trials(settings), Trial("memory", (passing,), 0, settings[0].ground)]

    def curves(self, trace: Trace, modes: Sequence[str]) -> Part:
        """Mean speed over time of each mode, and the timeline of the robot that recovers."""
        # The last group is the single robot that recovers, which belongs to no mode.
        groups = zip(modes, trace.groups(self.robots_each), strict=False)
        timeline = {}
        for name in ("anomaly", "probability", "vision"):
            timeline[name] = getattr(trace, name)[:, -1].astype(float)
        return {
            "speed": {mode: group.speed.mean(axis=1) for mode, group in groups},
            "timeline": timeline,
        }

    def draw(self, summary: dict[str, Any], parts: Mapping[str, Part]) -> Figures:
        """Figures noise.png and timeline.png."""
        # Parts by noise and level.
        batches = {("none", 0.0): parts["no_fault"]}
        for name, (setting,) in self.batches.items():
            batches[setting.fault, setting.level] = parts[name]
        curves: dict[str, dict[tuple[str, float], np.ndarray]] = {}
        for mode in self.modes:
            # Mode blind is in no noise's part: it walks alike under all.
            blind = parts["no_fault"]["speed"][mode]
            curves[mode] = {}
            for noise, part in batches.items():
                curves[mode][noise] = np.array(part["speed"].get(mode, blind))
        # The timeline shows the strongest Gaussian noise, if there is one.
        gaussian = [noise for noise in batches if noise[0] == "gaussian"]
        strongest = max(gaussian or list(batches)[1:], key=lambda noise: noise[1])
        onset = self.onsets[0]
        marks = [
            (onset, f"{figures.noise_label(*strongest)} begins"),
            (onset + self.lasts / 2, "camera recovers"),
        ]
        line = batches[strongest]["timeline"]
        title = "One robot loses its camera and gets it back"
        return {
            "noise.png": figures.speed_over_time(curves, onset, self.speed),
            "timeline.png": figures.timeline(line, marks, summary["beta"], title),
        }

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Falls, speed, delay and, on tiles, crossings, by mode and noise."""
        rows = []
        for run in self._rows(summary):
            row = (
                run["mode"],
                figures.noise_label(run.get("fault", "none"), run.get("level", 0.0)),
                f"{run['falls']} of {run['robots']}",
                _crossed_text(run),
                as_text(run["mean_forward_velocity"], "{:.2f}"),
                as_text(run.get("detection_delay_s"), "{:.0f}", 1000),
            )
            rows.append(row)
        header = ("mode", "noise", "falls", "crossed", "speed (m/s)", "switch delay (ms)")
        grounds = ", ".join(self.grounds).replace("_", " ")
        return [(f"Camera noise: {grounds}", header, rows)]

    def _rows(self, summary: dict[str, Any]) -> list[dict[str, Any]]:
        """Rows without noise, then those with it, mode by mode."""
        rows = list(summary["baseline"])
        for mode in self.modes:
            for run in summary["runs"]:
                if run["mode"] != mode:
                    continue
                if mode != "memory":
                    # The delay is the monitors', which robots of other modes do not obey.
                    run = run | {"detection_delay_s": None}
                rows.append(run)
        return rows


def _crossed_text(run: Mapping[str, Any]) -> str:
    """Number of robots of a row that crossed; a dash on flat ground, which has no end."""
    if run["ground"] == FLAT_GROUND:
        return "-"
    share = run["measures"]["crossed"]["value"]
    return f"{share * run['robots']:.0f} of {run['robots']}"


def as_text(value: float | None, form: str, scale: float = 1.0) -> str:
    """A number, scaled, in a format; a dash if it was not measured."""
    return "-" if value is None else form.format(scale * value)
