"""The terrain study: which tiles a policy crosses, level by level.

Every level of a kind of tile is walked at once, in every mode, and judged by true poses. The study
has two protocols:

- `terrain` is the paper's table. Robots walk in a random direction and start again in the middle
  after a fall. One passes a level when it leaves the tile within the time; its highest level is the
  number of levels passed in a row from the first, 0 to 10. As many robots walk on flat ground.
- `success` gives each robot one try, straight at the obstacle, with a camera that may fail. It
  succeeds when it leaves the tile within the time without a fall.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from renet.errors import RenetError
from renet.evaluation import figures, metrics
from renet.evaluation.results import grouped
from renet.evaluation.rollout import FLAT, PARKOUR, Mode, Trial
from renet.evaluation.studies.one_try import AIM, NEAREST
from renet.evaluation.study import Figures, Part, Table, WalkingStudy
from renet.evaluation.trace import Trace
from renet.faults import FaultSchedule, parse_fault
from renet.interface import CONTROL_DT, Terrain
from renet.terrain.own_ground import KIND, GroundFile, OwnScene
from renet.terrain.tiles import LEVELS, Tile, tiles

if TYPE_CHECKING:
    from renet.evaluation.env import SimEnv
    from renet.evaluation.evaluator import Evaluator

TABLE = {"gap": ("gap",), "platform": ("platform",), "stairs": ("stairs_up", "stairs_down")}
"""The paper's columns, and the tiles each is the mean of."""
SIZES = {
    "gap": "gap width",
    "platform": "platform height",
    "stairs_up": "riser of stairs up",
    "stairs_down": "riser of stairs down",
    "obstacles": "height of blocks",
    "rough": "relief",
    KIND: "relief of your own ground",
}
"""What grows with the level of each kind of tile."""


@dataclass(frozen=True)
class TerrainStudy(WalkingStudy):
    """The paper's table: how far up the training curriculum a policy gets.

    `--preset success` gives every robot one try at each obstacle instead, `--preset dawn` at those
    of DAWN's simulation; `--preset standing` commands robots to stop.
    """

    out: Path = Path("results/terrain")
    """Folder for summary.md, summary.json, summary.csv, terrain.png and parts/."""
    kinds: tuple[Terrain, ...] = ("gap", "platform", "stairs_up", "stairs_down")
    """Kinds of tile."""
    levels: tuple[int, ...] = tuple(range(1, LEVELS + 1))
    """Levels of the curriculum, 1 to 10."""
    modes: tuple[Mode, ...] = ("memory",)
    fault: str | None = None
    """A camera fault, NAME[:SEVERITY][@SECONDS[+DURATION]]; without a time it begins half a second
    before a robot is 1.2 m from its start, where gaps and stairs up begin."""
    seconds: float = 20.0
    """Time to leave a tile (an episode's length in training)."""
    scene: Path | None = None
    """Ground of your own in place of kinds of tile: a height map (.npy in m, .png), whose relief
    grows to all of it with the levels, or an MJCF scene (.xml), the same at every level."""
    scene_width: float = 8.0
    """Metres that a height map is wide; of more than 8 each level takes another piece."""
    scene_height: float = 0.3
    """Metres of white above black in a .png."""

    name: ClassVar[str] = "terrain"
    selectable: ClassVar[tuple[str, ...]] = ("kinds",)
    one_try: ClassVar[bool] = False
    twins: ClassVar[bool] = False
    """Whether the same robots meet every level."""
    grounds: ClassVar[tuple[str, ...]] = tuple(tiles())
    sizes: ClassVar[Mapping[str, tuple[float, float]]] = {}
    """Sizes at levels 1 and 10, m, of tiles whose sizes are not the curriculum's."""
    quick_levels: ClassVar[tuple[int, ...]] = tuple(range(1, LEVELS + 1))
    quick_robots: ClassVar[int] = 4

    def __post_init__(self) -> None:
        if not self.kinds or not {*self.kinds} <= {*self.grounds}:
            raise RenetError(f"kinds {self.kinds}: choose among {', '.join(self.grounds)}")
        if not self.levels or len({*self.levels} & {*range(1, LEVELS + 1)}) < len(self.levels):
            raise RenetError(f"levels {self.levels}: choose, once each, among 1 to {LEVELS}")
        super().__post_init__()
        if self.seconds < 1:
            raise RenetError(f"seconds must be at least 1, got {self.seconds}")
        _ = self.schedule
        if self.scene is not None:
            object.__setattr__(self, "kinds", (KIND,))
            if isinstance(self.tiles[KIND], OwnScene):
                object.__setattr__(self, "levels", (LEVELS,))

    @property
    def tiles(self) -> dict[str, Tile]:
        """Every kind of tile in the study's sizes, or somebody's own ground alone."""
        if self.scene is not None:
            ground = GroundFile(file=self.scene, width=self.scene_width, height=self.scene_height)
            return {KIND: ground.tile()}
        changed = tiles()
        for kind, (low, high) in self.sizes.items():
            changed[kind] = replace(changed[kind], low=low, high=high)
        return changed

    @property
    def schedule(self) -> FaultSchedule:
        """What happens to every camera; the nearest obstacle begins 1.2 m from the start."""
        if self.fault is None:
            return ()
        return (parse_fault(self.fault, max(NEAREST / self.speed - 0.5, 0.0)),)

    @property
    def settings(self) -> list[tuple[int, str]]:
        """Level and mode of every group of robots on one kind of tile."""
        alike = self.scene is not None and len(self.levels) == 1
        levels = self.quick_levels if self.quick and not alike else self.levels
        return [(level, mode) for level in levels for mode in self.modes]

    def file_digests(self) -> dict[str, str]:
        """Of the motors, and of the ground."""
        digests = super().file_digests()
        if self.scene is not None:
            digests["scene"] = hashlib.sha256(self.scene.read_bytes()).hexdigest()
        return digests

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """One batch for each kind of tile, and one on flat ground where that is reported."""
        make = cache(partial(self._make_env, evaluator))
        flat = {} if self.one_try else {"flat": partial(self._walk_flat, evaluator)}
        return flat | {
            kind: partial(self._walk_tiles, evaluator, make, kind) for kind in self.kinds
        }

    def _walk_flat(self, evaluator: Evaluator) -> Part:
        """As many robots as in a setting, on flat ground."""
        robots = range(self.robots_each)
        env = evaluator.make_env(FLAT, robots, self.speed, self.seed)
        trials = [Trial(self.modes[0], robot=robot) for robot in robots]
        steps = round(self.seconds / CONTROL_DT)
        trace = evaluator.rollout(env, trials, self.seed).run(steps, "flat")
        return {"falls": int(trace.fell.sum())}

    def _walk_tiles(self, evaluator: Evaluator, make: Any, kind: str) -> Part:
        """All levels and modes of one kind of tile, side by side."""
        settings, each = self.settings, self.robots_each
        env, trials = self.robots_on(make, [(kind, *setting) for setting in settings])
        steps = round(self.seconds / CONTROL_DT)
        least = 0 if self.one_try else None
        title = f"{self.kinds.index(kind) + 1}/{len(self.kinds)} {kind}"
        rollout = evaluator.rollout(env, trials, self.seed)
        trace = rollout.run(steps, title, until_ended=least, retire=self.one_try)
        groups = trace.groups(each)
        first = trace.robots(np.array([trial.mode == self.modes[0] for trial in trials]))
        walks = ~first.over
        along = np.minimum(first.forward_velocity, self.speed) / (self.speed + 1e-5)
        return {
            "runs": [self._run(kind, *s, group) for s, group in zip(settings, groups, strict=True)],
            "passed": [passed(group) for group in groups],
            # Sums over the steps of first tries: collisions, and the reward for speed.
            "steps": int(walks.sum()),
            "collisions": float(first.collisions[walks].sum()),
            "lin_vel_reward": float(along[walks].sum()),
        }

    def robots_on(
        self, make: Callable[[tuple[int, ...]], SimEnv], groups: Sequence[tuple[str, int, str]]
    ) -> tuple[SimEnv, list[Trial]]:
        """Robots on their tiles, and their trials; groups are kind, level (1 on flat) and mode."""
        each = self.robots_each
        rows = [(*group, robot) for group in groups for robot in range(each)]
        trials = [
            Trial(mode, self.schedule, robot if self.twins else level * each + robot)
            for _, level, mode, robot in rows
        ]
        env = make(tuple(trial.robot for trial in trials))
        # The first level of rough ground has no relief.
        known = list(self.tiles)
        columns = [known.index("rough" if kind == FLAT else kind) for kind, *_ in rows]
        env.place(np.array([level - 1 for _, level, *_ in rows]), np.array(columns))
        return env, trials

    def _make_env(self, evaluator: Evaluator, numbers: Sequence[int]) -> SimEnv:
        """The curriculum's field of tiles, walked along +x where there is one try."""
        cfg = evaluator.terrain_env_cfg(PARKOUR)
        cfg.scene.terrain.terrain_generator.sub_terrains = self.tiles
        if self.one_try:
            cfg.events["spawn"].params["pose_range"]["yaw"] = (-AIM, AIM)
        return evaluator.make_env(cfg, numbers, self.speed, self.seed)

    def _run(self, kind: str, level: int, mode: str, trace: Trace) -> dict[str, Any]:
        """One row of the summary."""
        crossed, fell, seconds = trace.first_try()
        success = crossed if self.one_try else passed(trace)
        return {
            "kind": kind,
            "level": level,
            "size_m": self.tiles[kind].measure((level - 1) / (LEVELS - 1)),
            "mode": mode,
            "fault": self.fault,
            "robots": len(success),
            "passed": int(success.sum()),
            "falls": int((fell if self.one_try else trace.fell).sum()),
            "stuck": int((~crossed & ~fell).sum()),
            "success_rate": float(success.mean()),
            **metrics.with_share_interval("success", success),
            "median_seconds": float(np.median(seconds[crossed])) if crossed.any() else None,
            "seed": self.seed,
        }

    def summarise(self, parts: Mapping[str, Part], evaluator: Evaluator) -> dict[str, Any]:
        """Rows, the paper's table, and sizes crossed less often in mode memory than blind."""
        runs = [run for kind in self.kinds for run in parts[kind]["runs"]]
        summary = {"runs": runs, "worse": worse_than_blind(runs), "robots": self.robots_each}
        if self.one_try:
            return summary
        first = [n for n, (_, mode) in enumerate(self.settings) if mode == self.modes[0]]
        highest = {
            kind: highest_level(np.array(parts[kind]["passed"], bool)[first]) for kind in self.kinds
        }
        table = {
            column: np.concatenate([highest[kind] for kind in kinds])
            for column, kinds in TABLE.items()
            if all(kind in highest for kind in kinds)
        }
        steps = max(sum(parts[kind]["steps"] for kind in self.kinds), 1)
        return summary | {
            "levels": {name: float(value.mean()) for name, value in table.items()},
            "levels_ci95": {name: metrics.bootstrap_interval(v) for name, v in table.items()},
            "levels_by_kind": {kind: float(value.mean()) for kind, value in highest.items()},
            **{
                name: sum(parts[kind][name] for kind in self.kinds) / steps
                for name in ("collisions", "lin_vel_reward")
            },
            "falls_on_flat": parts["flat"]["falls"],
        }

    def draw(self, summary: dict[str, Any], parts: Mapping[str, Part]) -> Figures:
        """The share of robots that get across, against the obstacle's size."""
        panels = {
            f"{SIZES[kind]} (cm)": sorted(rows, key=itemgetter("size_m"))
            for (kind,), rows in grouped(summary["runs"], "kind").items()
        }
        figure = figures.share_panels(panels, "success", lambda run: f"{100 * run['size_m']:.0f}")
        return {f"{self.name}.png": figure}

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Shares that get across, and the paper's table."""
        rows = [
            (kind, f"{100 * size:.0f}", *(f"{100 * run['success_rate']:.0f}" for run in runs))
            for (kind, size), runs in grouped(summary["runs"], "kind", "size_m").items()
        ]
        header = ("obstacle", "size (cm)", *self.modes)
        tables: list[Table] = [(f"Robots that cross, % of {summary['robots']}", header, rows)]
        if not self.one_try and len(self.settings) > len(self.modes):
            levels = [(kind, f"{n:.2f}") for kind, n in summary["levels_by_kind"].items()]
            levels += [("falls on flat ground", summary["falls_on_flat"])]
            tables.append((f"Mean highest level of {LEVELS}", ("tile", "level"), levels))
        if summary["worse"]:
            worse = [
                (w["kind"], f"{100 * w['size_m']:.0f}", *_percent(w, "memory", "blind"))
                for w in summary["worse"]
            ]
            title = "Sizes that fewer robots cross in mode memory than in mode blind, %"
            tables.append((title, ("obstacle", "size (cm)", "memory", "blind"), worse))
        return tables


@dataclass(frozen=True)
class SuccessStudy(TerrainStudy):
    """One try at each obstacle, kind by kind and size by size, in several modes."""

    out: Path = Path("results/success")
    """Folder for summary.md, summary.json, summary.csv, success.png and parts/."""
    levels: tuple[int, ...] = (1, 2, 3, 4, 6, 8, 10)
    """Sizes, as levels of the curriculum, 1 to 10."""
    modes: tuple[Mode, ...] = ("camera", "memory", "blind")
    seconds: float = 16.0
    """Time to cross: the 4 m to the tile's edge take 6.7 s at the commanded speed."""

    name: ClassVar[str] = "success"
    one_try: ClassVar[bool] = True
    twins: ClassVar[bool] = True
    quick_levels: ClassVar[tuple[int, ...]] = (1, 2, 4)
    quick_robots: ClassVar[int] = 10


@dataclass(frozen=True)
class DawnStudy(SuccessStudy):
    """DAWN's obstacles in simulation (arXiv 2609.29092), with one try each.

    100 robots meet ten sizes of each kind; `--seed` 1, 2 and 3 stand for its three trainings. Its
    speed, treads, run-up and time are not published: these are the success study's.
    """

    out: Path = Path("results/dawn")
    """Folder for summary.md, summary.json, summary.csv, dawn.png and parts/."""
    levels: tuple[int, ...] = tuple(range(1, LEVELS + 1))
    """Tenths of the range of sizes, 1 to 10."""
    modes: tuple[Mode, ...] = ("camera", "blind")
    robots: int = 10
    """Robots for each size and mode; with `quick` always fewer."""

    name: ClassVar[str] = "dawn"
    twins: ClassVar[bool] = False
    quick_robots: ClassVar[int] = 4
    sizes: ClassVar[Mapping[str, tuple[float, float]]] = {
        "stairs_up": (0.06, 0.18),
        "stairs_down": (0.06, 0.18),
        "gap": (0.10, 0.90),
        "platform": (0.10, 0.54),
    }


def _percent(row: Mapping[str, float], *names: str) -> list[str]:
    """Shares of a row in per cent, by their names."""
    return [f"{100 * row[name]:.0f}" for name in names]


def passed(trace: Trace) -> np.ndarray:
    """[N] bool: the robot left its tile at least once."""
    return np.any(trace.ended & ~trace.fell, axis=0)


def highest_level(levels_passed: np.ndarray) -> np.ndarray:
    """[..., R] levels passed in a row from the first; `levels_passed` is [..., L, R] bool."""
    return np.sum(np.logical_and.accumulate(levels_passed, axis=-2), axis=-2)


def worse_than_blind(runs: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Sizes that robots cross less often in mode memory than blind, by more than two points."""
    op = {(r["kind"], r["level"]): r["success_rate"] for r in runs if r["mode"] == "blind"}
    return [
        {"kind": r["kind"], "size_m": r["size_m"], "memory": r["success_rate"], "blind": blind}
        for r in runs
        if r["mode"] == "memory"
        and (blind := op.get((r["kind"], r["level"]))) is not None
        and r["success_rate"] < blind - 0.02
    ]
