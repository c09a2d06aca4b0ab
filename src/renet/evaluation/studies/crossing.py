"""The fault benchmark, version 2: what a policy still crosses when its camera fails at an edge.

Robots walk straight at an obstacle of three sizes. Each one's camera fails a distance before the
edge, for some seconds; its twin's never does. Some faults are drawn by a seed, so that nobody can
tune a policy to a list. docs/benchmark.md is the specification.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from renet.errors import RenetError
from renet.evaluation import metrics
from renet.evaluation.results import write_json
from renet.evaluation.rollout import Trial
from renet.evaluation.studies.benchmark import header
from renet.evaluation.study import Part, Table, WalkingStudy
from renet.evaluation.trace import Trace
from renet.faults import FAULTS, Injection
from renet.faults.physical import PhysicalFault
from renet.interface import CONTROL_DT

if TYPE_CHECKING:
    from renet.evaluation.env import SimEnv
    from renet.evaluation.evaluator import Evaluator

VERSION = 2
SIZES = ("easy", "hard", "frontier")
LEVELS = {
    "gap": (3, 6, 8),
    "platform": (4, 6, 8),
    "stairs_up": (6, 8, 10),
    "stairs_down": (6, 8, 10),
}
"""Level of each size: gaps of 23, 43, 57 cm, platforms of 20, 30, 40 cm, steps of 15, 19, 23 cm."""
EDGES = {"gap": 1.2, "platform": 1.4, "stairs_up": 1.2, "stairs_down": 1.5}
"""m from the middle of a tile, where robots start, to the first edge."""
DISTANCES = (0.3, 0.8)
"""m before the edge at which cameras fail."""
LENGTHS = (1.0, 4.0)
"""Seconds for which they fail."""
TELLING = (
    "blackout",
    "saturated",
    "frozen",
    "occlusion",
    "dropped",
    "latency",
    "gaussian",
    "salt_and_pepper",
    "glare",
    "textureless",
    "tall_grass",
    "wrong_scale",
)
"""Faults, at severity 5, of which version 1 found that they harm somebody, or that nobody notices
them."""
DRAWN = 4
"""Faults that the seed draws."""
AIM = 0.1
"""Robots start within this angle of straight at the obstacle, rad."""

Faults = tuple[tuple[str, int], ...]
"""Faults that act one after the other on the same images, each with its severity."""


def drawn_faults(draw: int) -> dict[str, Faults]:
    """Faults that nobody knows before the seed is named: one or two at once, severities 3 to 5."""
    rng = np.random.default_rng(draw)
    names = [name for name, fault in FAULTS.items() if not issubclass(fault, PhysicalFault)]
    drawn = {}
    for number in range(1, DRAWN + 1):
        chosen = rng.choice(names, size=rng.integers(1, 3), replace=False)
        drawn[f"drawn_{number}"] = tuple((str(name), int(rng.integers(3, 6))) for name in chosen)
    return drawn


class Setting(NamedTuple):
    """How the cameras of a group of robots fail."""

    fault: str
    distance: float
    """m before the edge."""
    length: float
    """Seconds."""


@dataclass(frozen=True)
class CrossingStudy(WalkingStudy):
    """What a policy still crosses when its camera fails just before an edge."""

    out: Path = Path("results/benchmark")
    """Folder for summary.json, summary.csv, result.json and parts/."""
    draw_seed: int = 0
    """Seed of the faults that are on no list."""
    grounds: tuple[str, ...] = tuple(LEVELS)
    """Kinds of tile."""
    seconds: float = 12.0
    """Time to leave the tile."""

    name: ClassVar[str] = "benchmark"
    selectable: ClassVar[tuple[str, ...]] = ("grounds",)
    quick_robots: ClassVar[int] = 10

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.grounds or not {*self.grounds} <= {*LEVELS}:
            raise RenetError(f"grounds {self.grounds}: choose among {', '.join(LEVELS)}")
        if self.draw_seed < 0 or self.seconds < 1:
            raise RenetError("draw seed must be at least 0, and seconds at least 1")

    @property
    def faults(self) -> dict[str, Faults]:
        """Every fault by its name in the results."""
        return {name: ((name, 5),) for name in TELLING} | drawn_faults(self.draw_seed)

    @property
    def places(self) -> list[tuple[str, str]]:
        """Kind and size of every ground; `quick` leaves out the frontier."""
        return list(itertools.product(self.grounds, SIZES[:2] if self.quick else SIZES))

    @property
    def settings(self) -> list[Setting]:
        """Every way cameras fail; `quick` takes the shorter distance and the longer time."""
        distances = DISTANCES[:1] if self.quick else DISTANCES
        lengths = LENGTHS[-1:] if self.quick else LENGTHS
        return [Setting(*one) for one in itertools.product(self.faults, distances, lengths)]

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """One part for each kind and size of ground."""
        return {"_".join(place): partial(self._walk, evaluator, *place) for place in self.places}

    def _walk(self, evaluator: Evaluator, ground: str, size: str) -> Part:
        """Walk with healthy cameras first: they tell when each robot is where its twin's fails."""
        level, each = LEVELS[ground][SIZES.index(size)], self.robots_each
        cfg = evaluator.terrain_env_cfg({ground: level})
        spawn = cfg.events["spawn"].params["pose_range"]
        spawn |= {"x": (0.0, 0.0), "y": (0.0, 0.0), "yaw": (-AIM, AIM)}

        def run(trials: list[Trial], title: str) -> list[Trace]:
            env: SimEnv = evaluator.make_env(cfg, [t.robot for t in trials], self.speed, self.seed)
            env.place_on([ground] * len(trials))
            rollout = evaluator.rollout(env, trials, self.seed)
            steps = round(self.seconds / CONTROL_DT)
            return rollout.run(steps, title, until_ended=1).groups(each)

        place = f"{self.places.index((ground, size)) + 1}/{len(self.places)} {ground}, {size}"
        healthy = [Trial(mode, (), r, ground) for mode in self.modes for r in range(each)]
        twins: dict[str, Trace] = dict(
            zip(self.modes, run(healthy, f"{place}: twins"), strict=True)
        )
        # A robot in OP walks as its twin does.
        groups = [(mode, s) for mode in self.modes if mode != "op" for s in self.settings]
        trials = [
            Trial(mode, self._failure(setting, onset), robot, ground)
            for mode, setting in groups
            for robot, onset in enumerate(self._onsets(twins[mode], EDGES[ground], setting))
        ]
        walked = dict(zip(groups, run(trials, place), strict=True)) if trials else {}
        runs = []
        for mode, setting in itertools.product(self.modes, self.settings):
            crossed, fell, _ = walked.get((mode, setting), twins[mode]).first_try()
            values = {"crossed": crossed, "upright": ~fell, "twins": twins[mode].first_try()[0]}
            runs.append(
                {"ground": ground, "size": size, "level": level}
                | setting._asdict()
                | {"mode": mode, "robots": each, "values": values}
            )
        return {"runs": runs}

    def _onsets(self, twins: Trace, edge: float, setting: Setting) -> list[int]:
        """Control step at which each robot comes so near the edge, or should, [N]."""
        there = twins.travelled >= edge - setting.distance
        due = round((edge - setting.distance) / self.speed / CONTROL_DT)
        return np.where(there.any(axis=0), there.argmax(axis=0), due).tolist()

    def _failure(self, setting: Setting, onset: int) -> tuple[Injection, ...]:
        faults = self.faults[setting.fault]
        return tuple(Injection.of(*fault, onset, setting.length) for fault in faults)

    def summarise(self, parts: Mapping[str, Part], evaluator: Evaluator) -> dict[str, Any]:
        """One row for each setting and mode, and each mode's score over all of them."""
        runs = [run for part in parts.values() for run in part["runs"]]
        return {
            "runs": [_counts(run) | {"seed": self.seed} for run in runs],
            "scores": {mode: score([r for r in runs if r["mode"] == mode]) for mode in self.modes},
            "faults": self.faults,
            "robots": self.robots_each,
        }

    def run(self, evaluator: Evaluator | None = None) -> dict[str, Any]:
        """As every study; writes result.json as well."""
        summary = super().run(evaluator)
        write_json(self.out / "result.json", result(summary))
        return summary

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Each mode's scores."""
        rows = [(mode, *score_cells(scores)) for mode, scores in summary["scores"].items()]
        return [("Fault benchmark, version 2", ("mode", *SCORES), rows)]


SCORES = ("crossed", "95 %", "kept", "95 %", "healthy", "upright")
"""Columns of a table of scores."""


def score_cells(scores: Mapping[str, Any]) -> list[str]:
    """The cells of `SCORES`, in percent."""

    def share(name: str) -> str:
        return "-" if scores[name] is None else f"{100 * scores[name]:.1f} %"

    def interval(name: str) -> str:
        if scores[name] is None:
            return "-"
        return "{:.1f} to {:.1f}".format(
            *(100 * scores[f"{name}_ci95_{e}"] for e in ("low", "high"))
        )

    intervals = [cell for name in ("crossed", "kept") for cell in (share(name), interval(name))]
    return [*intervals, share("healthy"), share("upright")]


def result(summary: Mapping[str, Any]) -> dict[str, Any]:
    """The result file of a study's summary."""
    protocol = {name: summary["settings"][name] for name in PROTOCOL}
    names = ("ground", "size", "level", "fault", "distance", "length", "mode")
    counts = ("crossed", "kept", "upright", "twins")
    return header(summary, VERSION) | {
        "protocol": {"robots": summary["robots"]} | protocol,
        "faults": summary["faults"],
        "scores": summary["scores"],
        "settings": [{name: run[name] for name in (*names, *counts)} for run in summary["runs"]],
    }


PROTOCOL = ("seed", "draw_seed", "speed", "seconds", "quick")
"""Settings of the study that a result file tells."""


def places(results: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Rows of the leaderboard, best first, by what is crossed.

    Raises RenetError for results of different protocols, whose robots met other things.
    """
    if any(r["protocol"] != results[0]["protocol"] for r in results):
        raise RenetError("give results of one protocol: robots, seeds, speed, seconds, quick")
    entries = [
        (scores["crossed"], result["policy"]["name"], mode, score_cells(scores))
        for result in results
        for mode, scores in result["scores"].items()
    ]
    entries.sort(key=lambda entry: -entry[0])
    return [(str(place), *entry[1:3], *entry[3]) for place, entry in enumerate(entries, start=1)]


def _counts(run: Mapping[str, Any]) -> dict[str, Any]:
    """A run with numbers of robots in place of one value for each."""
    values = {name: np.array(robots, bool) for name, robots in run["values"].items()}
    counts = {name: int(robots.sum()) for name, robots in values.items()}
    kept = int((values["crossed"] & values["twins"]).sum())
    return {k: v for k, v in run.items() if k != "values"} | counts | {"kept": kept}


def score(runs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The scores of a mode, with 95 % bootstrap intervals over robots, which stand in all settings.

    `crossed`, `healthy` (twins that cross) and `upright` are shares of all robots in all settings.
    `kept` is the share that crosses of those whose twins do; None if nobody's does. `by_robot` is
    each robot's share of settings crossed, for comparisons of policies robot by robot.
    """
    crossed, upright, twins = (
        np.array([run["values"][name] for run in runs], float)  # [settings, robots]
        for name in ("crossed", "upright", "twins")
    )
    by_robot = crossed.mean(axis=0)
    scores = {"crossed": by_robot.mean(), "healthy": twins.mean(), "upright": upright.mean()}
    scores |= metrics.with_interval("crossed", by_robot) | {"kept": None, "by_robot": by_robot}
    kept, able = (crossed * twins).sum(axis=0), twins.sum(axis=0)

    def share(robots: np.ndarray, axis: int = -1) -> np.ndarray:
        chosen = robots.astype(int)
        return kept[chosen].sum(axis) / np.maximum(able[chosen].sum(axis), 1)

    if able.any():
        low, high = metrics.bootstrap_interval(np.arange(len(able)), share)
        everybody = share(np.arange(len(able)))
        scores |= {"kept": everybody, "kept_ci95_low": low, "kept_ci95_high": high}
    return scores
