"""The margins study: how far a robot may be from the simulated one before the policy falls.

Each way in which a real robot may differ is swept alone, from mild to violent, until more than 5 %
of the robots fall, or stop where they were told to walk, in every mode on every ground. The rest of
each robot's body stays the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import scipy

from renet.errors import RenetError
from renet.evaluation import figures, metrics
from renet.evaluation.results import grouped
from renet.evaluation.rollout import Mode, check_grounds
from renet.evaluation.study import Figures, Part, Table, WalkingStudy
from renet.interface import CONTROL_DT, PHYSICS_DT, PROPRIOCEPTION, Terrain

if TYPE_CHECKING:
    from renet.evaluation.evaluator import Evaluator
    from renet.tasks import RenetEnvCfg

ALLOWED = 0.05
"""Share of robots that may fail within the margin."""
STOPPED = 0.1
"""m/s over the last second below which a robot no longer walks: one that is pressed to the ground
does not tip over."""


@dataclass(frozen=True)
class Axis:
    """One way a robot may differ from the simulated one."""

    title: str
    unit: str
    levels: tuple[float, ...]
    """From mild to violent."""


AXES = {
    "action_delay": Axis("joint targets late by", "ms", (5, 10, 20, 30, 40, 60)),
    "camera_delay": Axis("images late by", "ms", (100, 200, 300, 500, 800)),
    "friction": Axis("friction of the feet", "", (0.5, 0.4, 0.3, 0.2, 0.1)),
    "payload": Axis("payload", "kg", (3, 5, 7, 10, 14)),
    "motor_strength": Axis("motor strength", "%", (80, 60, 50, 40, 30, 20)),
    "soft_gains": Axis("softer servos", "%", (70, 60, 50, 40, 30)),
    "stiff_gains": Axis("stiffer servos", "%", (130, 160, 200, 300, 400)),
    "joint_zeros": Axis("joint zeros off by", "rad", (0.03, 0.06, 0.1, 0.15, 0.25)),
    "gravity": Axis("IMU tilted by", "°", (2, 5, 10, 15, 25)),
    "gyro": Axis("gyroscope's bias", "rad/s", (0.1, 0.2, 0.5, 1.0, 2.0)),
    "camera_down": Axis("camera tilted down", "°", (5, 10, 15, 25, 40)),
    "camera_up": Axis("camera tilted up", "°", (-5, -10, -15, -25, -40)),
}


def change(cfg: RenetEnvCfg, axis: str, level: float) -> None:
    """Change a task's configuration to a level of an axis, in the axis' unit."""
    from renet.tasks.parkour_env_cfg import randomize
    from renet.tasks.sensors import depth_camera

    camera, events = depth_camera(cfg), cfg.events
    match axis:
        case "action_delay":
            for actuator in cfg.scene.entities["robot"].articulation.actuators:
                actuator.delay_min_lag = actuator.delay_max_lag = round(level / 1e3 / PHYSICS_DT)
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
        case "joint_zeros":
            randomize(cfg, joint_offset=level)
        case "gravity":  # Mounted with a turn about each horizontal axis.
            down, turn = np.array((0.0, 0.0, -1.0)), (level, level, 0.0)
            turned = scipy.spatial.transform.Rotation.from_rotvec(turn, degrees=True).apply(down)
            _bias_sensor(cfg, "projected_gravity", turned - down)
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
    noise, term = ConstantNoiseCfg(bias=tuple(bias.tolist())), group.terms["value"]
    if group.enable_corruption and isinstance(term.noise, UniformNoiseCfg):
        low, high = np.array(term.noise.n_min) + bias, np.array(term.noise.n_max) + bias
        noise = UniformNoiseCfg(n_min=tuple(low.tolist()), n_max=tuple(high.tolist()))
    group.enable_corruption, term.noise = True, noise


@dataclass(frozen=True)
class MarginsStudy(WalkingStudy):
    """How far a robot may be from the simulated one before more than 5 % of the robots fail."""

    out: Path = Path("results/margins")
    """Folder for summary.md, summary.json, summary.csv, margins.png and parts/."""
    axes: tuple[str, ...] = tuple(AXES)
    """What is swept, one after the other."""
    grounds: tuple[Terrain, ...] = ("flat", "stairs_up", "obstacles")
    """Ground to walk on."""
    level: int = 2
    """Level of the ground, 1 to 10."""
    modes: tuple[Mode, ...] = ("camera", "blind", "memory")
    seconds: float = 8.0
    """Time of each robot, or until it has left its tile."""

    name: ClassVar[str] = "margins"
    selectable: ClassVar[tuple[str, ...]] = ("axes",)
    quick_robots: ClassVar[int] = 4

    def __post_init__(self) -> None:
        unknown = [axis for axis in self.axes if axis not in AXES]
        if unknown or not self.axes:
            raise RenetError(f"axes {self.axes}: choose among {', '.join(AXES)}")
        super().__post_init__()
        check_grounds(dict.fromkeys(self.grounds, self.level))
        if self.seconds < CONTROL_DT or not self.grounds:
            raise RenetError("seconds must be positive, and a ground given")

    def levels(self, axis: str) -> tuple[float, ...]:
        """Levels of a sweep, after `quick`."""
        return AXES[axis].levels[:: 2 if self.quick else 1]

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """The robots as they are simulated, then one sweep for each axis."""
        sweeps = {axis: partial(self._sweep, evaluator, axis) for axis in self.axes}
        return {"nominal": lambda: {"runs": self._walk(evaluator, "nominal", None)}} | sweeps

    def _sweep(self, evaluator: Evaluator, axis: str) -> Part:
        """Level after level until no group of robots is within the margin any more."""
        runs = []
        for level in self.levels(axis):
            walked = self._walk(evaluator, axis, level)
            runs += walked
            if all(run["failed"] > ALLOWED for run in walked):
                break
        return {"runs": runs}

    def _walk(self, evaluator: Evaluator, axis: str, level: float | None) -> list[dict[str, Any]]:
        """One level of one axis: a row for each ground and mode."""
        cfg = evaluator.terrain_env_cfg(dict.fromkeys(self.grounds, self.level))
        if level is not None:
            change(cfg, axis, level)
        trials = self.trials_on(self.grounds)
        env = evaluator.make_env(cfg, [trial.robot for trial in trials], self.speed, self.seed)
        env.place_on([trial.ground for trial in trials])
        title = axis if level is None else f"{axis} {level:g} {AXES[axis].unit}"
        steps = round(self.seconds / CONTROL_DT)
        trace = evaluator.rollout(env, trials, self.seed).run(steps, title, retire=True)
        runs = []
        each = self.robots_each
        for trial, group in zip(trials[::each], trace.groups(each), strict=True):
            crossed, fell, _ = group.first_try()
            slow = group.forward_velocity[-round(1.0 / CONTROL_DT) :].mean(axis=0) < STOPPED
            stopped = slow & ~crossed & ~fell
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
        """The rows, and how far each ground and mode holds on each axis."""
        runs = [run for part in parts.values() for run in part["runs"]]
        margins = [
            {"axis": axis, "unit": AXES[axis].unit, "ground": ground, "mode": mode}
            | margin(rows, axis, self.levels(axis))
            for axis in self.axes
            for (ground, mode), rows in grouped(runs, "ground", "mode").items()
        ]
        return {"runs": runs, "margins": margins}

    def draw(self, summary: dict[str, Any], parts: Mapping[str, Part]) -> Figures:
        """margins.png: a table of colours, one row for each axis."""
        panels = {
            ground.replace("_", " "): {
                (AXES[m["axis"]].title, m["mode"]): (100 * m["held"], _text(m)) for m in margins
            }
            for (ground,), margins in grouped(summary["margins"], "ground").items()
        }
        title = (
            f"How far a robot may be off before {100 * ALLOWED:.0f} % fail; even: the sweep's end"
        )
        return {"margins.png": figures.colour_tables(panels, title, width=0.95)}

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """How far each ground and mode holds."""
        rows = [
            (AXES[axis].title, *map(_text, margins))
            for (axis,), margins in grouped(summary["margins"], "axis").items()
        ]
        header = (f"{ground} {mode}" for ground in self.grounds for mode in self.modes)
        title = f"Within it at most {100 * ALLOWED:.0f} % fall or stop; even: the sweep's end"
        return [(title, ("axis", *header), rows)]


def margin(runs: list[dict[str, Any]], axis: str, levels: tuple[float, ...]) -> dict[str, Any]:
    """How far robots of one ground and mode hold on an axis, from their rows of all axes.

    Returns:
        `margin`, the last level before more than the allowed share fell, None where that is so at
        the first or for the nominal robots; `broke`, the level at which it was, None at the end of
        the sweep; `held`, the margin's place in the sweep, 0 to 1.
    """
    failed = {run["level"]: run["failed"] for run in runs if run["axis"] in (axis, "nominal")}
    held = list(takewhile(lambda level: failed[level] <= ALLOWED, (None, *levels)))
    within = max(len(held) - 1, 0)
    return {
        "margin": held[-1] if held else None,
        "broke": levels[within] if within < len(levels) else None,
        "held": within / len(levels),
    }


def _text(row: Mapping[str, Any]) -> str:
    """A margin as people write it."""
    if row["margin"] is None:
        return "–"
    number = f"{abs(row['margin']):g} {row['unit']}".strip()
    return number if row["broke"] is not None else f"even {number}"
