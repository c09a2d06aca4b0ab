"""The fault study's preset `noise`: the paper's noise figure, modes camera and memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from renet.errors import RenetError
from renet.evaluation import figures
from renet.evaluation.results import as_text
from renet.evaluation.rollout import Trial
from renet.evaluation.settings import FLAT_GROUND, StudyMode
from renet.evaluation.studies.fault_settings import Setting
from renet.evaluation.studies.faults import FaultStudy
from renet.evaluation.study import Figures, Part, Table
from renet.evaluation.trace import Trace
from renet.faults import fault_class
from renet.interface import CONTROL_DT, Terrain
from renet.palette import BLIND_COLOUR, SEES_COLOUR

if TYPE_CHECKING:
    from renet.evaluation.evaluator import Evaluator

_LOSS = "#3c3ca0"
"""Colour of the anomaly score."""
_PROBABILITY = "#64aa5f"
"""Colour of the vision probability."""
_NOISE_COLOURS = {
    "gaussian": ("#9ecae1", "#4292c6", "#084594"),
    "salt_and_pepper": ("#fdae6b", "#f16913", "#a63603"),
}
"""Colours of each noise, in the order of its levels."""


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
        """Return the fault study's trials, and one robot more, whose camera recovers half-way."""
        passing = settings[0].injection(self.lasts / 2)
        return [*super().trials(settings), Trial("memory", (passing,), 0, settings[0].ground)]

    def curves(self, trace: Trace, modes: Sequence[str]) -> Part:
        """Return each mode's mean speed over time, and the timeline of the robot that recovers."""
        # The last group is the single robot that recovers, which belongs to no mode.
        groups = zip(modes, trace.groups(self.robots_each), strict=False)
        timeline = {}
        for name in ("anomaly", "probability", "vision"):
            timeline[name] = getattr(trace, name)[:, -1].astype(float)
        return {
            "speed": {mode: group.speed.mean(axis=1) for mode, group in groups},
            "timeline": timeline,
        }

    def summarise(self, parts: Mapping[str, Part], evaluator: Evaluator) -> dict[str, Any]:
        """Return the fault study's summary, and the name of the threshold that `beta` is."""
        # A bundle that predicts a variance judges images by it, and mode switch alone by beta.
        judges = "reconstruction" in evaluator.thresholds
        name = "threshold β" if judges else "threshold β of mode switch"
        return super().summarise(parts, evaluator) | {"beta_name": name}

    def draw(self, summary: dict[str, Any], parts: Mapping[str, Part]) -> Figures:
        """Draw noise.png and timeline.png."""
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
            (onset, f"{noise_label(*strongest)} begins"),
            (onset + self.lasts / 2, "camera recovers"),
        ]
        line = batches[strongest]["timeline"]
        title = "One robot loses its camera and gets it back"
        threshold = (summary["beta_name"], summary["beta"])
        return {
            "noise.png": speed_over_time(curves, onset, self.speed),
            "timeline.png": draw_timeline(line, marks, threshold, title),
        }

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Tabulate falls, speed, delay and, on tiles, crossings, by mode and noise."""
        rows = []
        for run in self._rows(summary):
            row = (
                run["mode"],
                noise_label(run.get("fault", "none"), run.get("level", 0.0)),
                f"{run['falls']} of {run['robots']}",
                _crossed_text(run),
                as_text(run["mean_forward_velocity"], ".2f"),
                as_text(run.get("detection_delay_s"), ".0f", 1000),
            )
            rows.append(row)
        header = ("mode", "noise", "falls", "crossed", "speed (m/s)", "switch delay (ms)")
        grounds = ", ".join(self.grounds).replace("_", " ")
        return [(f"Camera noise: {grounds}", header, rows)]

    def _rows(self, summary: dict[str, Any]) -> list[dict[str, Any]]:
        """List rows without noise, then those with it, mode by mode."""
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
    """Say how many robots of a row crossed; a dash on flat ground, which has no end."""
    if run["ground"] == FLAT_GROUND:
        return "-"
    share = run["measures"]["crossed"]["value"]
    return f"{share * run['robots']:.0f} of {run['robots']}"


def noise_label(noise: str, level: float) -> str:
    """Return the label of a noise setting as in the paper, such as "GA 30 %"."""
    if noise == "none":
        return "no noise"
    short = {"gaussian": "GA", "salt_and_pepper": "SP"}.get(noise)
    if short is None:
        return f"{noise}, {fault_class(noise).describe(float(level))}"
    return f"{short} {100 * level:.0f} %"


def speed_over_time(
    curves: Mapping[str, Mapping[tuple[str, float], np.ndarray]], onset: float, command: float
) -> Figure:
    """Draw mean forward velocity against timestep, as the paper does, a panel for each mode.

    Args:
        curves: Mean speed of the robots, [T] m/s, by mode, and by noise and level.
        onset: Time at which the noise begins, s.
        command: Commanded speed, m/s.
    """
    size = (figures.FIGURE_WIDTH, 2.6 * len(curves) + 1.0)
    figure, axes = plt.subplots(
        len(curves), 1, figsize=size, sharex=True, sharey=True, squeeze=False
    )
    column_of_axes = axes[:, 0]
    for axis, letter, (mode, settings) in zip(
        column_of_axes, "abcdef", curves.items(), strict=False
    ):
        shades = {noise: cycle(_NOISE_COLOURS.get(noise, ("#7d8590",))) for noise, _ in settings}
        for (noise, level), speed in settings.items():
            look: Any = {"color": next(shades[noise]), "label": noise_label(noise, level)}
            axis.plot(_smooth(speed), "--" if noise == "none" else "-", **look)
        axis.axvline(onset / CONTROL_DT, color=figures.INK, linewidth=1, linestyle=":")
        axis.axhline(command, color=figures.FAINT, linewidth=1, linestyle=(0, (1, 3)))
        _write_beside(axis, onset / CONTROL_DT, "noise begins", 0.0, xytext=(4, 5))
        axis.set(title=f"({letter}) {mode}", ylabel="mean forward\nvelocity (m/s)")
    column_of_axes[-1].set_xlabel("timestep (0.02 s)")
    figures.legend(figure, column_of_axes[0])
    return figure


def _smooth(values: np.ndarray) -> np.ndarray:
    """Take the centred moving mean over about half a gait cycle, shorter at both ends."""
    kernel = np.ones(13)
    total = np.convolve(values, kernel, "same")
    return total / np.convolve(np.ones_like(values), kernel, "same")


def draw_timeline(
    line: Mapping[str, Any],
    marks: Sequence[tuple[float, str]],
    threshold: tuple[str, float],
    title: str,
) -> Figure:
    """Draw one robot's timeline as the paper does: loss, threshold, estimator in charge and P.

    Args:
        line: `anomaly`, `probability` and `vision` (VP in charge) at each control step, [T] each.
        marks: Times to point out, s, with their texts.
        threshold: Name and value of a threshold on the anomaly score.
        title: Title of the figure.
    """
    figure, axis = plt.subplots(figsize=(11, 3.7))
    name, beta = threshold
    vision = np.array(line["vision"], bool)
    # A robot has no score before its first tick, which a logarithmic axis would show as a dive.
    anomaly = np.array(line["anomaly"], float)
    anomaly[anomaly <= 0] = np.nan
    time = np.arange(len(anomaly)) * CONTROL_DT
    height = axis.get_xaxis_transform()
    axis.plot(time, anomaly, color=_LOSS, label="reconstruction loss")
    axis.axhline(beta, color="black", linestyle="--", linewidth=1.2, label=name)
    for acts, colour, label in (
        (vision, SEES_COLOUR, "VP in charge"),
        (~vision, BLIND_COLOUR, "OP in charge"),
    ):
        look = {"color": colour, "alpha": 0.3, "linewidth": 0, "label": label}
        # A step's colour reaches until the next step.
        until_next = acts | np.insert(acts[:-1], 0, False)
        axis.fill_between(time, 0, 1, until_next, step="post", transform=height, **look)
    # Leave room above the curve for the marks' texts.
    top = 4 * np.max(anomaly, where=~np.isnan(anomaly), initial=beta)
    axis.set(yscale="log", ylim=(None, top), xlim=(0, time[-1]))
    figures.label_log_ticks(axis.yaxis)
    axis.set(title=title, xlabel="time (s)", ylabel="anomaly score")
    for instant, text in marks:
        axis.axvline(instant, color=figures.INK, linewidth=1, linestyle=":")
        _write_beside(axis, instant, text, 1.0, xytext=(3, -10))
    right = axis.twinx()
    label = "vision probability P"
    right.plot(time, np.array(line["probability"]), "--", color=_PROBABILITY, label=label)
    right.set(ylim=(-0.05, 1.25), yticks=np.linspace(0, 1, 6))
    right.set_ylabel("P", color=_PROBABILITY)
    right.grid(False)
    figures.legend(figure, axis, right)
    return figure


def _write_beside(axis: Axes, instant: float, text: str, height: float, **look: Any) -> None:
    """Write a text beside an instant, at a share of the axis' height."""
    look = {"xytext": (0, 0), "textcoords": "offset points", "fontsize": 7.5} | look
    axis.annotate(text, (instant, height), xycoords=("data", "axes fraction"), **look)
