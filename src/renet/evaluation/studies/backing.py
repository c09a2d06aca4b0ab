"""The backing study: robots with dead cameras walk backward from edges that they stand before.

A robot stands before a gap or before stairs, its camera dead from the start, and is told to walk
backward. It succeeds when it has gone 1 m without a fall.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, get_args

import numpy as np

from renet.errors import RenetError
from renet.evaluation import metrics
from renet.evaluation.rollout import robot_numbers
from renet.evaluation.settings import StudyMode, check_names
from renet.evaluation.studies.grounds import EDGES, one_tile_cfg, start_facing
from renet.evaluation.studies.memory import DEAD_CAMERA
from renet.evaluation.study import Part, Table, WalkingStudy
from renet.faults import Injection
from renet.interface import MAX_REVERSE
from renet.terrain.tiles import tiles

if TYPE_CHECKING:
    from renet.evaluation.evaluator import Evaluator

Edge = Literal["gap", "stairs_up", "stairs_down"]
"""Kinds of tile whose edges robots are to leave."""
EDGE_SIZES: Mapping[Edge, float] = {"gap": 0.57, "stairs_up": 0.23, "stairs_down": 0.23}
"""Width of the gap and risers of the stairs, m."""
_DISTANCE = 1.0
"""Distance to walk backward, m."""
_SPREAD = 0.02
"""Largest difference of a robot's start from its place, m."""


@dataclass(frozen=True)
class BackingStudy(WalkingStudy):
    """Command robots with dead cameras to walk backward, and count those that go 1 m."""

    out: Path = Path("results/backing")
    """Folder for summary.md, summary.json, summary.csv and parts/."""
    kinds: tuple[Edge, ...] = get_args(Edge)
    """Kinds of tile."""
    from_edge: float = 0.4
    """Distance of the middle of the base from the edge, m; a Go1's nose is 0.27 m ahead of it."""
    speed: float = 0.4
    """Commanded speed, m/s, backward; at most 0.6."""
    modes: tuple[StudyMode, ...] = ("memory",)

    name: ClassVar[str] = "backing"
    quick_robots: ClassVar[int] = 6

    def __post_init__(self) -> None:
        super().__post_init__()
        check_names("kinds", self.kinds, EDGE_SIZES)
        if self.speed > MAX_REVERSE:
            raise RenetError(f"speed must be at most {MAX_REVERSE:g} m/s backward")
        if not 0.0 < self.from_edge <= min(EDGES[kind] for kind in self.kinds):
            raise RenetError(f"from-edge {self.from_edge:g} m is not on the ground before the edge")

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """Return one batch for each kind of tile."""
        return {kind: partial(self._back_out, evaluator, kind) for kind in self.kinds}

    def _back_out(self, evaluator: Evaluator, kind: Edge) -> Part:
        """Walk all robots and modes backward from one kind of edge."""
        from renet.evaluation.motion import MotionSensor

        tile = replace(tiles()[kind], low=EDGE_SIZES[kind], high=EDGE_SIZES[kind])
        cfg = one_tile_cfg(evaluator, kind, tile)
        start_facing(cfg)
        place = EDGES[kind] - self.from_edge
        cfg.events["spawn"].params["pose_range"]["x"] = (place - _SPREAD, place + _SPREAD)
        dead = (Injection.of(*DEAD_CAMERA, 0, self.seconds),)
        trials = self.trials_on((kind,), dead)
        env = evaluator.make_env(cfg, robot_numbers(trials), self.speed, self.seed)
        env.follow(np.tile((-self.speed, 0.0, 0.0), (len(trials), 1)))
        sensor = MotionSensor(env)
        positions: list[np.ndarray] = []

        def watch(step: int) -> None:
            positions.append(sensor.read().position[:, 0])

        trace = self.walk(evaluator, env, trials, f"{kind}, backward", on_step=watch)
        backed, fell = outcomes(np.stack(positions), trace.ended)
        runs = []
        robots = np.arange(len(trials)).reshape(len(self.modes), -1)
        for mode, group in zip(self.modes, robots, strict=True):
            run = {
                "kind": kind,
                "size_m": EDGE_SIZES[kind],
                "mode": mode,
                "robots": len(group),
                "backed": int(backed[group].sum()),
                "falls": int(fell[group].sum()),
                **metrics.share_columns("success", backed[group]),
                "seed": self.seed,
            }
            runs.append(run)
        return {"runs": runs}

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Tabulate the rows."""
        header = ("edge", "size (cm)", "mode", "backed out", "fell before")
        rows = []
        for run in summary["runs"]:
            backed = f"{run['backed']} of {run['robots']}"
            size = f"{100 * run['size_m']:.0f}"
            rows.append((run["kind"], size, run["mode"], backed, run["falls"]))
        return [(f"Told to walk {_DISTANCE:g} m backward with a dead camera", header, rows)]


def outcomes(positions: np.ndarray, ended: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the outcome of each robot's first try.

    Args:
        positions: Places along the robots' headings after each control step, [T, N] m.
        ended: True where an episode ended in that step, [T, N] bool.

    Returns:
        Masks of the robots that went far enough before their episodes ended, and of those whose
        episodes ended first, [N] bool each.
    """
    over = np.logical_or.accumulate(ended, axis=0)
    backed = np.any((positions[0] - positions >= _DISTANCE) & ~over, axis=0)
    return backed, over[-1] & ~backed
