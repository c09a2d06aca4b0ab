"""The memory study: robots that cross, against the time for which they get no image.

The camera goes black shortly before an obstacle's edge, for a moment or for good. The robots of all
modes are twins. They have one try, judged by true poses.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from renet.errors import RenetError
from renet.evaluation import figures, metrics
from renet.evaluation.results import column, group_by
from renet.evaluation.rollout import robot_numbers
from renet.evaluation.settings import StudyMode
from renet.evaluation.studies.grounds import (
    EDGES,
    NEAREST,
    LevelStudy,
    onset_before_edge,
    start_facing,
)
from renet.evaluation.studies.terrain import SIZE_LABELS
from renet.evaluation.study import Figures, Part, Table
from renet.faults import Injection
from renet.interface import CONTROL_DT, control_steps
from renet.terrain.tiles import tiles

if TYPE_CHECKING:
    from renet.evaluation.evaluator import Evaluator

DEAD_CAMERA = ("blackout", 5)
"""Fault and severity."""


@dataclass(frozen=True)
class MemoryStudy(LevelStudy):
    """Measure the time for which robots find their way without an image."""

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
    """Times without an image, s; robots with a healthy camera walk as well."""
    before: float = 0.5
    """Time before the edge, at the commanded speed, at which images cease, s; on grounds without an
    edge straight ahead before the place of the nearest one."""
    modes: tuple[StudyMode, ...] = ("camera", "switch", "oracle", "blind", "memory")
    """Policy modes to compare."""

    name: ClassVar[str] = "memory"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.without or min(self.without) <= 0:
            raise RenetError(f"without {self.without}: give times above 0 s")
        if self.before < 0:
            raise RenetError(f"before must be at least 0 s, got {self.before}")
        for ground in self.grounds:
            kind = ground.partition(":")[0]
            if self.onset_on(kind) * CONTROL_DT >= self.seconds:
                raise RenetError(
                    f"at {self.speed} m/s no image is missing within {self.seconds} s on {ground}"
                )

    def onset_on(self, kind: str) -> int:
        """Control step at which images cease on a kind of ground."""
        edge = EDGES.get(kind, NEAREST)
        return control_steps(onset_before_edge(self.speed, self.before, edge))

    @property
    def settings(self) -> list[tuple[float, str]]:
        """Time without an image and mode of each group; mode blind never misses an image."""
        settings = []
        for mode in self.modes:
            settings.append((0.0, mode))
            if mode != "blind":
                settings += product(self.without, (mode,))
        return settings

    def walk_on(self, evaluator: Evaluator, kind: str, level: int, title: str) -> Part:
        """Walk in all modes and times on one ground, side by side."""
        onset = self.onset_on(kind)
        trials = []
        for seconds, mode in self.settings:
            schedule = (Injection.of(*DEAD_CAMERA, onset, seconds),) if seconds else ()
            trials += self.trial_group(mode, schedule, kind)
        cfg = evaluator.terrain_env_cfg({kind: level})
        # Other grounds are alike in all directions, and are met from all.
        if kind in EDGES:
            start_facing(cfg)
        env = evaluator.make_env(cfg, robot_numbers(trials), self.speed, self.seed)
        trace = self.walk(evaluator, env, trials, title, until_ended=onset, retire=True)
        crossed, fell, _ = trace.first_try()
        shape = (len(self.settings), self.robots_each)
        return {"crossed": crossed.reshape(shape), "fell": fell.reshape(shape)}

    def summarise(self, parts: Mapping[str, Part], evaluator: Evaluator) -> dict[str, Any]:
        """Return a row for each ground, mode and time, with the change from a healthy camera."""
        runs = []
        for ground, part in self.by_ground(parts).items():
            kind, level = ground.split(":")
            size = tiles()[kind].measure_at(int(level))
            crossed = dict(zip(self.settings, np.array(part["crossed"], bool), strict=True))
            fell = dict(zip(self.settings, np.array(part["fell"], bool), strict=True))
            for (seconds, mode), successes in crossed.items():
                # Robots are paired with themselves with a healthy camera.
                change = successes.astype(float) - crossed[0.0, mode]
                run = {
                    "ground": kind,
                    "level": int(level),
                    "size_m": size,
                    "mode": mode,
                    "without_s": seconds,
                    "robots": len(successes),
                    "crossed": int(successes.sum()),
                    "fell": int(fell[seconds, mode].sum()),
                    **metrics.share_columns("crossed", successes),
                    **metrics.mean_columns("change", change),
                    "seed": self.seed,
                }
                runs.append(run)
        return {"runs": runs, "robots": self.robots_each}

    def draw(self, summary: dict[str, Any], parts: Mapping[str, Part]) -> Figures:
        """Draw memory.png: share that crosses against the time, one panel for each ground."""
        times = [0.0] + [round(seconds, 6) for seconds in sorted(self.without)]
        panels = {}
        for (kind, size), runs in group_by(summary["runs"], "ground", "size_m").items():
            rows = []
            for run in sorted(runs, key=lambda run: run["without_s"]):
                if run["mode"] == "blind":
                    # Mode blind uses no image: its share is the same for all times.
                    rows += [run | {"without_s": time} for time in times]
                else:
                    rows.append(run)
            panels[f"{SIZE_LABELS[kind]} {100 * size:.0f} cm"] = rows
        figure = figures.share_panels(
            panels, "crossed", lambda run: f"{run['without_s']:g}", "seconds without an image"
        )
        return {"memory.png": figure}

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Tabulate shares that cross, by ground and time."""
        rows = []
        for (kind, level), runs in group_by(summary["runs"], "ground", "level").items():
            crossed = {(run["mode"], run["without_s"]): run["crossed"] for run in runs}
            for seconds in sorted(set(column(runs, "without_s"))):
                # Mode blind was walked once, without missing images.
                counts = (crossed.get((mode, seconds), crossed[mode, 0.0]) for mode in self.modes)
                rows.append((f"{kind}:{level}", f"{seconds:g}", *counts))
        header = ("ground", "seconds", *self.modes)
        return [(f"Robots that cross without an image, of {summary['robots']}", header, rows)]
