"""The memory study: how many robots cross, against the seconds for which they get no image.

The camera goes black half a second before an obstacle's edge, for a moment or for good. A robot
that trusts it, one with the paper's switch, one that remembers, a blind one and one whose switch
knows the fault are twins in all else. Judged by true poses, in one try.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from renet.errors import RenetError
from renet.evaluation import figures, metrics
from renet.evaluation.results import grouped
from renet.evaluation.rollout import Mode, Trial
from renet.evaluation.studies.one_try import NEAREST, LevelStudy
from renet.evaluation.studies.terrain import SIZES
from renet.evaluation.study import Figures, Part, Table
from renet.faults import Injection
from renet.interface import CONTROL_DT
from renet.terrain.tiles import LEVELS, tiles

if TYPE_CHECKING:
    from renet.evaluation.evaluator import Evaluator

DEAD = "blackout", 5
"""The fault, and its severity."""


@dataclass(frozen=True)
class MemoryStudy(LevelStudy):
    """How long a robot finds its way without an image."""

    out: Path = Path("results/memory")
    """Folder for summary.md, summary.json, summary.csv, memory.png and parts/."""
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
    """Ground and level, KIND:LEVEL, such as gap:3; levels are 1 to 10."""
    without: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0, 8.0)
    """Seconds without an image; robots with a healthy camera walk as well."""
    before: float = 0.5
    """Seconds before the edge, at the commanded speed, at which images cease."""
    modes: tuple[Mode, ...] = ("camera", "switch", "oracle", "blind", "memory")
    """Policy modes to compare."""

    name: ClassVar[str] = "memory"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.without or min(self.without) <= 0 or len({*self.without}) < len(self.without):
            raise RenetError(f"without {self.without}: give different times above 0 s")
        if self.before < 0:
            raise RenetError(f"before must be at least 0 s, got {self.before}")
        if self.onset * CONTROL_DT >= self.seconds:
            raise RenetError(f"at {self.speed} m/s no image is missing within {self.seconds} s")

    @property
    def onset(self) -> int:
        """Control step at which images cease."""
        return round(max(NEAREST / self.speed - self.before, 0.0) / CONTROL_DT)

    @property
    def settings(self) -> list[tuple[float, str]]:
        """Seconds without an image and mode of each group; to blind robots no image is missing."""
        return [
            (seconds, mode)
            for mode in self.modes
            for seconds in (0.0, *(self.without if mode != "blind" else ()))
        ]

    def walk_on(self, evaluator: Evaluator, kind: str, level: int, title: str) -> Part:
        """All modes and times on one ground, side by side."""
        trials = [
            Trial(mode, (Injection.of(*DEAD, self.onset, seconds),) if seconds else (), robot, kind)
            for seconds, mode in self.settings
            for robot in range(self.robots_each)
        ]
        trace = self.walk(evaluator, {kind: level}, trials, title, until_ended=self.onset)
        crossed, fell, _ = trace.first_try()
        shape = (len(self.settings), self.robots_each)
        return {"crossed": crossed.reshape(shape), "fell": fell.reshape(shape)}

    def summarise(self, parts: Mapping[str, Part], evaluator: Evaluator) -> dict[str, Any]:
        """One row for each ground, mode and time; what the missing images cost."""
        runs = []
        for ground, part in self.by_ground(parts).items():
            kind, level = ground.split(":")
            crossed, fell = (
                dict(zip(self.settings, np.array(part[name], bool), strict=True))
                for name in ("crossed", "fell")
            )
            for (seconds, mode), shares in crossed.items():
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
                        "fell": int(fell[seconds, mode].sum()),
                        "crossed_rate": float(shares.mean()),
                        **metrics.with_share_interval("crossed", shares),
                        "change": float(change.mean()),
                        **metrics.with_interval("change", change),
                        "seed": self.seed,
                    }
                )
        return {"runs": runs, "robots": self.robots_each, "onset_s": self.onset * CONTROL_DT}

    def draw(self, summary: dict[str, Any], parts: Mapping[str, Part]) -> Figures:
        """memory.png: the share that crosses against the time, one panel for each ground."""
        times = [0.0, *(round(seconds, 6) for seconds in sorted(self.without))]
        panels = {
            f"{SIZES[kind]} {100 * size:.0f} cm": [
                run | {"without_s": time}
                for run in sorted(runs, key=lambda run: run["without_s"])
                # Mode blind, which never sees, has one share at all times.
                for time in (times if run["mode"] == "blind" else [run["without_s"]])
            ]
            for (kind, size), runs in grouped(summary["runs"], "ground", "size_m").items()
        }
        tick, xlabel = lambda run: f"{run['without_s']:g}", "seconds without an image"
        return {"memory.png": figures.share_panels(panels, "crossed", tick, xlabel)}

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Shares that cross, by ground and time."""
        rows = []
        for (kind, level), runs in grouped(summary["runs"], "ground", "level").items():
            crossed = {(run["mode"], run["without_s"]): run["crossed"] for run in runs}
            for seconds in sorted({run["without_s"] for run in runs}):
                counts = (crossed.get((mode, seconds), crossed[mode, 0.0]) for mode in self.modes)
                rows.append((f"{kind}:{level}", f"{seconds:g}", *counts))
        header = ("ground", "seconds", *self.modes)
        return [(f"Robots that cross without an image, of {summary['robots']}", header, rows)]
