"""The camera-use study: a policy's use of its camera, by ground, and the gain from it.

Twins differ only in the images they are shown. If the camera does not matter, they walk the same
way to the centimetre. The policy may be of another project (docs/measure.md, Your own policy).
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from matplotlib.font_manager import FontProperties
from scipy.stats import binomtest, fisher_exact

from renet.errors import RenetError
from renet.evaluation import figures, metrics
from renet.evaluation.results import column, group_by, select
from renet.evaluation.rollout import EvalEnv, Trial, robot_numbers
from renet.evaluation.settings import FLAT_GROUND, StudyMode
from renet.evaluation.studies.grounds import LevelStudy
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
"""Images that each group of twins is shown. The control measures the effect of rounding alone."""
_PARTED = 0.01
"""Difference between the ways of twins at any step from which on the images mattered, m."""
_SIGNIFICANCE = 0.01
"""Probability below which a difference is significant; divided by the number of tests."""


class ShownImages:
    """Environment that shows robots other images than their cameras take; see `VIEWS`."""

    def __init__(self, env: EvalEnv, views: Sequence[str], each: int) -> None:
        """Wrap an environment.

        Args:
            env: Environment of N robots: for each ground, groups of `each` robots in the order of
                `VIEWS`.
            views: View of each robot, [N].
            each: Number of robots of a view.
        """
        self._env = env
        self._views = np.array(views)
        row = np.arange(len(views))
        # First row of the ground, where the healthy group is.
        healthy = row - row % (each * len(VIEWS))
        self._other = healthy + (row + 1) % each
        """The healthy row of the next robot on the same ground, [N]."""

    def __getattr__(self, name: str) -> Any:
        return getattr(self._env, name)

    def reset(self) -> StepResult:
        """Put every robot at its start, whose image a frozen camera shows."""
        result = self._env.reset()
        self._first = result.depth.copy()
        return self._show(result)

    def step(self, action: np.ndarray) -> StepResult:
        """Act [N, 12] for one control step."""
        return self._show(self._env.step(action))

    def _show(self, result: StepResult) -> StepResult:
        """Replace the images of all views but the healthy ones."""
        depth = result.depth
        shown = depth.copy()
        images_by_view = {
            "blank": np.zeros_like(depth),
            "frozen": self._first,
            "mirrored": depth[..., ::-1],
            "foreign": depth[self._other],
        }
        for view, images in images_by_view.items():
            rows = self._views == view
            shown[rows] = images[rows]
        return replace(result, depth=shown)


@dataclass(frozen=True)
class CameraUseStudy(LevelStudy):
    """Test a policy's use of its camera: twins that are shown wrong images, on six grounds."""

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
    modes: tuple[StudyMode, ...] = ("camera",)
    """One mode of renet's own policies, such as camera or blind; other policies ignore it."""
    seconds: float = 10.0
    """Time to leave the tile, s."""

    name: ClassVar[str] = "camera_use"
    kinds: ClassVar[tuple[str, ...]] = (FLAT_GROUND, *tiles())
    quick_robots: ClassVar[int] = 8

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.robots < 2 or len(self.modes) > 1:
            raise RenetError("give at least 2 robots, and one mode")

    def walk_on(self, evaluator: Evaluator, kind: str, level: int, title: str) -> Part:
        """Walk with all views on one ground, side by side."""
        each = self.robots_each
        views = np.repeat(list(VIEWS), each).tolist()
        trials = [Trial(self.modes[0], (), row % each, kind) for row in range(len(views))]
        env = evaluator.make_env({kind: level}, robot_numbers(trials), self.speed, self.seed)
        # Robots are not retired: others are shown their images.
        shown = ShownImages(env, views, each)
        trace = self.walk(evaluator, shown, trials, title, until_ended=1)
        groups = dict(zip(VIEWS, trace.groups(each), strict=True))
        healthy = groups["healthy"]
        part: Part = {}
        for view, group in groups.items():
            # Compare twins as long as both are in their first try.
            apart = np.abs(group.travelled - healthy.travelled) * ~(healthy.over | group.over)
            crossed, *_ = group.first_try()
            part[view] = {"crossed": crossed, "parted": apart.max(axis=0) > _PARTED}
        return part

    def summarise(self, parts: Mapping[str, Part], evaluator: Evaluator) -> dict[str, Any]:
        """Return a row for each ground and view, the totals over all grounds, and the sentence."""
        grounds = self.by_ground(parts)
        runs = []
        for ground, part in grounds.items():
            for view in VIEWS:
                run = {"ground": ground, "view": view, "mode": self.modes[0], "seed": self.seed}
                runs.append(run | compare_with_twins(part, view))
        # The robots of all grounds together.
        all_grounds = {}
        for view in VIEWS:
            rows = column(list(grounds.values()), view)
            crossed = np.concatenate(column(rows, "crossed"))
            parted = np.concatenate(column(rows, "parted"))
            all_grounds[view] = {"crossed": crossed, "parted": parted}
        total = {view: compare_with_twins(all_grounds, view) for view in VIEWS}
        return {"runs": runs, "total": total, "sentence": sentence(total, runs)}

    def draw(self, summary: dict[str, Any], parts: Mapping[str, Part]) -> Figures:
        """Draw camera_use.png: shares that cross, by view, with a panel for each ground."""
        panels = {}
        for (ground,), runs in group_by(summary["runs"], "ground").items():
            panels[ground.replace("_", " ")] = runs
        figure = figures.share_panels(panels, "crossed", itemgetter("view"), rotation=90)
        # The sentence and the names of the views need room.
        figure.set_figheight(figure.get_figheight() + 1.4)
        # matplotlib would draw a title of the figure over the legend.
        (legend,) = figure.legends
        legend.set_title(textwrap.fill(summary["sentence"], 72), prop=FontProperties(size=9))
        return {"camera_use.png": figure}

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Tabulate robots that cross each ground, and that leave their twins' way, by view."""
        crossed = {(run["ground"], run["view"]): run["crossed"] for run in summary["runs"]}
        rows: list[tuple[Any, ...]] = []
        for ground in self.grounds:
            rows.append((ground, *[crossed[ground, view] for view in VIEWS]))
        rows.append(("walk otherwise", *[summary["total"][view]["parted"] for view in VIEWS]))
        robots = summary["runs"][0]["robots"]
        return [(summary["sentence"], (f"of {robots} cross", *VIEWS), rows)]


def compare_with_twins(part: Mapping[str, Mapping[str, Any]], view: str) -> dict[str, Any]:
    """Compare the robots of a view with their healthy twins.

    Args:
        part: `crossed` and `parted`, [N] bool, of each view.
        view: One of `VIEWS`.

    Returns:
        Counts, the mean change from the twins with its 95 % interval over robots, and `p`, the
        probability that chance alone changes so many robots one way (exact sign test).
    """
    crossed = np.array(part[view]["crossed"], bool)
    healthy = np.array(part["healthy"]["crossed"], bool)
    lost = int((healthy & ~crossed).sum())
    won = int((crossed & ~healthy).sum())
    change = crossed.astype(float) - healthy
    return {
        "robots": len(crossed),
        "crossed": int(crossed.sum()),
        **metrics.share_columns("crossed", crossed),
        **metrics.mean_columns("change", change),
        "p": float(binomtest(lost, lost + won).pvalue) if lost + won else 1.0,
        "parted": int(np.sum(part[view]["parted"])),
    }


def sentence(total: Mapping[str, Mapping[str, Any]], runs: Sequence[Mapping[str, Any]]) -> str:
    """Say the result of a study in a sentence.

    Args:
        total: Comparison of each view over all grounds, see `compare_with_twins`.
        runs: The same for each ground and view.
    """
    views = [view for view in VIEWS if view not in ("healthy", "control")]
    # Bonferroni's correction for the number of views.
    limit = _SIGNIFICANCE / len(views)
    different = _views_that_part(total, views, limit)
    if not different:
        return "This policy ignores its camera: its robots walk alike, whatever they are shown."
    costs = {view: total[view] for view in views if total[view]["p"] < limit}
    if not costs:
        return (
            "This policy looks at its camera, for its robots walk otherwise when they are shown"
            f" {VIEWS[different[0]]}, but who crosses changes no more than by chance."
        )
    view, worst = min(costs.items(), key=lambda item: item[1]["change"])
    alone = _grounds_beyond_chance(runs, view, len(views))
    robots = total["healthy"]["robots"]
    return (
        f"This policy uses its camera: {total['healthy']['crossed']} of {robots} robots cross,"
        f" and {worst['crossed']} when they are shown {VIEWS[view]}"
        f" ({100 * worst['change']:+.0f} points, 95 % over walks of one seed"
        f" {100 * worst['change_ci95_low']:+.0f} to {100 * worst['change_ci95_high']:+.0f})."
        f" {alone} the difference is larger than chance explains."
    )


def _views_that_part(
    total: Mapping[str, Mapping[str, Any]], views: Sequence[str], limit: float
) -> list[str]:
    """List views whose robots leave their twins' way significantly more than the control's."""
    robots = total["healthy"]["robots"]
    control = total["control"]["parted"]
    different = []
    for view in views:
        parted = total[view]["parted"]
        table = [[parted, robots - parted], [control, robots - control]]
        if fisher_exact(table, "greater").pvalue < limit:
            different.append(view)
    return different


def _grounds_beyond_chance(runs: Sequence[Mapping[str, Any]], view: str, num_views: int) -> str:
    """Name the grounds on which a view alone changes crossings significantly."""
    limit = _SIGNIFICANCE / (num_views * len(set(column(runs, "ground"))))
    grounds = []
    for run in select(runs, view=view):
        if run["p"] < limit:
            grounds.append(run["ground"].partition(":")[0].replace("_", " "))
    return f"On {', '.join(grounds)} alone" if grounds else "On no ground alone"
