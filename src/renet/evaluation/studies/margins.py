"""The margins study: largest differences from the simulated robot that a policy withstands.

Each way in which a real robot may differ is swept alone, from mild to violent, until more than 5 %
of the robots fall or stop walking, in every mode on every ground. The rest of each robot's body
stays the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product, takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import scipy

from renet.errors import RenetError, demand_name
from renet.evaluation import figures, metrics
from renet.evaluation.results import column, group_by
from renet.evaluation.rollout import robot_numbers
from renet.evaluation.settings import StudyMode, check_grounds
from renet.evaluation.study import Figures, Part, Table, WalkingStudy
from renet.interface import PHYSICS_DT, PROPRIOCEPTION, Terrain, control_steps

if TYPE_CHECKING:
    from renet.evaluation.evaluator import Evaluator
    from renet.tasks import RenetEnvCfg

ALLOWED_LOSS = 0.05
"""Share of robots that may fail within the margin."""
_STOPPED_SPEED = 0.1
"""Mean speed over the last second below which a robot has stopped walking, m/s. A robot that is
pressed to the ground does not fall."""


@dataclass(frozen=True)
class MarginAxis:
    """One way in which a robot may differ from the simulated one."""

    title: str
    """Name of the difference, in words."""
    unit: str
    """Unit of the levels; empty for a number without one."""
    levels: tuple[float, ...]
    """Levels in the axis' unit, from mild to violent."""


MARGIN_AXES = {
    "action_delay": MarginAxis("joint targets late by", "ms", (5, 10, 20, 30, 40, 60)),
    "camera_delay": MarginAxis("images late by", "ms", (100, 200, 300, 500, 800)),
    "friction": MarginAxis("friction of the feet", "", (0.5, 0.4, 0.3, 0.2, 0.1)),
    "payload": MarginAxis("payload", "kg", (3, 5, 7, 10, 14)),
    "motor_strength": MarginAxis("motor strength", "%", (80, 60, 50, 40, 30, 20)),
    "soft_gains": MarginAxis("softer servos", "%", (70, 60, 50, 40, 30)),
    "stiff_gains": MarginAxis("stiffer servos", "%", (130, 160, 200, 300, 400)),
    "joint_zeros": MarginAxis("joint zeros off by", "rad", (0.03, 0.06, 0.1, 0.15, 0.25)),
    "gravity": MarginAxis("IMU tilted by", "°", (2, 5, 10, 15, 25)),
    "gyro": MarginAxis("gyroscope's bias", "rad/s", (0.1, 0.2, 0.5, 1.0, 2.0)),
    "camera_down": MarginAxis("camera tilted down", "°", (5, 10, 15, 25, 40)),
    "camera_up": MarginAxis("camera tilted up", "°", (-5, -10, -15, -25, -40)),
}


def change(cfg: RenetEnvCfg, axis: str, level: float) -> None:
    """Set a task to a level of an axis, in the axis' unit, in place."""
    from renet.tasks.parkour_env_cfg import randomize
    from renet.tasks.sensors import depth_camera

    camera = depth_camera(cfg)
    events = cfg.events
    match axis:
        case "action_delay":
            for actuator in cfg.scene.entities["robot"].articulation.actuators:
                lag = round(level / 1e3 / PHYSICS_DT)
                actuator.delay_min_lag = lag
                actuator.delay_max_lag = lag
        case "camera_delay":
            camera.delay = (level / 1e3, level / 1e3)
        case "friction":
            events["foot_friction"].params["ranges"] = (level, level)
        case "payload":
            events["payload"].params["ranges"] = (level, level)
        case "motor_strength":
            randomize(cfg, motor_strength=1.0)
            events["motor_strength"].params["effort_limit_range"] = (level / 100, level / 100)
        case "soft_gains" | "stiff_gains":
            scale = (level / 100, level / 100)
            events["servo_gains"].params |= {"kp_range": scale, "kd_range": scale}
            # Training's draw of Kd comes later, and would replace this one.
            events.pop("damping", None)
        case "joint_zeros":
            randomize(cfg, joint_offset=level)
        case "gravity":
            # The IMU is turned about both horizontal axes.
            down = np.array((0.0, 0.0, -1.0))
            turn = (level, level, 0.0)
            reading = scipy.spatial.transform.Rotation.from_rotvec(turn, degrees=True).apply(down)
            _bias_sensor(cfg, "projected_gravity", reading - down)
        case "gyro":
            _bias_sensor(cfg, "base_angular_velocity", np.full(3, level))
        case "camera_down" | "camera_up":
            camera.mount = replace(camera.mount, pitch=camera.mount.pitch + math.radians(level))


def _bias_sensor(cfg: RenetEnvCfg, name: str, error: np.ndarray) -> None:
    """Add an error, [3], to a term of the proprioception."""
    from mjlab.utils.noise import ConstantNoiseCfg, UniformNoiseCfg

    group = cfg.observations["proprioception"]
    errors = [error if term.name == name else np.zeros(term.size) for term in PROPRIOCEPTION]
    bias = np.concatenate(errors)
    noise = ConstantNoiseCfg(bias=tuple(bias.tolist()))
    term = group.terms["value"]
    # Training's noise stays, around the bias.
    if group.enable_corruption and isinstance(term.noise, UniformNoiseCfg):
        low = np.array(term.noise.n_min) + bias
        high = np.array(term.noise.n_max) + bias
        noise = UniformNoiseCfg(n_min=tuple(low.tolist()), n_max=tuple(high.tolist()))
    group.enable_corruption = True
    term.noise = noise


@dataclass(frozen=True)
class MarginsStudy(WalkingStudy):
    """Find the differences from the simulated robot at which more than 5 % of the robots fail."""

    out: Path = Path("results/margins")
    """Folder for summary.md, summary.json, summary.csv, margins.png and parts/."""
    axes: tuple[str, ...] = tuple(MARGIN_AXES)
    """Axes to sweep, one after the other."""
    grounds: tuple[Terrain, ...] = ("flat", "stairs_up", "obstacles")
    """Ground to walk on."""
    level: int = 2
    """Level of the ground, 1 to 10."""
    modes: tuple[StudyMode, ...] = ("camera", "blind", "memory")
    seconds: float = 8.0
    """Longest run, s; a robot's run ends when it has left its tile."""

    name: ClassVar[str] = "margins"
    selectable: ClassVar[tuple[str, ...]] = ("axes",)
    quick_robots: ClassVar[int] = 4

    def __post_init__(self) -> None:
        if not self.axes:
            raise RenetError(f"axes has no name: choose among {', '.join(MARGIN_AXES)}")
        for axis in self.axes:
            demand_name("axis", axis, MARGIN_AXES)
        super().__post_init__()
        check_grounds(dict.fromkeys(self.grounds, self.level))
        if not self.grounds:
            raise RenetError("give a ground")

    def levels(self, axis: str) -> tuple[float, ...]:
        """Return the levels of a sweep; every second one with `quick`."""
        return MARGIN_AXES[axis].levels[:: 2 if self.quick else 1]

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """Return one part for the nominal robots, and one for the sweep of each axis."""
        parts = {"nominal": partial(self._sweep, evaluator, "nominal", (None,))}
        for axis in self.axes:
            parts[axis] = partial(self._sweep, evaluator, axis, self.levels(axis))
        return parts

    def _sweep(self, evaluator: Evaluator, axis: str, levels: Sequence[float | None]) -> Part:
        """Walk level after level until all groups of robots are beyond the margin."""
        runs = []
        for level in levels:
            rows = self._walk_level(evaluator, axis, level)
            runs += rows
            # Higher levels are worse.
            if min(column(rows, "failed")) > ALLOWED_LOSS:
                break
        return {"runs": runs}

    def _walk_level(
        self, evaluator: Evaluator, axis: str, level: float | None
    ) -> list[dict[str, Any]]:
        """Walk at one level of an axis, None for nominal; a row for each ground and mode."""
        cfg = evaluator.terrain_env_cfg(dict.fromkeys(self.grounds, self.level))
        if level is not None:
            change(cfg, axis, level)
        trials = self.trials_on(self.grounds)
        env = evaluator.make_env(cfg, robot_numbers(trials), self.speed, self.seed)
        title = axis if level is None else f"{axis} {level:g} {MARGIN_AXES[axis].unit}"
        trace = self.walk(evaluator, env, trials, title, retire=True)
        runs = []
        each = self.robots_each
        for trial, group in zip(trials[::each], trace.groups(each), strict=True):
            crossed, fell, _ = group.first_try()
            speed = group.forward_velocity[-control_steps(1.0) :].mean(axis=0)
            stopped = (speed < _STOPPED_SPEED) & ~crossed & ~fell
            failed = fell | stopped
            runs.append(
                {
                    "axis": axis,
                    "level": level,
                    "ground": trial.ground,
                    "mode": trial.mode,
                    "robots": each,
                    "falls": int(fell.sum()),
                    "stopped": int(stopped.sum()),
                    "failed": float(failed.mean()),
                    **metrics.with_share_interval("failed", failed),
                    "seed": self.seed,
                }
            )
        return runs

    def summarise(self, parts: Mapping[str, Part], evaluator: Evaluator) -> dict[str, Any]:
        """Return the rows, and the margin of each axis, ground and mode."""
        runs = super().summarise(parts, evaluator)["runs"]
        margins = []
        for axis in self.axes:
            unit = MARGIN_AXES[axis].unit
            for (ground, mode), rows in group_by(runs, "ground", "mode").items():
                labels = {"axis": axis, "unit": unit, "ground": ground, "mode": mode}
                margins.append(labels | margin(rows, axis, self.levels(axis)))
        return {"runs": runs, "margins": margins}

    def draw(self, summary: dict[str, Any], parts: Mapping[str, Part]) -> Figures:
        """Draw margins.png: a coloured table, one row for each axis."""
        panels = {}
        for (ground,), margins in group_by(summary["margins"], "ground").items():
            cells = {}
            for row in margins:
                place = (MARGIN_AXES[row["axis"]].title, row["mode"])
                cells[place] = (100 * row["held"], _text(row))
            panels[ground.replace("_", " ")] = cells
        share = f"{100 * ALLOWED_LOSS:.0f} %"
        title = f"How far a robot may be off before {share} fail; even: the sweep's end"
        return {"margins.png": figures.colour_tables(panels, title, width=1.2, stacked=True)}

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Tabulate the margins of each axis, by ground and mode."""
        rows = []
        for (axis,), margins in group_by(summary["margins"], "axis").items():
            rows.append((MARGIN_AXES[axis].title, *map(_text, margins)))
        header = [f"{ground} {mode}" for ground, mode in product(self.grounds, self.modes)]
        title = f"Within it at most {100 * ALLOWED_LOSS:.0f} % fall or stop; even: the sweep's end"
        return [(title, ("axis", *header), rows)]


def margin(runs: list[dict[str, Any]], axis: str, levels: tuple[float, ...]) -> dict[str, Any]:
    """Find the margin of one ground and mode on an axis, from their rows of all axes.

    Returns:
        `margin`, the last level at which at most the allowed share fails, None if more fail at the
        first level or of the nominal robots; `broke`, the next level, None at the end of the sweep;
        `held`, the margin's place in the sweep, 0 to 1.
    """
    failed = {run["level"]: run["failed"] for run in runs if run["axis"] in (axis, "nominal")}
    # None stands for the nominal robots.
    held = list(takewhile(lambda level: failed[level] <= ALLOWED_LOSS, (None, *levels)))
    # Number of levels within the margin, the nominal robots not counted.
    within = max(len(held) - 1, 0)
    return {
        "margin": held[-1] if held else None,
        "broke": levels[within] if within < len(levels) else None,
        "held": within / len(levels),
    }


def _text(row: Mapping[str, Any]) -> str:
    """Format a margin with its unit; a dash if there is none."""
    if row["margin"] is None:
        return "–"
    number = f"{abs(row['margin']):g} {row['unit']}".strip()
    return number if row["broke"] is not None else f"even {number}"
