"""The standing study: robots walk, are commanded c_x = 0, and should stop and stand still.

The paper's second level of commands (Method C) asks for it on uneven ground, where goal-guided
rewards otherwise leave a robot stepping on the spot. Judged by true poses.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any, ClassVar

import matplotlib.pyplot as plt
import numpy as np

from renet.errors import RenetError
from renet.evaluation import figures
from renet.evaluation.env import FLAT, PARKOUR
from renet.evaluation.evaluator import Evaluator
from renet.evaluation.rollout import StepResult
from renet.evaluation.study import Figures, Part, Table, WalkingStudy
from renet.interface import CONTROL_DT
from renet.terrain.tiles import LEVELS, tiles

DRIFT, MOVING = 0.1, 0.2
"""A robot stands still that drifts less than this, m, with joints slower than this on average,
rad/s, from the moment it has had time to stop."""


@dataclass(frozen=True)
class StandingStudy(WalkingStudy):
    """Whether a robot that is commanded to stand does, and stands still."""

    out: Path = Path("results/standing")
    """Folder for summary.json, summary.csv, standing.png and parts/."""
    kinds: tuple[str, ...] = (FLAT, "rough", "obstacles", "stairs_up", "stairs_down")
    """Ground to stop on: flat, rough, obstacles, stairs_up, stairs_down, gap, platform."""
    level: int = 3
    """Of the ground, 1 to 10."""
    modes: tuple[str, ...] = ("vp", "op")
    """Policy modes to compare: vp, renet, op, paper, oracle-switch."""
    walk: float = 3.0
    """Seconds before the command to stand."""
    settle: float = 1.5
    """Seconds a robot has for stopping."""
    stand: float = 6.0
    """Seconds it must stand."""

    name: ClassVar[str] = "standing"

    def __post_init__(self) -> None:
        unknown = [kind for kind in self.kinds if kind not in (FLAT, *tiles())]
        if unknown or not self.kinds:
            raise RenetError(f"kinds {self.kinds}: choose among {FLAT}, {', '.join(tiles())}")
        super().__post_init__()
        if not 1 <= self.level <= LEVELS:
            raise RenetError(f"level must be 1 to {LEVELS}, got {self.level}")
        if min(self.walk, self.settle, self.stand) < 0.1:
            raise RenetError("walk, settle and stand must be at least 0.1 s")

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """All robots of every ground and mode, side by side."""
        return {"runs": partial(self._stand, evaluator)}

    def _stand(self, evaluator: Evaluator) -> Part:
        each, trials = self.robots_each, self.trials_on(self.kinds)
        robots = [trial.robot for trial in trials]
        env = evaluator.make_env(PARKOUR, robots, self.speed, self.seed)
        # The first level of rough ground has no relief.
        levels = [0 if trial.ground == FLAT else self.level - 1 for trial in trials]
        kinds = ["rough" if trial.ground == FLAT else trial.ground for trial in trials]
        env.place(np.array(levels), np.array([list(tiles()).index(kind) for kind in kinds]))
        seconds = np.cumsum((self.walk, self.settle, self.stand))
        stop, settled, steps = np.round(seconds / CONTROL_DT).astype(int)
        taken = count(1)

        def command_to_stand(result: StepResult) -> None:
            if next(taken) == stop:
                env.command(0.0)

        title, film = f"{len(trials)} robots walk and stand", range(len(trials))
        trace = evaluator.rollout(
            title, env, trials, steps, self.seed, film=film, on_step=command_to_stand
        )
        assert trace.film is not None
        drift, joint_speed = stillness(trace.film.poses, settled)
        fell = np.any(trace.fell[stop:], axis=0)
        # One that fell or left its tile starts anew elsewhere, which is not standing.
        gone = np.any(trace.ended[stop:], axis=0)
        still = ~gone & (drift[-1] < DRIFT) & (joint_speed[settled:].mean(axis=0) < MOVING)
        runs = []
        groups = np.arange(len(trials)).reshape(-1, each)
        for trial, own in zip(trials[::each], groups, strict=True):
            stayed = own[~gone[own]]
            speed = joint_speed[settled:, stayed]
            runs.append(
                {
                    "kind": trial.ground,
                    "level": 1 if trial.ground == FLAT else self.level,
                    "mode": trial.mode,
                    "robots": each,
                    "still": int(still[own].sum()),
                    "falls": int(fell[own].sum()),
                    "drift_m": float(np.median(drift[-1, stayed])) if stayed.size else None,
                    "joint_speed_rad_per_s": float(speed.mean()) if stayed.size else None,
                    "seed": self.seed,
                }
            )
        curves = joint_speed.reshape(len(joint_speed), -1, each).mean(axis=-1)
        return {"runs": runs, "joint_speed": curves}

    def summarise(self, parts: Mapping[str, Part], evaluator: Evaluator) -> dict[str, Any]:
        """The rows, and the criteria of standing still."""
        return {"runs": parts["runs"]["runs"], "drift_m": DRIFT, "moving_rad_per_s": MOVING}

    def draw(self, summary: dict[str, Any], parts: Mapping[str, Part]) -> Figures:
        """standing.png: how fast joints move before and after the command, by ground."""
        curves = np.array(parts["runs"]["joint_speed"])
        seconds = np.arange(len(curves)) * CONTROL_DT - self.walk
        size = (2.2 * len(self.kinds) + 1, 3.2)
        figure, axes = plt.subplots(1, len(self.kinds), figsize=size, sharey=True, squeeze=False)
        for place, (axis, kind) in enumerate(zip(axes[0], self.kinds, strict=True)):
            for number, mode in enumerate(self.modes):
                curve = figures.smooth(curves[:, place * len(self.modes) + number])
                label, colour = figures.MODE_NAMES[mode], figures.MODE_COLOURS[mode]
                axis.plot(seconds, curve, color=colour, label=label)
            axis.axvline(0.0, color=figures.INK, linewidth=1, linestyle=":")
            axis.set(title=kind.replace("_", " "), xlabel="s after the command")
        axes[0][0].set_ylabel("mean joint speed (rad/s)")
        axes[0][0].legend(fontsize=8)
        return {"standing.png": figure}

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """The rows."""
        header = ("kind", "mode", "robots", "still", "falls", "drift_m", "joint_speed_rad_per_s")
        rows = [
            tuple(f"{run[n]:.3f}" if isinstance(run[n], float) else run[n] for n in header)
            for run in summary["runs"]
        ]
        return [(f"Commanded to stand (level {self.level})", header, rows)]


def stillness(poses: np.ndarray, settled: int) -> tuple[np.ndarray, np.ndarray]:
    """How far and how fast robots move.

    Args:
        poses: [T, N, 7 + joints] generalised positions at each control step.
        settled: the control step from which on they should stand.

    Returns:
        Horizontal distance from where each was at `settled`, [T - settled, N] m; mean speed of its
        joints, [T, N] rad/s.
    """
    place, joints = poses[..., :2], poses[..., 7:]
    drift = np.linalg.norm(place[settled:] - place[settled], axis=-1)
    speed = np.abs(np.diff(joints, axis=0, prepend=joints[:1])).mean(axis=-1) / CONTROL_DT
    return drift, speed
