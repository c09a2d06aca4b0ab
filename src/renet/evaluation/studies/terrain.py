"""The terrain study: levels of the training curriculum that a policy crosses.

All levels of a kind of tile are walked at once, in every mode, and judged by true poses. The study
has two protocols:

- `terrain` is the paper's table. Robots walk in a random direction and start again in the middle
  after a fall. A robot passes a level when it leaves the tile within the time; its highest level is
  the number of levels passed in a row from the first, 0 to 10. As many robots walk on flat ground.
- `success` gives each robot one try, straight at the obstacle, with a camera that may fail. A robot
  succeeds when it leaves the tile within the time without a fall.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import product
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import mujoco
import numpy as np

from renet.errors import RenetError
from renet.evaluation import figures, metrics
from renet.evaluation.results import column, group_by
from renet.evaluation.rollout import Trial, robot_numbers
from renet.evaluation.settings import FLAT_GROUND, PARKOUR, StudyMode, check_names
from renet.evaluation.studies.grounds import onset_before_edge, start_facing
from renet.evaluation.study import Figures, MakeEnv, Part, Table, WalkingStudy
from renet.evaluation.trace import Trace
from renet.faults import FaultSchedule, parse_fault
from renet.interface import OWN_GROUND, Terrain
from renet.terrain.own_ground import GroundFile, OwnScene
from renet.terrain.tiles import LEVELS, Tile, tiles

if TYPE_CHECKING:
    from renet.evaluation.env import SimEnv
    from renet.evaluation.evaluator import Evaluator

TABLE = {"gap": ("gap",), "platform": ("platform",), "stairs": ("stairs_up", "stairs_down")}
"""Columns of the paper's table, and the tiles each is the mean of."""
SIZE_LABELS = {
    "gap": "gap width",
    "platform": "platform height",
    "stairs_up": "riser of stairs up",
    "stairs_down": "riser of stairs down",
    "obstacles": "height of blocks",
    "rough": "relief",
    OWN_GROUND: "relief of your own ground",
}
"""Name of the size that grows with the level, by kind of tile."""


@dataclass(frozen=True)
class TerrainStudy(WalkingStudy):
    """Measure the levels of the training curriculum that a policy passes: the paper's table.

    `--preset success` gives every robot one try at each obstacle instead, `--preset dawn` at those
    of DAWN's simulation. `--preset standing` commands robots to stop, `--preset stops` to walk at
    walls and over ledges, `--preset backing` to walk backward from an edge.
    """

    out: Path = Path("results/terrain")
    """Folder for summary.md, summary.json, summary.csv, terrain.png and parts/."""
    kinds: tuple[Terrain, ...] = ("gap", "platform", "stairs_up", "stairs_down")
    """Kinds of tile."""
    levels: tuple[int, ...] = tuple(range(1, LEVELS + 1))
    """Levels of the curriculum, 1 to 10."""
    modes: tuple[StudyMode, ...] = ("memory",)
    fault: str | None = None
    """A camera fault, NAME[:SEVERITY][@SECONDS[+DURATION]]; without a time it begins half a second
    before a robot is 1.2 m from its start, where gaps and stairs up begin."""
    seconds: float = 20.0
    """Time to leave a tile, s; by default the length of an episode in training."""
    scene: Path | None = None
    """Ground of your own in place of kinds of tile: a height map (.npy in m, .png), whose relief
    grows with the levels to its full height, or an MJCF scene (.xml), the same at every level."""
    scene_width: float = 8.0
    """Width of a height map, m; of a map wider than 8 m each level takes another piece."""
    scene_height: float = 0.3
    """Height of white above black in a .png, m."""

    name: ClassVar[str] = "terrain"
    selectable: ClassVar[tuple[str, ...]] = ("kinds",)
    one_try: ClassVar[bool] = False
    """True if each robot has one try, straight at the obstacle."""
    twins: ClassVar[bool] = False
    """True if the same robots walk on every level."""
    grounds: ClassVar[tuple[str, ...]] = tuple(tiles())
    """Kinds of ground that `kinds` may have."""
    sizes: ClassVar[Mapping[str, tuple[float, float]]] = {}
    """Sizes at levels 1 and 10, m, of the tiles that are not of the curriculum's sizes."""
    quick_levels: ClassVar[tuple[int, ...]] = tuple(range(1, LEVELS + 1))
    """Levels that are kept with `quick`, unless none of them is among `levels`."""
    quick_robots: ClassVar[int] = 4

    def __post_init__(self) -> None:
        check_names("kinds", self.kinds, self.grounds)
        if not self.levels or len({*self.levels} & {*range(1, LEVELS + 1)}) < len(self.levels):
            raise RenetError(f"levels {self.levels}: choose, once each, among 1 to {LEVELS}")
        super().__post_init__()
        # Raises for a fault that is unknown.
        _ = self.schedule
        # The dataclass is frozen, and a ground of one's own replaces the kinds of tile.
        if self.scene is not None:
            object.__setattr__(self, "kinds", (OWN_GROUND,))
            if isinstance(self.tiles[OWN_GROUND], OwnScene):
                object.__setattr__(self, "levels", (LEVELS,))

    @property
    def tiles(self) -> dict[str, Tile]:
        """Every kind of tile in the study's sizes, or the user's own ground alone."""
        if self.scene is not None:
            ground = GroundFile(file=self.scene, width=self.scene_width, height=self.scene_height)
            return {OWN_GROUND: ground.tile()}
        kinds = tiles()
        for kind, (low, high) in self.sizes.items():
            kinds[kind] = replace(kinds[kind], low=low, high=high)
        return kinds

    @property
    def schedule(self) -> FaultSchedule:
        """Fault of every camera."""
        if self.fault is None:
            return ()
        return (parse_fault(self.fault, onset_before_edge(self.speed)),)

    @property
    def settings(self) -> list[tuple[int, str]]:
        """Level and mode of every group of robots on one kind of tile."""
        return list(product(self.walked_levels, self.modes))

    @property
    def walked_levels(self) -> list[int]:
        """Levels to walk on, with `quick` taken into account."""
        levels = list(self.levels)
        if not self.quick:
            return levels
        # Levels that are asked for and all difficult are walked, with fewer robots.
        return [level for level in levels if level in self.quick_levels] or levels

    def file_digests(self) -> dict[str, str]:
        """Return the hashes of the files of motors and ground, for parts' keys."""
        digests = super().file_digests()
        if self.scene is not None:
            digests["scene"] = hashlib.sha256(self._scene_content(self.scene)).hexdigest()
        return digests

    def _scene_content(self, file: Path) -> bytes:
        """Read the user's own ground, also the files that an MJCF scene includes."""
        ground = self.tiles[OWN_GROUND]
        if not isinstance(ground, OwnScene):
            return file.read_bytes()
        content = np.zeros(mujoco.mj_sizeModel(ground.model), np.uint8)
        mujoco.mj_saveModel(ground.model, None, content)
        return content.tobytes()

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """Return one batch for each kind of tile, and for the paper's table one on flat ground."""
        # Batches of the same robots share an environment.
        make_env = cache(partial(self._make_env, evaluator))
        parts: dict[str, Callable[[], Part]] = {}
        if not self.one_try:
            parts["flat"] = partial(self._walk_flat, evaluator)
        for kind in self.kinds:
            parts[kind] = partial(self._walk_tiles, evaluator, make_env, kind)
        return parts

    def _walk_flat(self, evaluator: Evaluator) -> Part:
        """Walk with as many robots as in a setting on flat ground."""
        trials = self.trial_group(self.modes[0])
        env = evaluator.make_env(FLAT_GROUND, robot_numbers(trials), self.speed, self.seed)
        trace = self.walk(evaluator, env, trials, "flat")
        return {"falls": int(trace.fell.sum())}

    def _walk_tiles(self, evaluator: Evaluator, make_env: MakeEnv, kind: str) -> Part:
        """Walk all levels and modes of one kind of tile, side by side."""
        settings = self.settings
        env, trials = self.robots_on(make_env, [(kind, *setting) for setting in settings])
        least = 0 if self.one_try else None
        title = f"{self.kinds.index(kind) + 1}/{len(self.kinds)} {kind}"
        rollout = evaluator.rollout(env, trials, self.seed)
        trace = rollout.run(self.steps, title, until_ended=least, retire=self.one_try)
        groups = trace.groups(self.robots_each)
        runs = []
        levels_passed = []
        for (level, mode), group in zip(settings, groups, strict=True):
            runs.append(self._run(kind, level, mode, group))
            levels_passed.append(passed(group))
        # The paper's table holds the first mode alone.
        first = trace.robots(np.array([trial.mode == self.modes[0] for trial in trials]))
        walks = ~first.over
        along = np.minimum(first.forward_velocity, self.speed) / (self.speed + 1e-5)
        return {
            "runs": runs,
            "passed": levels_passed,
            # Sums over the steps of first tries: collisions, and the reward for speed.
            "steps": int(walks.sum()),
            "collisions": float(first.collisions[walks].sum()),
            "lin_vel_reward": float(along[walks].sum()),
        }

    def robots_on(
        self, make_env: MakeEnv, groups: Sequence[tuple[str, int, str]]
    ) -> tuple[SimEnv, list[Trial]]:
        """Put robots on their tiles.

        Args:
            make_env: Makes the environment of robots of these numbers.
            groups: Kind, level (1 for flat ground) and mode of each group of robots.

        Returns:
            The environment, and the robots' trials, group by group.
        """
        each = self.robots_each
        kinds = list(self.tiles)
        trials: list[Trial] = []
        levels = []
        columns = []
        for kind, level, mode in groups:
            # The first level of rough ground has no relief.
            place = kinds.index("rough" if kind == FLAT_GROUND else kind)
            for robot in range(each):
                # Twins are the same robots at every level.
                number = robot if self.twins else level * each + robot
                trials.append(Trial(mode, self.schedule, number))
                levels.append(level - 1)
                columns.append(place)
        env = make_env(tuple(robot_numbers(trials)))
        env.place(np.array(levels), np.array(columns))
        return env, trials

    def _make_env(self, evaluator: Evaluator, numbers: Sequence[int]) -> SimEnv:
        """Make the curriculum's field of tiles; robots with one try walk along +x."""
        cfg = evaluator.terrain_env_cfg(PARKOUR)
        cfg.scene.terrain.terrain_generator.sub_terrains = self.tiles
        if self.one_try:
            start_facing(cfg)
        return evaluator.make_env(cfg, numbers, self.speed, self.seed)

    def _run(self, kind: str, level: int, mode: str, trace: Trace) -> dict[str, Any]:
        """Make the summary's row of one group of robots."""
        crossed, fell, seconds = trace.first_try()
        success = crossed if self.one_try else passed(trace)
        return {
            "kind": kind,
            "level": level,
            "size_m": self.tiles[kind].measure_at(level),
            "mode": mode,
            "fault": self.fault,
            "robots": len(success),
            "passed": int(success.sum()),
            "falls": int((fell if self.one_try else trace.fell).sum()),
            "stuck": int((~crossed & ~fell).sum()),
            **metrics.share_columns("success", success),
            "median_seconds": float(np.median(seconds[crossed])) if crossed.any() else None,
            "seed": self.seed,
        }

    def summarise(self, parts: Mapping[str, Part], evaluator: Evaluator) -> dict[str, Any]:
        """Return rows, sizes that memory crosses less often than blind, and the paper's table."""
        runs = []
        for kind in self.kinds:
            runs += parts[kind]["runs"]
        summary = {"runs": runs, "worse": worse_than_blind(runs), "robots": self.robots_each}
        if self.one_try:
            return summary
        return summary | self._paper_table(parts)

    def _paper_table(self, parts: Mapping[str, Part]) -> dict[str, Any]:
        """Compute highest levels, collisions and the reward for speed of the first mode."""
        highest = self._highest_levels(parts)
        levels = {}
        intervals = {}
        for heading, kinds in TABLE.items():
            if all(kind in highest for kind in kinds):
                # A robot is the same one on all kinds of a column.
                values = np.mean([highest[kind] for kind in kinds], axis=0)
                levels[heading] = float(values.mean())
                intervals[heading] = metrics.bootstrap_interval(values)
        # Means over the steps of all first tries.
        batches = [parts[kind] for kind in self.kinds]
        steps = max(sum(column(batches, "steps")), 1)
        return {
            "levels": levels,
            "levels_ci95": intervals,
            "levels_by_kind": {kind: float(values.mean()) for kind, values in highest.items()},
            "collisions": sum(column(batches, "collisions")) / steps,
            "lin_vel_reward": sum(column(batches, "lin_vel_reward")) / steps,
            "falls_on_flat": parts["flat"]["falls"],
        }

    def _highest_levels(self, parts: Mapping[str, Part]) -> dict[str, np.ndarray]:
        """Return the highest level of each robot in the first mode, [R], by kind.

        It is empty unless all levels from the first on are walked.
        """
        levels = sorted({level for level, _ in self.settings})
        if levels != list(range(1, len(levels) + 1)):
            return {}
        places = [self.settings.index((level, self.modes[0])) for level in levels]
        highest = {}
        for kind in self.kinds:
            highest[kind] = highest_level(np.array(parts[kind]["passed"], bool)[places])
        return highest

    def draw(self, summary: dict[str, Any], parts: Mapping[str, Part]) -> Figures:
        """Draw the share of robots that cross, against the obstacle's size."""
        panels = {}
        for (kind,), rows in group_by(summary["runs"], "kind").items():
            panels[f"{SIZE_LABELS[kind]} (cm)"] = sorted(rows, key=itemgetter("size_m"))
        figure = figures.share_panels(panels, "success", lambda run: f"{100 * run['size_m']:.0f}")
        return {f"{self.name}.png": figure}

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Tabulate shares that cross, and the paper's table."""
        rows = []
        for (kind, size), runs in group_by(summary["runs"], "kind", "size_m").items():
            shares = [f"{100 * run['success_rate']:.0f}" for run in runs]
            rows.append((kind, f"{100 * size:.0f}", *shares))
        header = ("obstacle", "size (cm)", *self.modes)
        tables: list[Table] = [(f"Robots that cross, % of {summary['robots']}", header, rows)]
        if not self.one_try and len(self.settings) > len(self.modes):
            levels = [(kind, f"{n:.2f}") for kind, n in summary["levels_by_kind"].items()]
            mode = self.modes[0]
            if levels:
                count = len(self.settings) // len(self.modes)
                title = f"Mean highest level of {count} in mode {mode}"
                tables.append((title, ("tile", "level"), levels))
            flat = [(summary["robots"], summary["falls_on_flat"])]
            tables.append((f"On flat ground in mode {mode}", ("robots", "falls"), flat))
        if summary["worse"]:
            worse = []
            for row in summary["worse"]:
                shares = (f"{100 * row['memory']:.0f}", f"{100 * row['blind']:.0f}")
                worse.append((row["kind"], f"{100 * row['size_m']:.0f}", *shares))
            title = "Sizes that fewer robots cross in mode memory than in mode blind, %"
            tables.append((title, ("obstacle", "size (cm)", "memory", "blind"), worse))
        return tables


@dataclass(frozen=True)
class SuccessStudy(TerrainStudy):
    """Give robots one try at each obstacle, kind by kind and size by size, in several modes."""

    out: Path = Path("results/success")
    """Folder for summary.md, summary.json, summary.csv, success.png and parts/."""
    levels: tuple[int, ...] = (1, 2, 3, 4, 6, 8, 10)
    """Sizes, as levels of the curriculum, 1 to 10."""
    modes: tuple[StudyMode, ...] = ("camera", "memory", "blind")
    seconds: float = 16.0
    """Time to cross, s: the 4 m to the tile's edge take 6.7 s at the commanded speed."""

    name: ClassVar[str] = "success"
    one_try: ClassVar[bool] = True
    twins: ClassVar[bool] = True
    quick_levels: ClassVar[tuple[int, ...]] = (1, 2, 4)
    quick_robots: ClassVar[int] = 10


@dataclass(frozen=True)
class DawnStudy(SuccessStudy):
    """Give robots one try at DAWN's obstacles in simulation (arXiv 2609.29092).

    100 robots walk at ten sizes of each kind; `--seed` 1, 2 and 3 stand for its three trainings.
    Its speed, treads, run-up and time are not published: these are the success study's.
    """

    out: Path = Path("results/dawn")
    """Folder for summary.md, summary.json, summary.csv, dawn.png and parts/."""
    levels: tuple[int, ...] = tuple(range(1, LEVELS + 1))
    """Sizes, as tenths of their range, 1 to 10."""
    modes: tuple[StudyMode, ...] = ("camera", "blind")
    robots: int = 10
    """Number of robots for each size and mode; with `quick` a few at most."""

    name: ClassVar[str] = "dawn"
    twins: ClassVar[bool] = False
    quick_robots: ClassVar[int] = 4
    sizes: ClassVar[Mapping[str, tuple[float, float]]] = {
        "stairs_up": (0.06, 0.18),
        "stairs_down": (0.06, 0.18),
        "gap": (0.10, 0.90),
        "platform": (0.10, 0.54),
    }


def passed(trace: Trace) -> np.ndarray:
    """Return a mask of the robots that left their tile at least once, [N] bool."""
    return np.any(trace.ended & ~trace.fell, axis=0)


def highest_level(levels_passed: np.ndarray) -> np.ndarray:
    """Count the levels passed in a row from the first, [..., R].

    Args:
        levels_passed: True where a robot passed a level, [..., L, R] bool.
    """
    return np.sum(np.logical_and.accumulate(levels_passed, axis=-2), axis=-2)


def worse_than_blind(runs: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """List sizes crossed less often in mode memory than in mode blind, by more than two points."""
    blind_rates = {}
    for run in runs:
        if run["mode"] == "blind":
            blind_rates[run["kind"], run["level"]] = run["success_rate"]
    worse = []
    for run in runs:
        blind = blind_rates.get((run["kind"], run["level"]))
        if run["mode"] != "memory" or blind is None or run["success_rate"] >= blind - 0.02:
            continue
        row = {"kind": run["kind"], "size_m": run["size_m"]}
        worse.append(row | {"memory": run["success_rate"], "blind": blind})
    return worse
