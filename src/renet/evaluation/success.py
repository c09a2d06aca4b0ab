"""Success rates: how large an obstacle a policy crosses, kind by kind, size by size.

Robots walk straight at the obstacle from the middle of a tile. A trial succeeds when the robot
leaves the tile within the time and has not fallen, by its true pose; there is no second try.
"""

from __future__ import annotations

from collections.abc import Sequence
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
from renet.evaluation.rollout import (
    Disturbed,
    Readings,
    Row,
    Trace,
    World,
    check_modes,
    check_speed,
)
from renet.evaluation.terminal import show
from renet.faults import Injection, Schedule
from renet.interface import CONTROL_DT
from renet.tasks import RenetEnvCfg, env_cfg
from renet.tiles import LEVELS, tiles

SIZES = {
    "gap": "gap width",
    "platform": "platform height",
    "stairs_up": "riser of stairs up",
    "stairs_down": "riser of stairs down",
    "obstacles": "height of blocks",
    "rough": "relief",
}
"""What is varied of each kind of tile."""
AIM = 0.1
"""Robots start within this angle of straight at the obstacle, rad."""


@dataclass(frozen=True)
class SuccessCfg:
    """Settings of the success study."""

    out: Path = Path("results/success")
    """Folder for summary.json, summary.csv, success.png and parts/."""
    bundle: Path | None = None
    """Bundle folder; the one that ships with renet by default."""
    kinds: tuple[str, ...] = ("gap", "platform", "stairs_up", "stairs_down")
    """Kinds of tile: gap, platform, stairs_up, stairs_down, obstacles, rough."""
    levels: tuple[int, ...] = (1, 2, 3, 4, 6, 8, 10)
    """Sizes, as levels of the curriculum, 1 to 10."""
    modes: tuple[str, ...] = ("vp", "renet", "op")
    """Policy modes to compare: vp, renet, op, oracle-switch."""
    trials: int = 20
    """Robots for each size and mode."""
    quick: bool = False
    """Levels 1, 2 and 4 and 10 trials instead."""
    fault: str | None = None
    """A camera fault of the benchmark, from half a second before the obstacle on."""
    severity: int = 3
    """Its severity, 1 to 5."""
    seconds: float = 16.0
    """Time to cross: the 4 m to the tile's edge take 6.7 s at the commanded speed."""
    speed: float = 0.6
    """Commanded forward speed, m/s."""
    selector: str = "monitors"
    """Selector: monitors (all of them) or paper."""
    seed: int = 1
    """Of the robots' bodies, starts and directions."""
    engine: str = "auto"
    """Physics engine: auto, native or warp."""

    def __post_init__(self) -> None:
        unknown = [kind for kind in self.kinds if kind not in tiles()]
        if unknown or not self.kinds:
            raise RenetError(f"kinds {self.kinds}: choose among {', '.join(tiles())}")
        if not self.levels or not all(1 <= level <= LEVELS for level in self.levels):
            raise RenetError(f"levels {self.levels}: choose among 1 to {LEVELS}")
        check_modes(self.modes)
        check_speed(self.speed)
        if self.trials < 1 or self.seconds < 1:
            raise RenetError(f"trials {self.trials} and seconds {self.seconds} must be at least 1")
        _ = self.schedule

    @property
    def schedule(self) -> Schedule:
        """What happens to every camera; the nearest obstacle begins 1.2 m from the start."""
        if self.fault is None:
            return ()
        onset = max(1.2 / self.speed - 0.5, 0.0) / CONTROL_DT
        return (Injection.of(self.fault, self.severity, round(onset)),)

    def effective(self) -> tuple[tuple[int, ...], int]:
        """Levels and trials after `quick`."""
        return ((1, 2, 4), 10) if self.quick else (self.levels, self.trials)

    def task(self) -> RenetEnvCfg:
        """Parkour tiles, walked along +x."""
        cfg = env_cfg("Renet-Go1-Parkour", play=True)
        cfg.events["spawn"].params["pose_range"]["yaw"] = (-AIM, AIM)
        return cfg


class FirstTry:
    """A world that knows which robots have ended their first try; see `rollout.World`."""

    def __init__(self, world: World) -> None:
        """Watch `world`."""
        self._world = world
        self.num_robots = world.num_robots
        self.poses = world.poses
        if isinstance(world, Disturbed):
            self.disturb = world.disturb
        self._over = np.zeros(self.num_robots, bool)

    def reset(self) -> Readings:
        """See `World.reset`."""
        self._over[:] = False
        return self._world.reset()

    def step(self, action: np.ndarray) -> Readings:
        """See `World.step`."""
        readings = self._world.step(action)
        self._over |= readings.ended
        return readings

    def over(self) -> bool:
        """Whether every robot has ended its first try."""
        return bool(self._over.all())


def run_success(cfg: SuccessCfg, lab: Lab | None = None) -> dict[str, Any]:
    """Run what has not been run yet, write the results to `cfg.out` and return the summary.

    Raises:
        RenetError: a bundle that cannot be used, or a folder that cannot be written to.
    """
    lab = lab or Lab(cfg.bundle, cfg.engine, cfg.selector)
    out = output_folder(cfg.out)
    provenance = lab.provenance(cfg.seed)
    parts = Parts(out, cfg, provenance, free=("kinds",))
    runs: list[dict[str, Any]] = []
    for number, kind in enumerate(cfg.kinds, start=1):
        name = f"{number}/{len(cfg.kinds)} {kind}"
        runs += parts.get(kind, partial(_run_kind, cfg, lab, kind, name))["runs"]
    summary = {
        "study": "success",
        "runs": runs,
        "worse": worse_than_blind(runs),
        "settings": asdict(cfg),
        "provenance": vars(provenance),
    }
    write_json(out / "summary.json", summary)
    write_csv(out / "summary.csv", runs)
    draw(summary, out / "success.png", provenance)
    return summary


def _run_kind(cfg: SuccessCfg, lab: Lab, kind: str, name: str) -> dict[str, Any]:
    """All sizes and modes of one kind of tile, side by side."""
    levels, trials = cfg.effective()
    settings = [(level, mode) for level in levels for mode in cfg.modes]
    rows = [Row(mode, cfg.schedule, trial) for _, mode in settings for trial in range(trials)]
    steps = round(cfg.seconds / CONTROL_DT)
    world = lab.world(cfg.task(), [row.robot for row in rows], cfg.speed, cfg.seed)
    level = np.repeat([level - 1 for level, _ in settings], trials)
    world.place(level, np.full(len(rows), list(tiles()).index(kind)))
    tried = FirstTry(world)
    trace = lab.walk(name, tried, rows, steps, cfg.seed, on_step=tried.over)
    crossed, fell, seconds = outcome(trace)
    runs = [
        _run(cfg, kind, level, mode, crossed[part], fell[part], seconds[part])
        for i, (level, mode) in enumerate(settings)
        for part in [slice(i * trials, (i + 1) * trials)]
    ]
    return {"runs": runs}


def outcome(trace: Trace) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How each robot's first try ended: [N] crossed, [N] fell (bool), [N] seconds it took."""
    first = trace.ended.argmax(axis=0)
    robot = np.arange(trace.ended.shape[1])
    ended, fell = trace.ended[first, robot], trace.fell[first, robot]
    return ended & ~fell, ended & fell, np.where(ended, (first + 1) * CONTROL_DT, np.nan)


def _run(
    cfg: SuccessCfg,
    kind: str,
    level: int,
    mode: str,
    crossed: np.ndarray,
    fell: np.ndarray,
    seconds: np.ndarray,
) -> dict[str, Any]:
    """One row of the summary."""
    low, high = metrics.bootstrap_interval(crossed)
    return {
        "kind": kind,
        "level": level,
        "size_m": tiles()[kind].measure((level - 1) / (LEVELS - 1)),
        "mode": mode,
        "fault": cfg.fault,
        "severity": cfg.severity if cfg.fault else None,
        "trials": len(crossed),
        "crossed": int(crossed.sum()),
        "falls": int(fell.sum()),
        "stuck": int((~crossed & ~fell).sum()),
        "success_rate": float(crossed.mean()),
        "success_ci95_low": low,
        "success_ci95_high": high,
        "median_seconds": float(np.median(seconds[crossed])) if crossed.any() else None,
        "seed": cfg.seed,
    }


def worse_than_blind(runs: Sequence[dict[str, Any]], margin: float = 0.02) -> list[dict[str, Any]]:
    """Sizes RENet crosses less often than OP alone, beyond a margin."""
    op = {(r["kind"], r["level"]): r["success_rate"] for r in runs if r["mode"] == "op"}
    return [
        {"kind": r["kind"], "size_m": r["size_m"], "renet": r["success_rate"], "op": blind}
        for r in runs
        if r["mode"] == "renet"
        and (blind := op.get((r["kind"], r["level"]))) is not None
        and r["success_rate"] < blind - margin
    ]


def draw(summary: dict[str, Any], path: Path, provenance: Provenance) -> None:
    """Write success.png: success rate against size, one panel for each kind of tile."""
    kinds = list(dict.fromkeys(run["kind"] for run in summary["runs"]))
    columns = min(len(kinds), 2)
    lines = -(-len(kinds) // columns)
    with plt.rc_context(figures.STYLE):
        figure, axes = plt.subplots(
            lines, columns, figsize=(9, 2.7 * lines + 0.6), sharey=True, squeeze=False
        )
        for axis, kind in zip(axes.flat, kinds, strict=False):
            runs = [run for run in summary["runs"] if run["kind"] == kind]
            figures.rates(axis, runs, "size_m", "success_rate", "success_ci95")
            axis.set(xlabel=f"{SIZES[kind]} (cm)", ylim=(-4, 104))
        for axis in axes.flat[len(kinds) :]:
            axis.set_axis_off()
        for line in axes:
            line[0].set_ylabel("robots that cross (%)")
        handles, labels = axes[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
        figures.save(figure, path, provenance)


def main(cfg: SuccessCfg) -> None:
    """`renet evaluate success`."""
    summary = run_success(cfg)
    share: dict[tuple[str, str], list[str]] = {}
    for run in summary["runs"]:
        setting = (run["kind"], f"{100 * run['size_m']:.0f}")
        share.setdefault(setting, []).append(f"{100 * run['success_rate']:.0f}")
    rows = [(*setting, *rates) for setting, rates in share.items()]
    trials = cfg.effective()[1]
    show(f"Robots that cross, % of {trials}", ("obstacle", "size (cm)", *cfg.modes), rows)
