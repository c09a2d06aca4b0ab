"""The commands study: how closely a robot follows what it is told on flat ground.

Each robot follows one command, a velocity and a turn rate of its base, for the whole run. What it
does while it settles does not count.
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
from matplotlib.figure import Figure

from renet.errors import RenetError
from renet.evaluation import figures
from renet.evaluation.rollout import FLAT, Mode, Trial
from renet.evaluation.study import Figures, Part, Table, WalkingStudy
from renet.interface import CONTROL_DT

if TYPE_CHECKING:
    from renet.evaluation.evaluator import Evaluator
    from renet.evaluation.motion import Motion

COMMANDS = (
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
"""Twists: v_x and v_y in m/s, omega_z in rad/s, base frame."""
SETTLE = 2.0
"""Seconds in which a robot may get used to its command."""
LONG_WAY = 5.0
"""Distance for which drift is given, m."""
SHORTEST_WAY = 0.5
"""Distance that robots must have walked for their drift to mean something, m."""


@dataclass(frozen=True)
class CommandStudy(WalkingStudy):
    """How closely robots on flat ground follow velocities and turn rates."""

    out: Path = Path("results/commands")
    """Folder for summary.md, summary.json, summary.csv, commands.png and parts/."""
    modes: tuple[Mode, ...] = ("camera", "blind")
    seconds: float = 8.0
    """Length of each run, of which the first two seconds do not count."""

    name: ClassVar[str] = "commands"
    quick_robots: ClassVar[int] = 3

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.seconds <= SETTLE:
            raise RenetError(f"seconds must exceed {SETTLE:g}, got {self.seconds:g}")

    @property
    def groups(self) -> list[tuple[str, tuple[float, float, float]]]:
        """Mode and command of each group of robots."""
        return list(product(self.modes, COMMANDS))

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """All robots of every command and mode, side by side."""
        return {"runs": partial(self._follow, evaluator)}

    def _follow(self, evaluator: Evaluator) -> Part:
        from renet.evaluation.motion import MotionSensor

        each = self.robots_each
        trials = [Trial(mode, robot=robot) for mode, _ in self.groups for robot in range(each)]
        env = evaluator.make_env(FLAT, [trial.robot for trial in trials], self.speed, self.seed)
        commands = np.repeat([command for _, command in self.groups], each, axis=0)
        sensor = MotionSensor(env)
        motions: list[Motion] = []

        def watch(step: int) -> None:
            motions.append(sensor.read())

        env.follow(commands)
        rollout = evaluator.rollout(env, trials, self.seed)
        steps = round(self.seconds / CONTROL_DT)
        trace = rollout.run(steps, f"{len(trials)} robots follow commands", on_step=watch)
        settled = round(SETTLE / CONTROL_DT)
        fell = np.any(trace.fell, axis=0)
        runs = []
        robots = np.arange(len(trials)).reshape(-1, each)
        for (mode, command), index in zip(self.groups, robots, strict=True):
            stood = index[~fell[index]]
            row = {"mode": mode, "command": list(command), "robots": each}
            row |= {"falls": int(fell[index].sum()), "seed": self.seed}
            runs.append(row | summary_of(motions[settled:], stood, np.array(command)))
        return {"runs": runs}

    def summarise(self, parts: Mapping[str, Part], evaluator: Evaluator) -> dict[str, Any]:
        """The rows."""
        return {"runs": parts["runs"]["runs"], "settle_s": SETTLE}

    def draw(self, summary: dict[str, Any], parts: Mapping[str, Part]) -> Figures:
        """What was asked for and what was done."""
        return {"commands.png": asked_and_done(summary["runs"], self.modes)}

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """One row for each command and mode."""
        header = ("mode", "asked", "done", "fell", "drift", "W", "N m")
        rows = []
        for run in summary["runs"]:
            asked = " ".join(f"{value:g}" for value in run["command"])
            done = "-" if run["done"] is None else " ".join(f"{v:.2f}" for v in run["done"])
            numbers = [run[name] for name in ("drift_m", "power", "peak_torque")]
            shown = ["-" if n is None else f"{n:.2f}" for n in numbers]
            falls = f"{run['falls']} of {run['robots']}"
            rows.append((run["mode"], asked, done, falls, *shown))
        title = (
            "Commands on flat ground: m/s ahead, m/s left, rad/s; drift in m after 5 m; mean power"
        )
        return [(f"{title} and peak torque", header, rows)]


def summary_of(motions: list[Motion], robots: np.ndarray, command: np.ndarray) -> dict[str, Any]:
    """What robots did that were told one command, by name; None where all of them fell.

    Args:
        motions: at each control step. robots: rows that count. command: the twist, [3].
    """
    names = ("done", "speed_error", "yaw_rate_error", "drift_m", "slip", "power", "peak_torque")
    if not len(robots):
        return dict.fromkeys(names)
    twist = np.stack([motion.twist[robots] for motion in motions])
    done = twist.mean(axis=0)
    error = np.abs(done - command)
    values = {
        "done": done.mean(axis=0),
        "speed_error": np.linalg.norm((done - command)[:, :2], axis=1).mean(),
        "yaw_rate_error": error[:, 2].mean(),
        "drift_m": drift(np.stack([motion.position[robots] for motion in motions]), command),
        "slip": np.mean([motion.slip[robots] for motion in motions]),
        "power": np.mean([motion.power[robots] for motion in motions]),
        "peak_torque": np.max([motion.torque[robots] for motion in motions]),
    }
    return {name: values[name] for name in names}


def drift(positions: np.ndarray, command: np.ndarray) -> float | None:
    """Mean distance by which robots leave their straight way, m in LONG_WAY m.

    Args:
        positions: [T, N, 2] m, in the frame in which each robot started, x behind it.
        command: the twist, [3]; None is returned for one that turns or stands, and where robots
            did not walk.
    """
    way = np.linalg.norm(command[:2])
    if command[2] != 0.0 or way == 0.0:
        return None
    ahead = command[:2] / way
    aside = np.array((-ahead[1], ahead[0]))
    walked = positions[-1] - positions[0]
    distance = walked @ ahead
    if distance.min() < SHORTEST_WAY:
        return None
    return float(np.mean(np.abs(walked @ aside) / distance) * LONG_WAY)


def asked_and_done(runs: list[dict[str, Any]], modes: tuple[str, ...]) -> Figure:
    """Velocities and turn rates that were asked for, as rings, and done, as dots."""
    figure, (plane, turns) = plt.subplots(1, 2, figsize=(9, 4.2))
    for mode in modes:
        mine = [run for run in runs if run["mode"] == mode and run["done"] is not None]
        if not mine:
            continue
        asked = np.array([run["command"] for run in mine])
        done = np.array([run["done"] for run in mine])
        look = {"color": figures.MODE_COLOURS[mode], "zorder": 3}
        plane.plot(done[:, 1], done[:, 0], "o", label=mode, **look)
        turns.plot(asked[:, 2], done[:, 2], "o", **look)
        for start, end in zip(asked, done, strict=True):
            plane.plot((start[1], end[1]), (start[0], end[0]), color=figures.FAINT, linewidth=1)
    asked = np.array(COMMANDS)
    ring = {"markerfacecolor": "none", "color": figures.INK, "markersize": 10, "linestyle": ""}
    plane.plot(asked[:, 1], asked[:, 0], "o", label="asked for", **ring)
    plane.invert_xaxis()
    plane.set(xlabel="sideways, left to the left (m/s)", ylabel="ahead (m/s)")
    plane.set_aspect("equal", "datalim")
    turns.plot((-1.1, 1.1), (-1.1, 1.1), color=figures.FAINT, linewidth=1)
    turns.set(xlabel="turn rate asked for (rad/s)", ylabel="turn rate done (rad/s)")
    figures.legend(figure, plane)
    return figure
