"""The memory study: how many robots cross, against the seconds for which they get no image.

The camera goes black half a second before an obstacle's edge, for a moment or for good. A robot
that trusts it, one with the paper's switch, one that remembers, a blind one and one whose switch
knows the fault are twins in all else. Judged by true poses, in one try.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from renet.errors import RenetError
from renet.evaluation import figures, metrics
from renet.evaluation.rollout import Mode, Trial
from renet.evaluation.studies.terrain import SIZES
from renet.evaluation.study import Figures, Part, Table, WalkingStudy
from renet.faults import Injection
from renet.interface import CONTROL_DT
from renet.terrain.tiles import LEVELS, tiles

if TYPE_CHECKING:
    from renet.evaluation.evaluator import Evaluator

EDGE = 1.2
"""Metres from a robot's start to the nearest obstacle's edge."""
DEAD = "blackout", 5
"""The fault, and its severity."""


@dataclass(frozen=True)
class MemoryStudy(WalkingStudy):
    """How long a robot finds its way without an image."""

    out: Path = Path("results/memory")
    """Folder for summary.json, summary.csv, memory.png and parts/."""
    grounds: tuple[str, ...] = (
        "gap:3",
        "gap:5",
        "platform:4",
        "platform:6",
        "stairs_up:6",
        "stairs_down:6",
        "stairs_down:8",
        "obstacles:10",
    )
    """Ground and level, KIND:LEVEL; gap, platform, stairs_up, stairs_down, obstacles, rough, and 1
    to 10."""
    without: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0, 8.0)
    """Seconds without an image; robots with a healthy camera walk as well."""
    before: float = 0.5
    """Seconds before the edge, at the commanded speed, at which images cease."""
    modes: tuple[Mode, ...] = ("vp", "paper", "oracle-switch", "op", "renet")
    """Policy modes to compare."""
    seconds: float = 12.0
    """Time to leave the tile."""

    name: ClassVar[str] = "memory"
    selectable: ClassVar[tuple[str, ...]] = ("grounds",)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.grounds or not self.without:
            raise RenetError("give a ground and a time without an image")
        for ground in self.grounds:
            kind, _, level = ground.partition(":")
            if kind not in tiles() or not level.isdecimal() or not 1 <= int(level) <= LEVELS:
                raise RenetError(
                    f"ground {ground!r}: write KIND:LEVEL, of {', '.join(tiles())} and 1 to"
                    f" {LEVELS}, such as gap:3"
                )
        if min(self.without) <= 0 or len({*self.without}) < len(self.without):
            raise RenetError(f"without {self.without}: give different times above 0 s")
        if self.before < 0 or self.seconds < 1:
            raise RenetError("before must be at least 0 s, and seconds at least 1")

    @property
    def onset(self) -> int:
        """Control step at which images cease."""
        return round(max(EDGE / self.speed - self.before, 0.0) / CONTROL_DT)

    @property
    def settings(self) -> list[tuple[float, str]]:
        """Seconds without an image and mode of each group; OP walks as with a healthy camera."""
        return [
            (seconds, mode)
            for mode in self.modes
            for seconds in (0.0, *(self.without if mode != "op" else ()))
        ]

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """All modes and times on one ground, side by side."""
        return {
            ground.replace(":", "_"): partial(self._walk, evaluator, ground)
            for ground in self.grounds
        }

    def _walk(self, evaluator: Evaluator, ground: str) -> Part:
        kind, _, level = ground.partition(":")
        trials = [
            Trial(mode, self._failure(seconds), robot, kind)
            for seconds, mode in self.settings
            for robot in range(self.robots_each)
        ]
        cfg = evaluator.grounds_env_cfg({kind: int(level)})
        robots = tuple(trial.robot for trial in trials)
        env = evaluator.make_env(cfg, robots, self.speed, self.seed)
        env.place_on([trial.ground for trial in trials])
        title = f"{self.grounds.index(ground) + 1}/{len(self.grounds)} {ground}"
        steps = round(self.seconds / CONTROL_DT)
        rollout = evaluator.rollout(env, trials, self.seed)
        trace = rollout.run(steps, title, until_ended=self.onset)
        groups = trace.groups(self.robots_each)
        crossed, fell = zip(*(group.first_try()[:2] for group in groups), strict=True)
        return {"crossed": np.stack(crossed), "fell": np.stack(fell)}

    def _failure(self, seconds: float) -> tuple[Injection, ...]:
        return (Injection.of(*DEAD, self.onset, seconds),) if seconds else ()

    def summarise(self, parts: Mapping[str, Part], evaluator: Evaluator) -> dict[str, Any]:
        """One row for each ground, mode and time; what two seconds without an image cost."""
        runs = []
        for ground in self.grounds:
            part, (kind, _, level) = parts[ground.replace(":", "_")], ground.partition(":")
            crossed = {
                setting: np.array(robots, bool)
                for setting, robots in zip(self.settings, part["crossed"], strict=True)
            }
            for (seconds, mode), fell in zip(self.settings, part["fell"], strict=True):
                shares = crossed[seconds, mode]
                # The same robots with a healthy camera: what the missing images cost each.
                change = shares.astype(float) - crossed[0.0, mode]
                runs.append(
                    {
                        "ground": kind,
                        "level": int(level),
                        "size_m": tiles()[kind].measure((int(level) - 1) / (LEVELS - 1)),
                        "mode": mode,
                        "without_s": seconds,
                        "robots": len(shares),
                        "crossed": int(shares.sum()),
                        "fell": int(np.sum(fell)),
                        "crossed_rate": float(shares.mean()),
                        **metrics.with_interval("crossed", shares),
                        "change": float(change.mean()),
                        **metrics.with_interval("change", change),
                        "seed": self.seed,
                    }
                )
        return {"runs": runs, "robots": self.robots_each, "onset_s": self.onset * CONTROL_DT}

    def draw(self, summary: dict[str, Any], parts: Mapping[str, Part]) -> Figures:
        """memory.png: the share that crosses against the time, one panel for each ground."""
        columns = min(len(self.grounds), 4)
        rows = -(-len(self.grounds) // columns)
        size = (2.5 * columns + 0.8, 2.4 * rows + 0.7)
        figure, axes = plt.subplots(
            rows, columns, figsize=size, sharex=True, sharey=True, squeeze=False
        )
        for axis, ground in zip(axes.flat, self.grounds, strict=False):
            kind, _, level = ground.partition(":")
            runs = [r for r in summary["runs"] if (r["ground"], r["level"]) == (kind, int(level))]
            self._draw_ground(axis, runs)
            axis.set(title=f"{SIZES[kind]} {100 * runs[0]['size_m']:.0f} cm", ylim=(-4, 104))
        for axis in axes.flat[len(self.grounds) :]:
            axis.set_axis_off()
        figure.supylabel("robots that cross (%)", fontsize=10)
        axes[-1][0].set_xlabel("seconds without an image")
        handles, labels = axes[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
        return {"memory.png": figure}

    def _draw_ground(self, axis: Axes, runs: list[dict[str, Any]]) -> None:
        """One line for each mode, with 95 % intervals over robots; even steps, not to scale."""
        times = [0.0, *sorted(self.without)]
        for number, mode in enumerate(self.modes):
            line = sorted((r for r in runs if r["mode"] == mode), key=lambda run: run["without_s"])
            share, low, high = (
                np.array([100 * run[name] for run in line])
                for name in ("crossed_rate", "crossed_ci95_low", "crossed_ci95_high")
            )
            place = np.arange(len(line)) + 0.06 * (number - (len(self.modes) - 1) / 2)
            look: Any = {"color": figures.MODE_COLOURS[mode], "label": figures.MODE_NAMES[mode]}
            if mode == "op":
                axis.axhline(share[0], linestyle="--", **look)
                continue
            error = np.abs([low - share, high - share])
            axis.errorbar(place, share, error, fmt="o-", markersize=3.5, elinewidth=0.8, **look)
        axis.set_xticks(range(len(times)), [f"{time:g}" for time in times])

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Shares that cross, by ground and time."""
        runs = {
            (r["ground"], r["level"], r["without_s"], r["mode"]): r["crossed"]
            for r in summary["runs"]
        }
        rows = []
        for ground in self.grounds:
            kind, level = ground.split(":")
            for seconds in (0.0, *self.without):
                counts = (
                    runs[kind, int(level), 0.0 if mode == "op" else seconds, mode]
                    for mode in self.modes
                )
                rows.append((ground, f"{seconds:g}", *counts))
        header = ("ground", "seconds", *self.modes)
        return [(f"Robots that cross without an image, of {summary['robots']}", header, rows)]
