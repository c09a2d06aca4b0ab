"""The camera-use study: whether a policy looks at its camera, on which ground, and what it gains.

Twins differ in nothing but the images they are shown. If the camera does not matter, they walk the
same way to the centimetre. The policy may be anybody's (docs/measure.md, Your own policy).
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from scipy.stats import binomtest, fisher_exact

from renet.errors import RenetError
from renet.evaluation import figures, metrics
from renet.evaluation.results import grouped
from renet.evaluation.rollout import FLAT, EvalEnv, Mode, Trial
from renet.evaluation.studies.one_try import LevelStudy
from renet.evaluation.study import Figures, Part, Table
from renet.evaluation.trace import StepResult
from renet.terrain.tiles import tiles

if TYPE_CHECKING:
    from renet.evaluation.evaluator import Evaluator

VIEWS = {
    "healthy": "its own images",
    "control": "its own images again",
    "blank": "black images",
    "frozen": "its first image",
    "mirrored": "its images, left and right exchanged",
    "foreign": "another robot's images",
}
"""What each group of twins is shown. The control tells how far rounding alone parts twins."""
PARTED = 0.01
"""m by which the ways of twins differ at least once if the images mattered."""
CHANCE = 0.01
"""Probability below which a difference is not called chance; divided by the number of tests."""


class ShownImages:
    """An environment whose robots are shown other images than their cameras take; see `VIEWS`."""

    def __init__(self, env: EvalEnv, views: Sequence[str], each: int) -> None:
        """Wrap an environment: groups of `each` robots, one for every view of a ground in turn."""
        self._env, self._views = env, np.array(views)
        row = np.arange(len(views))
        healthy = row - row % (each * len(VIEWS))
        self._other = healthy + (row + 1) % each
        """The healthy row of the next robot on the same ground, [N]."""

    def __getattr__(self, name: str) -> Any:
        return getattr(self._env, name)

    def reset(self) -> StepResult:
        """Put every robot at its start; its image there is what a frozen camera shows."""
        result = self._env.reset()
        self._first = result.depth.copy()
        return self._show(result)

    def step(self, action: np.ndarray) -> StepResult:
        """Act [N, 12] for one control step."""
        return self._show(self._env.step(action))

    def _show(self, result: StepResult) -> StepResult:
        depth, shown = result.depth, result.depth.copy()
        for view, images in (
            ("blank", np.zeros_like(depth)),
            ("frozen", self._first),
            ("mirrored", depth[..., ::-1]),
            ("foreign", depth[self._other]),
        ):
            rows = self._views == view
            shown[rows] = images[rows]
        return replace(result, depth=shown)


@dataclass(frozen=True)
class CameraUseStudy(LevelStudy):
    """Whether a policy uses its camera: twins that are shown wrong images, on six grounds."""

    out: Path = Path("results/camera_use")
    """Folder for summary.md, summary.json, summary.csv, camera_use.png and parts/."""
    grounds: tuple[str, ...] = (
        "flat:1",
        "obstacles:6",
        "stairs_up:5",
        "stairs_down:6",
        "platform:4",
        "gap:3",
    )
    """Ground and level, KIND:LEVEL, such as gap:3 or flat:1."""
    modes: tuple[Mode, ...] = ("camera",)
    """Mode of renet's own policies, one: camera looks always, blind never; others ignore it."""
    seconds: float = 10.0
    """Time to leave the tile."""

    name: ClassVar[str] = "camera_use"
    kinds: ClassVar[tuple[str, ...]] = (FLAT, *tiles())
    quick_robots: ClassVar[int] = 8

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.robots < 2 or len(self.modes) > 1:
            raise RenetError("give at least 2 robots, and one mode")

    def walk_on(self, evaluator: Evaluator, kind: str, level: int, title: str) -> Part:
        """All views on one ground, side by side."""
        each = self.robots_each
        views = [view for view in VIEWS for _ in range(each)]
        trials = [Trial(self.modes[0], (), row % each, kind) for row in range(len(views))]
        shown = partial(ShownImages, views=views, each=each)
        # A robot whose try is over goes on taking the images that another is shown.
        trace = self.walk(evaluator, {kind: level}, trials, title, retire=False, view=shown)
        groups = dict(zip(VIEWS, trace.groups(each), strict=True))
        healthy = groups["healthy"]
        part: Part = {}
        for view, group in groups.items():
            apart = np.abs(group.travelled - healthy.travelled) * ~(healthy.over | group.over)
            crossed, *_ = group.first_try()
            part[view] = {"crossed": crossed, "parted": apart.max(axis=0) > PARTED}
        return part

    def summarise(self, parts: Mapping[str, Part], evaluator: Evaluator) -> dict[str, Any]:
        """One row for each ground and view, the totals over all grounds, and the sentence."""
        grounds, labels = self.by_ground(parts), {"mode": self.modes[0], "seed": self.seed}
        runs = [
            {"ground": ground, "view": view} | labels | compare(part, view)
            for ground, part in grounds.items()
            for view in VIEWS
        ]
        whole = {
            view: {
                name: np.concatenate([part[view][name] for part in grounds.values()])
                for name in ("crossed", "parted")
            }
            for view in VIEWS
        }
        total = {view: compare(whole, view) for view in VIEWS}
        return {"runs": runs, "total": total, "sentence": sentence(total, runs)}

    def draw(self, summary: dict[str, Any], parts: Mapping[str, Part]) -> Figures:
        """camera_use.png: who crosses, by what it is shown, one panel for each ground."""
        panels = {
            ground.replace("_", " "): runs
            for (ground,), runs in grouped(summary["runs"], "ground").items()
        }
        figure = figures.share_panels(panels, "crossed", itemgetter("view"), rotation=90)
        figure.suptitle(textwrap.fill(summary["sentence"], 100), fontsize=9)
        return {"camera_use.png": figure}

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Who crosses each ground, and who walks otherwise than its twin, by what it is shown."""
        crossed = {(run["ground"], run["view"]): run["crossed"] for run in summary["runs"]}
        rows: list[tuple[Any, ...]] = [
            (ground, *(crossed[ground, view] for view in VIEWS)) for ground in self.grounds
        ]
        rows.append(("walk otherwise", *(summary["total"][view]["parted"] for view in VIEWS)))
        robots = summary["runs"][0]["robots"]
        return [(summary["sentence"], (f"of {robots} cross", *VIEWS), rows)]


def compare(part: Mapping[str, Mapping[str, Any]], view: str) -> dict[str, Any]:
    """Robots that cross in a view, and how they compare with their healthy twins.

    Args:
        part: `crossed` and `parted`, [N] bool, of each view.
        view: one of `VIEWS`.

    Returns:
        Counts, the mean change from the twins with its 95 % interval over robots, and `p`, the
        probability that chance alone changes so many robots one way (exact sign test).
    """
    crossed, healthy = (np.array(part[name]["crossed"], bool) for name in (view, "healthy"))
    low, high = metrics.share_interval(crossed)
    lost, won = int((healthy & ~crossed).sum()), int((crossed & ~healthy).sum())
    change = crossed.astype(float) - healthy
    return {
        "robots": len(crossed),
        "crossed": int(crossed.sum()),
        "crossed_rate": float(crossed.mean()),
        "crossed_ci95_low": low,
        "crossed_ci95_high": high,
        "change": float(change.mean()),
        **metrics.with_interval("change", change),
        "p": float(binomtest(lost, lost + won).pvalue) if lost + won else 1.0,
        "parted": int(np.sum(part[view]["parted"])),
    }


def sentence(total: Mapping[str, Mapping[str, Any]], runs: Sequence[Mapping[str, Any]]) -> str:
    """What a study shows, in words; `total` by view and `runs` by ground are of `compare`."""
    views = [view for view in VIEWS if view not in ("healthy", "control")]
    robots, unlike = total["healthy"]["robots"], CHANCE / len(views)

    def parted(view: str) -> list[int]:
        return [total[view]["parted"], robots - total[view]["parted"]]

    tables = {view: [parted(view), parted("control")] for view in views}
    looks = [v for v, table in tables.items() if fisher_exact(table, "greater").pvalue < unlike]
    if not looks:
        return "This policy ignores its camera: its robots walk alike, whatever they are shown."
    costs = {view: total[view] for view in views if total[view]["p"] < unlike}
    if not costs:
        return (
            "This policy looks at its camera, for its robots walk otherwise when they are shown"
            f" {VIEWS[looks[0]]}, but who crosses changes no more than by chance."
        )
    view, worst = min(costs.items(), key=lambda item: item[1]["change"])
    tests = len(views) * len({run["ground"] for run in runs})
    where = [
        run["ground"].partition(":")[0].replace("_", " ")
        for run in runs
        if run["view"] == view and run["p"] < CHANCE / tests
    ]
    alone = f"On {', '.join(where)} alone" if where else "On no ground alone"
    return (
        f"This policy uses its camera: {total['healthy']['crossed']} of {robots} robots cross,"
        f" and {worst['crossed']} when they are shown {VIEWS[view]}"
        f" ({100 * worst['change']:+.0f} points, 95 % over walks of one seed"
        f" {100 * worst['change_ci95_low']:+.0f} to {100 * worst['change_ci95_high']:+.0f})."
        f" {alone} the difference is larger than chance explains."
    )
