"""The paper's terrain study: how far up the curriculum a policy gets.

Every level of every kind of tile is walked at once, each by its own robots. A robot passes a level
when it leaves the tile within the time, starting again in the middle after a fall; its highest
level is the number of levels passed in a row from the first, 0 to 10. The paper climbs the same
ladder with its training curriculum. As many robots walk on flat ground, where nobody should fall.
Each kind is one batch, kept in `parts/`: an interrupted study goes on where it stopped.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from renet.errors import RenetError
from renet.evaluation import figures, metrics
from renet.evaluation.lab import Lab
from renet.evaluation.results import (
    Parts,
    Provenance,
    output_folder,
    write_csv,
    write_json,
)
from renet.evaluation.rollout import Row, Trace, World, check_modes, check_speed
from renet.evaluation.terminal import show
from renet.interface import CONTROL_DT
from renet.tiles import LEVELS, tiles

TABLE = {"gap": ("gap",), "platform": ("platform",), "stairs": ("stairs_up", "stairs_down")}
"""The paper's columns, and the tiles each is the mean of."""


@dataclass(frozen=True)
class TerrainCfg:
    """Settings of the terrain study."""

    out: Path = Path("results/terrain")
    """Folder for summary.json, summary.csv, terrain.png and parts/."""
    bundle: Path | None = None
    """Bundle folder; the one that ships with renet by default."""
    robots: int = 20
    """Robots on each level of each kind of tile."""
    quick: bool = False
    """4 robots on each instead of `robots`: two minutes."""
    seconds: float = 20.0
    """Time to leave a tile (an episode's length in training)."""
    speed: float = 0.6
    """Commanded forward speed, m/s; the direction is random."""
    mode: str = "renet"
    """Policy mode: renet, vp, op or oracle-switch."""
    kinds: tuple[str, ...] = ("gap", "platform", "stairs_up", "stairs_down")
    """Kinds of tile to walk; those of the paper's table by default."""
    selector: str = "monitors"
    """Selector: monitors (all of them) or paper."""
    seed: int = 1
    """Of the robots' starts and directions."""
    engine: str = "auto"
    """Physics engine: auto, native or warp."""

    def __post_init__(self) -> None:
        unknown = [kind for kind in self.kinds if kind not in tiles()]
        if unknown or not self.kinds:
            raise RenetError(f"kinds {self.kinds}: choose among {', '.join(tiles())}")
        if self.robots < 1 or self.seconds < 1:
            raise RenetError(f"robots {self.robots} and seconds {self.seconds} must be at least 1")
        check_modes((self.mode,))
        check_speed(self.speed)


def run_terrain(cfg: TerrainCfg, lab: Lab | None = None) -> dict[str, Any]:
    """Run what has not been run yet, write the results to `cfg.out` and return the summary.

    Raises:
        RenetError: a bundle that cannot be used, or a folder that cannot be written to.
    """
    lab = lab or Lab(cfg.bundle, cfg.engine, cfg.selector)
    out = output_folder(cfg.out)
    provenance = lab.provenance(cfg.seed)
    parts = Parts(out, cfg, provenance, free=("kinds",))
    flat = parts.get("flat", partial(_walk_flat, cfg, lab))
    climbs = {kind: parts.get(kind, partial(_climb, cfg, lab, kind)) for kind in cfg.kinds}
    summary = summarise(cfg, climbs, flat, provenance)
    write_json(out / "summary.json", summary)
    write_csv(out / "summary.csv", summary["runs"])
    draw(summary, out / "terrain.png", provenance)
    return summary


def _robots(cfg: TerrainCfg) -> int:
    """Robots on each level, after `quick`."""
    return 4 if cfg.quick else cfg.robots


def _walk_flat(cfg: TerrainCfg, lab: Lab) -> dict[str, Any]:
    """As many robots as on a level, on flat ground."""
    count = _robots(cfg)
    trace = _walk(cfg, lab, lab.world("Renet-Go1-Flat", range(count), cfg.speed, cfg.seed), "flat")
    return {"robots": count, "falls": int(trace.fell.sum())}


def _climb(cfg: TerrainCfg, lab: Lab, kind: str) -> dict[str, Any]:
    """All levels of one kind of tile."""
    level, _ = np.indices((LEVELS, _robots(cfg))).reshape(2, -1)
    world = lab.world("Renet-Go1-Parkour", range(len(level)), cfg.speed, cfg.seed)
    world.place(level, np.full(len(level), list(tiles()).index(kind)))
    trace = _walk(cfg, lab, world, kind)
    walking = np.logical_or.accumulate(trace.ended, axis=0)
    walking = ~np.vstack([walking[:1] * False, walking[:-1]]) & ~trace.ended
    along = np.minimum(trace.forward_velocity, cfg.speed) / (cfg.speed + 1e-5)
    return {
        "passed": passed(trace).reshape(LEVELS, -1),
        "falls": trace.fell.sum(axis=0).reshape(LEVELS, -1).sum(axis=1),
        "steps": int(walking.sum()),
        "collisions": float(trace.collisions[walking].sum()),
        "lin_vel_reward": float(along[walking].sum()),
    }


def _walk(cfg: TerrainCfg, lab: Lab, world: World, name: str) -> Trace:
    """Everybody walks for `cfg.seconds`."""
    count, steps = world.num_robots, round(cfg.seconds / CONTROL_DT)
    rows = [Row(cfg.mode, robot=i) for i in range(count)]
    return lab.walk(f"{name}, {count} robots", world, rows, steps, cfg.seed)


def passed(trace: Trace) -> np.ndarray:
    """[N] bool: the robot left its tile at least once."""
    return np.any(trace.ended & ~trace.fell, axis=0)


def highest_level(levels_passed: np.ndarray) -> np.ndarray:
    """[..., R] levels passed in a row from the first; `levels_passed` is [..., L, R] bool."""
    return np.sum(np.logical_and.accumulate(levels_passed, axis=-2), axis=-2)


def summarise(
    cfg: TerrainCfg,
    climbs: dict[str, dict[str, Any]],
    flat: dict[str, Any],
    provenance: Provenance,
) -> dict[str, Any]:
    """The content of summary.json."""
    success = {kind: np.array(part["passed"], bool) for kind, part in climbs.items()}
    highest = {kind: highest_level(levels) for kind, levels in success.items()}
    table = {
        column: np.concatenate([highest[kind] for kind in kinds])
        for column, kinds in TABLE.items()
        if all(kind in highest for kind in kinds)
    }
    steps = max(sum(part["steps"] for part in climbs.values()), 1)
    runs = [
        {
            "mode": cfg.mode,
            "kind": kind,
            "level": level + 1,
            "measure_m": tiles()[kind].measure(level / (LEVELS - 1)),
            "robots": _robots(cfg),
            "passed": int(success[kind][level].sum()),
            "falls": part["falls"][level],
            "seed": cfg.seed,
        }
        for kind, part in climbs.items()
        for level in range(LEVELS)
    ]
    return {
        "study": "terrain",
        "levels": {name: float(value.mean()) for name, value in table.items()},
        "levels_ci95": {name: metrics.bootstrap_interval(value) for name, value in table.items()},
        "levels_by_kind": {kind: float(value.mean()) for kind, value in highest.items()},
        "collisions": sum(part["collisions"] for part in climbs.values()) / steps,
        "lin_vel_reward": sum(part["lin_vel_reward"] for part in climbs.values()) / steps,
        "falls_on_flat": flat["falls"],
        "robots": _robots(cfg),
        "runs": runs,
        "settings": asdict(cfg),
        "provenance": vars(provenance),
    }


def draw(summary: dict[str, Any], path: Path, provenance: Provenance) -> None:
    """Write terrain.png: the share of robots that pass each level of each kind."""
    with plt.rc_context(figures.STYLE):
        figure, axis = plt.subplots(figsize=(8, 3.8))
        palette = ("#3c3ca0", "#d9602b", "#3f8f63", "#8fbf9f", "#8a6bbd", "#7d8590")
        for place, (kind, mean) in enumerate(summary["levels_by_kind"].items()):
            runs = [run for run in summary["runs"] if run["kind"] == kind]
            share = [100 * run["passed"] / run["robots"] for run in runs]
            label = f"{kind.replace('_', ' ')}: mean level {mean:.1f}"
            # Side by side, or equal shares would hide each other.
            levels = np.arange(1, LEVELS + 1) + 0.07 * (place - 1.5)
            axis.plot(levels, share, "o-", color=palette[place], label=label, markersize=4)
        axis.set(
            title=f"Who leaves the tile (mode {summary['settings']['mode']})",
            xlabel="terrain level",
            ylabel="robots that pass (%)",
            xticks=range(1, LEVELS + 1),
            ylim=(-3, 103),
        )
        axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
        figures.save(figure, path, provenance)


def main(cfg: TerrainCfg) -> None:
    """`renet evaluate terrain`."""
    summary = run_terrain(cfg)
    rows = [(kind, f"{level:.2f}") for kind, level in summary["levels_by_kind"].items()]
    show(f"Highest level of {LEVELS}, mean of {summary['robots']} robots", ("tile", "level"), rows)
    print(
        f"collisions {summary['collisions']:.3f}, linear velocity reward"
        f" {summary['lin_vel_reward']:.3f}, falls on flat ground {summary['falls_on_flat']}"
    )
