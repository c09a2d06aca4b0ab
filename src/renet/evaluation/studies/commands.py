"""The commands study: errors of robots that follow commands on flat ground.

Each robot follows one command, a velocity and a turn rate of its base, for the whole run. The time
in which it settles does not count.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import matplotlib.pyplot as plt
import numpy as np
import tyro
from matplotlib.figure import Figure

from renet.errors import RenetError
from renet.evaluation import figures
from renet.evaluation.results import as_text, column, select
from renet.evaluation.rollout import robot_numbers
from renet.evaluation.settings import FLAT_GROUND, StudyMode
from renet.evaluation.study import Figures, Part, Table, WalkingStudy
from renet.interface import control_steps

if TYPE_CHECKING:
    from renet.evaluation.evaluator import Evaluator
    from renet.evaluation.motion import Motion

TWISTS = (
    (0.0, 0.0, 0.0),
    (0.3, 0.0, 0.0),
    (0.6, 0.0, 0.0),
    (1.0, 0.0, 0.0),
    (-0.3, 0.0, 0.0),
    (-0.6, 0.0, 0.0),
    (0.0, 0.3, 0.0),
    (0.0, -0.3, 0.0),
    (0.0, 0.0, 1.0),
    (0.0, 0.0, -1.0),
    (0.5, 0.0, 0.5),
    (0.4, 0.3, -0.5),
)
"""Commands: v_x and v_y in m/s, omega_z in rad/s, base frame."""
_SETTLE_TIME = 2.0
"""Time in which a robot settles into its command, s."""
_DRIFT_DISTANCE = 5.0
"""Distance for which drift is given, m."""
_SHORTEST_WALK = 0.5
"""Distance below which drift is not computed, m."""
_MEASURES = ("done", "speed_error", "yaw_rate_error", "drift_m", "slip", "power", "peak_torque")
"""Names of the measures of a group of robots."""


@dataclass(frozen=True)
class CommandStudy(WalkingStudy):
    """Measure the errors with which robots on flat ground follow velocities and turn rates."""

    out: Path = Path("results/commands")
    """Folder for summary.md, summary.json, summary.csv, commands.png and parts/."""
    modes: tuple[StudyMode, ...] = ("camera", "blind")
    # Hidden, because the commands are `TWISTS`: see `unused`.
    speed: tyro.conf.Suppress[float] = 0.6
    seconds: float = 8.0
    """Length of each run, s, of which the first two seconds do not count."""

    name: ClassVar[str] = "commands"
    unused: ClassVar[tuple[str, ...]] = ("speed",)
    quick_robots: ClassVar[int] = 3

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.seconds <= _SETTLE_TIME:
            raise RenetError(f"seconds must exceed {_SETTLE_TIME:g}, got {self.seconds:g}")

    @property
    def groups(self) -> list[tuple[str, tuple[float, float, float]]]:
        """Mode and command of each group of robots."""
        return list(product(self.modes, TWISTS))

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """Return one part: all robots of every command and mode, side by side."""
        return {"runs": partial(self._follow, evaluator)}

    def _follow(self, evaluator: Evaluator) -> Part:
        """Follow the commands and measure each group of robots."""
        from renet.evaluation.motion import MotionSensor

        each = self.robots_each
        trials = []
        for mode, _ in self.groups:
            trials += self.trial_group(mode)
        env = evaluator.make_env(FLAT_GROUND, robot_numbers(trials), self.speed, self.seed)
        # Every mode follows all commands, see `groups`.
        commands = np.repeat(TWISTS * len(self.modes), each, axis=0)
        sensor = MotionSensor(env)
        motions: list[Motion] = []

        def watch(step: int) -> None:
            motions.append(sensor.read())

        env.follow(commands)
        title = f"{len(trials)} robots follow commands"
        trace = self.walk(evaluator, env, trials, title, on_step=watch)
        settled = control_steps(_SETTLE_TIME)
        fell = np.any(trace.fell, axis=0)
        runs = []
        robots = np.arange(len(trials)).reshape(-1, each)
        for (mode, command), index in zip(self.groups, robots, strict=True):
            upright = index[~fell[index]]
            row = {
                "mode": mode,
                "command": list(command),
                "robots": each,
                "falls": int(fell[index].sum()),
                "seed": self.seed,
            }
            runs.append(row | summary_of(motions[settled:], upright, np.array(command)))
        return {"runs": runs}

    def draw(self, summary: dict[str, Any], parts: Mapping[str, Part]) -> Figures:
        """Draw commands.png: velocities asked for and done."""
        return {"commands.png": asked_and_done(summary["runs"], self.modes)}

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Tabulate one row for each command and mode."""
        header = ("mode", "asked", "done", "fell", "drift", "W", "N m")
        rows = []
        for run in summary["runs"]:
            asked = " ".join(f"{value:g}" for value in run["command"])
            done = "-" if run["done"] is None else " ".join(f"{v:.2f}" for v in run["done"])
            falls = f"{run['falls']} of {run['robots']}"
            measured = [as_text(run[name], ".2f") for name in ("drift_m", "power", "peak_torque")]
            rows.append((run["mode"], asked, done, falls, *measured))
        title = (
            "Commands on flat ground: m/s ahead, m/s left, rad/s; drift in m after 5 m; mean power"
        )
        return [(f"{title} and peak torque", header, rows)]


def summary_of(motions: list[Motion], robots: np.ndarray, command: np.ndarray) -> dict[str, Any]:
    """Measure robots that follow one command, by name; None if all of them fell.

    Args:
        motions: Motion of all robots at each control step.
        robots: Rows of the robots that count.
        command: The twist, [3].
    """
    if not len(robots):
        return dict.fromkeys(_MEASURES)
    # Errors are of each robot's mean twist, [N, 3]: a gait sways around it.
    done = _over_time(motions, "twist", robots).mean(axis=0)
    error = np.abs(done - command)
    return {
        "done": done.mean(axis=0),
        "speed_error": np.linalg.norm((done - command)[:, :2], axis=1).mean(),
        "yaw_rate_error": error[:, 2].mean(),
        "drift_m": drift(_over_time(motions, "position", robots), command),
        "slip": _over_time(motions, "slip", robots).mean(),
        "power": _over_time(motions, "power", robots).mean(),
        "peak_torque": _over_time(motions, "torque", robots).max(),
    }


def _over_time(motions: list[Motion], name: str, robots: np.ndarray) -> np.ndarray:
    """Stack a quantity of some robots at all control steps, [T, n, ...]."""
    return np.stack([getattr(motion, name)[robots] for motion in motions])


def drift(positions: np.ndarray, command: np.ndarray) -> float | None:
    """Compute the mean distance by which robots leave their straight way, m in 5 m.

    Args:
        positions: Positions in a frame at the start, x along the commanded heading, [T, N, 2] m.
        command: The twist, [3].

    Returns:
        The drift; None for a twist that turns or stands, and for robots that did not walk.
    """
    way = np.linalg.norm(command[:2])
    if command[2] != 0.0 or way == 0.0:
        return None
    # Unit vectors along the commanded way and to its left.
    ahead = command[:2] / way
    aside = np.array((-ahead[1], ahead[0]))
    walked = positions[-1] - positions[0]
    distance = walked @ ahead
    if distance.min() < _SHORTEST_WALK:
        return None
    return float(np.mean(np.abs(walked @ aside) / distance) * _DRIFT_DISTANCE)


def asked_and_done(runs: list[dict[str, Any]], modes: tuple[str, ...]) -> Figure:
    """Draw the velocities and turn rates asked for, as rings, and done, as dots."""
    figure, (plane, turns) = plt.subplots(1, 2, figsize=(figures.FIGURE_WIDTH, 3.6))
    for mode in modes:
        mine = [run for run in select(runs, mode=mode) if run["done"] is not None]
        if not mine:
            continue
        asked = np.array(column(mine, "command"))
        done = np.array(column(mine, "done"))
        look = {"color": figures.MODE_COLOURS[mode], "zorder": 3}
        plane.plot(done[:, 1], done[:, 0], "o", label=mode, **look)
        turns.plot(asked[:, 2], done[:, 2], "o", **look)
        for start, end in zip(asked, done, strict=True):
            plane.plot((start[1], end[1]), (start[0], end[0]), color=figures.FAINT, linewidth=1)
    # The commands are the same in all modes.
    asked = np.array(TWISTS)
    ring = {"markerfacecolor": "none", "color": figures.INK, "markersize": 10, "linestyle": ""}
    plane.plot(asked[:, 1], asked[:, 0], "o", label="asked for", **ring)
    plane.invert_xaxis()
    plane.set(xlabel="to the left (m/s)", ylabel="ahead (m/s)")
    plane.set_aspect("equal", "datalim")
    turns.plot((-1.1, 1.1), (-1.1, 1.1), color=figures.FAINT, linewidth=1)
    turns.set(xlabel="turn rate asked (rad/s)", ylabel="turn rate done (rad/s)")
    figures.legend(figure, plane)
    return figure
