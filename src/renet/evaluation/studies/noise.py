"""The fault study's preset `noise`: the paper's noise figure, modes camera and memory."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from renet.errors import RenetError
from renet.evaluation import figures
from renet.evaluation.rollout import FLAT, Mode, Trial
from renet.evaluation.studies.faults import FaultStudy, Setting
from renet.evaluation.study import Figures, Part, Table
from renet.evaluation.trace import Trace
from renet.interface import Terrain


@dataclass(frozen=True)
class NoiseStudy(FaultStudy):
    """The paper's noise figure: modes camera and memory on flat ground, noise until the end."""

    out: Path = Path("results/noise")
    """Folder for summary.md, summary.json, summary.csv, noise.png, timeline.png and parts/."""
    faults: tuple[str, ...] = (
        *(f"gaussian:{severity}" for severity in (2, 4, 5)),
        *(f"salt_and_pepper:{severity}" for severity in (2, 3, 5)),
    )
    """Noises, NAME:SEVERITY; the paper's are 30, 70, 100 % and 10, 30, 70 %."""
    modes: tuple[Mode, ...] = ("camera", "memory")
    grounds: tuple[Terrain, ...] = (FLAT,)
    """Flat ground without end, or one kind of tile: see `faults`."""
    onsets: tuple[float, ...] = (3.0,)
    """Seconds at which the noise begins."""
    lasts: float = 6.0
    """Seconds after which it is over."""
    seconds: float = 9.0
    """Length of each run."""
    healthy_minutes: float = 0.0
    """Further robot minutes with a healthy camera, in which false switches are counted."""

    name: ClassVar[str] = "noise"
    retires: ClassVar[bool] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if any(len(settings) > 1 for settings in self.batches.values()):
            raise RenetError("give the noise study one ground, one onset, and NAME:SEVERITY")

    def trials(self, settings: Sequence[Setting]) -> list[Trial]:
        """As the fault study's, and one robot more, whose camera recovers half-way."""
        passing = settings[0].injection(self.lasts / 2)
        return [*super().trials(settings), Trial("memory", (passing,), 0, settings[0].ground)]

    def curves(self, trace: Trace, modes: Sequence[str]) -> Part:
        """Mean speed over time of each mode, and the timeline of the robot that recovers."""
        groups = zip(modes, trace.groups(self.robots_each), strict=False)
        return {
            "speed": {mode: group.speed.mean(axis=1) for mode, group in groups},
            "timeline": {
                name: getattr(trace, name)[:, -1].astype(float)
                for name in ("anomaly", "probability", "vision")
            },
        }

    def draw(self, summary: dict[str, Any], parts: Mapping[str, Part]) -> Figures:
        """noise.png and timeline.png."""
        batches = {("none", 0.0): parts["no_fault"]}
        for name, (setting,) in self.batches.items():
            batches[setting.fault, setting.level] = parts[name]
        curves = {
            # Blind robots walk alike under every noise.
            mode: {
                setting: np.array(part["speed"].get(mode, parts["no_fault"]["speed"][mode]))
                for setting, part in batches.items()
            }
            for mode in self.modes
        }
        gaussian = [setting for setting in batches if setting[0] == "gaussian"]
        strongest = max(gaussian or list(batches)[1:], key=lambda setting: setting[1])
        onset = self.onsets[0]
        marks = [
            (onset, f"{figures.noise_label(*strongest)} begins"),
            (onset + self.lasts / 2, "camera recovers"),
        ]
        line, title = batches[strongest]["timeline"], "One robot loses its camera and gets it back"
        return {
            "noise.png": figures.speed_over_time(curves, onset, self.speed),
            "timeline.png": figures.timeline(line, marks, summary["beta"], title),
        }

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Falls, speed and delay by mode and noise, and on tiles who crossed."""
        rows = [
            (
                run["mode"],
                figures.noise_label(run.get("fault", "none"), run.get("level", 0.0)),
                f"{run['falls']} of {run['robots']}",
                crossed(run),
                as_text(run["mean_forward_velocity"], "{:.2f}"),
                as_text(run.get("detection_delay_s"), "{:.0f}", 1000),
            )
            for run in self._rows(summary)
        ]
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
                    # Robots of other modes do not obey the monitors whose delay this is.
                    run = run | {"detection_delay_s": None}
                rows.append(run)
        return rows


def crossed(run: Mapping[str, Any]) -> str:
    """Number of robots of a row that crossed; flat ground has no end."""
    if run["ground"] == FLAT:
        return "-"
    share = run["measures"]["crossed"]["value"]
    return f"{share * run['robots']:.0f} of {run['robots']}"


def as_text(value: float | None, form: str, scale: float = 1.0) -> str:
    """A number in a format, or a dash where it was not measured."""
    return "-" if value is None else form.format(scale * value)
