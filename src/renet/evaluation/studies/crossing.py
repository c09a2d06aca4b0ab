"""The fault benchmark, version 2: what a policy still crosses when its camera fails at an edge.

Robots walk straight at an obstacle of three sizes. Each one's camera fails a distance before the
edge, for some seconds; its twin's never does. Some faults are drawn by a seed, so that nobody can
tune a policy to a list. docs/crossing.md is the specification.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from renet.errors import RenetError
from renet.evaluation import figures, metrics
from renet.evaluation.results import grouped, write_json
from renet.evaluation.rollout import Trial
from renet.evaluation.studies.benchmark import LISTED, header
from renet.evaluation.studies.one_try import AIM, EDGES, OneTryStudy
from renet.evaluation.study import Figures, Part, Table
from renet.evaluation.trace import Trace
from renet.faults import FAULTS, Injection
from renet.faults.physical import PhysicalFault
from renet.files import remove
from renet.interface import CONTROL_DT

if TYPE_CHECKING:
    from renet.evaluation.evaluator import Evaluator

VERSION = 2
SIZES = ("easy", "hard", "frontier")
LEVELS = {
    "gap": (3, 6, 10),
    "platform": (4, 6, 10),
    "stairs_up": (6, 8, 10),
    "stairs_down": (6, 8, 10),
}
"""Level of each size: gaps of 23, 43, 70 cm, platforms of 20, 30, 50 cm, steps of 15, 19, 23 cm."""
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
BATCH = 64
"""Groups of robots that walk side by side."""

Faults = tuple[tuple[str, int], ...]
"""Faults that act one after the other on the same images, each with its severity."""


def drawn_faults(draw: int) -> dict[str, Faults]:
    """Faults that nobody knows before the seed is named: one or two at once, severities 3 to 5."""
    rng = np.random.default_rng(draw)
    names = [name for name in LISTED if not issubclass(FAULTS[name], PhysicalFault)]
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
class CrossingStudy(OneTryStudy):
    """What a policy still crosses when its camera fails just before an edge."""

    out: Path = Path("results/benchmark")
    """Folder for summary.json, summary.csv, result.json, crossing.png and parts/."""
    draw_seed: int = 0
    """Seed of the faults that are on no list."""
    grounds: tuple[str, ...] = tuple(LEVELS)
    """Kinds of tile."""

    name: ClassVar[str] = "benchmark"
    quick_robots: ClassVar[int] = 10

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.grounds or not {*self.grounds} <= {*LEVELS}:
            raise RenetError(f"grounds {self.grounds}: choose among {', '.join(LEVELS)}")
        if self.draw_seed < 0:
            raise RenetError(f"draw seed must be at least 0, got {self.draw_seed}")

    def levels(self, size: str) -> dict[str, int]:
        """Level of each ground."""
        return {ground: LEVELS[ground][SIZES.index(size)] for ground in self.grounds}

    @property
    def faults(self) -> dict[str, Faults]:
        """Every fault by its name in the results; `quick` takes every second one."""
        faults = {name: ((name, 5),) for name in TELLING} | drawn_faults(self.draw_seed)
        return dict(list(faults.items())[:: 2 if self.quick else 1])

    @property
    def settings(self) -> list[Setting]:
        """Every way cameras fail; `quick` takes the shorter distance and the longer time."""
        distances = DISTANCES[:1] if self.quick else DISTANCES
        lengths = LENGTHS[-1:] if self.quick else LENGTHS
        return [Setting(*one) for one in itertools.product(self.faults, distances, lengths)]

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """One part for each size; `quick` leaves out the frontier."""
        sizes = SIZES[:2] if self.quick else SIZES
        return {size: partial(self._walk, evaluator, size) for size in sizes}

    def _walk(self, evaluator: Evaluator, size: str) -> Part:
        """Walk with healthy cameras first: they tell when each robot is where its twin's fails."""
        levels = self.levels(size)
        each, cfg = self.robots_each, evaluator.terrain_env_cfg(levels)
        spawn = cfg.events["spawn"].params["pose_range"]
        spawn |= {"x": (0.0, 0.0), "y": (0.0, 0.0), "yaw": (-AIM, AIM)}

        def walk(trials: list[Trial], title: str, retire: bool) -> Iterator[Trace]:
            for start in range(0, len(trials), BATCH * each):
                batch = trials[start : start + BATCH * each]
                bar = f"{size}, {title} {start + len(batch)}/{len(trials)}"
                yield from self.walk(evaluator, cfg, batch, bar, retire=retire).groups(each)

        pairs = list(itertools.product(self.grounds, self.modes))
        # One that falls before the edge may come there in a later try, which tells its onset.
        healthy_walks = walk(self.trials_on(self.grounds), "healthy", retire=False)
        twins = dict(zip(pairs, healthy_walks, strict=True))
        # A robot in OP walks as its twin does.
        groups = [(*pair, s) for pair in pairs if pair[1] != "blind" for s in self.settings]
        trials = [
            Trial(mode, self._failure(setting, onset), robot, ground)
            for ground, mode, setting in groups
            for robot, onset in enumerate(self._onsets(twins[ground, mode], EDGES[ground], setting))
        ]
        tries = (trace.first_try() for trace in walk(trials, "failing", retire=True))
        walked = dict(zip(groups, tries, strict=True))
        runs = []
        for (ground, mode), setting in itertools.product(pairs, self.settings):
            healthy = twins[ground, mode].first_try()
            crossed, fell, _ = walked.get((ground, mode, setting), healthy)
            values = {"crossed": crossed, "upright": ~fell, "twins": healthy[0]}
            runs.append(
                {"ground": ground, "size": size, "level": levels[ground]}
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
        """As every study; writes result.json as well, unless conditions are not version 2's."""
        summary = super().run(evaluator)
        remove(self.out / "result.json")
        if self.conditions == "nominal":
            write_json(self.out / "result.json", result(summary))
        return summary

    def draw(self, summary: dict[str, Any], parts: Mapping[str, Part]) -> Figures:
        """crossing.png: who crosses each ground, by fault, all sizes together."""
        runs = [run for part in parts.values() for run in part["runs"]]
        panels: dict[str, list[dict[str, Any]]] = {}
        for (ground, mode), rows in grouped(runs, "ground", "mode").items():
            crossed = {"healthy": [run["values"]["twins"] for run in rows]} | {
                name: [run["values"]["crossed"] for run in group]
                for (name,), group in grouped(rows, "fault").items()
            }
            panels.setdefault(ground.replace("_", " "), []).extend(
                {"mode": mode, "fault": name, "crossed_rate": np.mean(values)}
                | metrics.with_interval("crossed", np.mean(values, axis=0))
                for name, values in crossed.items()
            )
        tick = lambda run: run["fault"].replace("_", " ")  # noqa: E731
        return {"crossing.png": figures.share_panels(panels, "crossed", tick, rotation=90)}

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Each mode's scores."""
        return [ranking([result(summary)])]


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


def ranking(results: Sequence[Mapping[str, Any]]) -> Table:
    """The leaderboard, best first, by what is crossed; shares in per cent.

    Its last column is what mode `memory` of the first result, or else its first mode, crosses more:
    points, with a 95 % bootstrap interval over robots, each paired with itself.

    Raises RenetError for results of different protocols, whose robots met other things.
    """
    if any(_conditions(result) != _conditions(results[0]) for result in results):
        raise RenetError(
            "give results of the same settings: robots, seeds, speed, seconds, quick and grounds"
        )
    first = results[0]["scores"]
    reference = "memory" if "memory" in first else next(iter(first))
    entries = sorted(
        (
            (result["policy"]["name"], mode, scores)
            for result in results
            for mode, scores in result["scores"].items()
        ),
        key=lambda entry: -entry[-1]["crossed"],
    )
    rows = []
    for place, (name, mode, scores) in enumerate(entries, start=1):
        cells = []
        for share in ("crossed", "kept"):
            ends = [scores.get(f"{share}_ci95_{end}") for end in ("low", "high")]
            interval = "-" if None in ends else " to ".join(map(_percent, ends))
            cells += [_percent(scores[share]), interval]
        gain = 100 * np.subtract(first[reference]["by_robot"], scores["by_robot"])
        low, high = metrics.bootstrap_interval(gain)
        ahead = f"{gain.mean():+.1f} ({low:+.1f} to {high:+.1f})"
        others = map(_percent, (scores["healthy"], scores["upright"]))
        rows.append((str(place), name, mode, *cells, *others, ahead))
    title = f"Fault benchmark, version 2; ahead: {results[0]['policy']['name']}, {reference}, is"
    columns = ("crossed", "95 %", "kept", "95 %", "healthy", "upright", "ahead")
    return title, ("", "policy", "mode", *columns), rows


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f}"


def _conditions(result: Mapping[str, Any]) -> tuple[Any, ...]:
    """What the robots of a result met: equal for results that can be compared."""
    names = ("ground", "size", "level", "fault", "distance", "length")
    settings = {tuple(row[name] for name in names) for row in result["settings"]}
    return result["protocol"], result["faults"], settings


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

    everybody = np.arange(len(able))
    if able.any():
        scores |= {"kept": share(everybody)} | metrics.with_interval("kept", everybody, share)
    return scores
