"""The camera-use study: whether a policy looks at its camera, on which ground, and what it gains.

Twins differ in nothing but the images they are shown. If the camera does not matter, they walk the
same way to the millimetre. The policy may be anybody's (docs/evaluation.md, Your own policy).
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import binomtest, fisher_exact

from renet.errors import RenetError
from renet.evaluation import metrics
from renet.evaluation.rollout import EvalEnv, Mode, Trial, check_grounds, check_modes, check_speed
from renet.evaluation.study import Figures, Part, Study, Table
from renet.evaluation.trace import StepResult
from renet.faults import ViewPerturbation
from renet.interface import CONTROL_DT

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
COLOURS = ("#000000", "#8a919c", "#0072b2", "#56b4e9", "#e69f00", "#009e73")
PARTED = 0.01
"""m by which the ways of twins differ at least once if the images mattered."""
CHANCE = 0.01
"""Probability below which a difference is not called chance; divided by the number of tests."""


class ShownImages:
    """An environment whose robots are shown other images than their cameras take; see `VIEWS`."""

    def __init__(self, env: EvalEnv, views: Sequence[str], each: int) -> None:
        """Wrap an environment.

        Args:
            env: its rows are groups of `each` robots; the first of `len(VIEWS)` groups is healthy.
            views: of each row, [N].
            each: robots in a group.
        """
        self.num_robots, self._env, self._views = env.num_robots, env, np.array(views)
        row = np.arange(self.num_robots)
        healthy = row - row % (each * len(VIEWS))
        self._other = healthy + (row + 1) % each
        """The healthy row of the next robot on the same ground, [N]."""

    def reset(self) -> StepResult:
        """Put every robot at its start; its image there is what a frozen camera shows."""
        result = self._env.reset()
        self._first = result.depth.copy()
        return self._show(result)

    def step(self, action: np.ndarray) -> StepResult:
        """Act [N, 12] for one control step."""
        return self._show(self._env.step(action))

    def poses(self, rows: Sequence[int]) -> np.ndarray:
        """Generalised positions [len(rows), nq], for pictures."""
        return self._env.poses(rows)

    def perturb_cameras(self, view: ViewPerturbation) -> None:
        """Let the cameras see the scene so from their next image on."""
        self._env.perturb_cameras(view)

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
class CameraUseStudy(Study):
    """Whether a policy uses its camera: twins that are shown wrong images, on six grounds."""

    out: Path = Path("results/camera_use")
    """Folder for summary.json, summary.csv, camera_use.png and parts/."""
    grounds: tuple[str, ...] = (
        "flat:1",
        "obstacles:6",
        "stairs_up:5",
        "stairs_down:6",
        "platform:4",
        "gap:3",
    )
    """Ground and level, KIND:LEVEL, as in the memory study, or flat:1."""
    mode: Mode = "vp"
    """How RENet's own policies walk: vp looks always, op never; others' ignore it."""
    robots: int = 20
    """Robots on each ground; with `quick` 8."""
    speed: float = 0.6
    """Commanded forward speed, m/s."""
    seconds: float = 10.0
    """Time to leave the tile."""

    name: ClassVar[str] = "camera_use"
    selectable: ClassVar[tuple[str, ...]] = ("grounds",)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_modes((self.mode,))
        check_speed(self.speed)
        if self.robots < 2 or self.seconds < 1 or not self.grounds:
            raise RenetError("give a ground, at least 2 robots and at least 1 second")
        for ground in self.grounds:
            kind, _, level = ground.partition(":")
            if not level.isdecimal():
                raise RenetError(f"ground {ground!r}: write KIND:LEVEL, such as gap:3")
            check_grounds({kind: int(level)})

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """All views on one ground, side by side."""
        return {
            ground.replace(":", "_"): partial(self._walk, evaluator, ground)
            for ground in self.grounds
        }

    def _walk(self, evaluator: Evaluator, ground: str) -> Part:
        kind, _, level = ground.partition(":")
        each = min(self.robots, 8) if self.quick else self.robots
        rows = [(view, robot) for view in VIEWS for robot in range(each)]
        trials = [Trial(self.mode, (), robot, kind) for _, robot in rows]
        task, robots = {kind: int(level)}, [robot for _, robot in rows]
        env = evaluator.make_env(task, robots, self.speed, self.seed)
        env.place_on([kind] * len(rows))
        shown = ShownImages(env, [view for view, _ in rows], each)
        title = f"{self.grounds.index(ground) + 1}/{len(self.grounds)} {ground}"
        steps = round(self.seconds / CONTROL_DT)
        trace = evaluator.rollout(shown, trials, self.seed).run(steps, title, until_ended=1)
        groups = dict(zip(VIEWS, trace.groups(each), strict=True))
        healthy = groups["healthy"]
        part: Part = {}
        for view, group in groups.items():
            both = ~(healthy.over | group.over)
            apart = np.abs(group.travelled - healthy.travelled) * both
            crossed, *_ = group.first_try()
            part[view] = {"crossed": crossed, "parted": apart.max(axis=0) > PARTED}
        return part

    def summarise(self, parts: Mapping[str, Part], evaluator: Evaluator) -> dict[str, Any]:
        """One row for each ground and view, the totals over all grounds, and the sentence."""
        grounds = {ground: parts[ground.replace(":", "_")] for ground in self.grounds}
        runs = [
            {"ground": ground, "view": view, "seed": self.seed} | compare(part, view)
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
        """camera_use.png: who crosses each ground, by what it is shown."""
        figure, axis = plt.subplots(figsize=(1.3 * len(self.grounds) + 2, 3.6))
        for number, (view, colour) in enumerate(zip(VIEWS, COLOURS, strict=True)):
            runs = [run for run in summary["runs"] if run["view"] == view]
            share, low, high = (
                np.array([100 * run[name] for run in runs])
                for name in ("crossed_rate", "crossed_ci95_low", "crossed_ci95_high")
            )
            place = np.arange(len(runs)) + 0.11 * (number - (len(VIEWS) - 1) / 2)
            error = np.abs([low - share, high - share])
            axis.errorbar(place, share, error, fmt="o", color=colour, label=VIEWS[view])
        axis.set_xticks(range(len(self.grounds)), [g.replace("_", " ") for g in self.grounds])
        axis.set(ylabel="robots that cross (%)", ylim=(-4, 104))
        figure.legend(loc="outside upper center", ncols=3)
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
    low, high = metrics.wilson_interval(crossed)
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
    """What a study shows, in words.

    Args:
        total: `compare` over all grounds, by view.
        runs: `compare` with its ground and view, by ground.
    """
    views = [view for view in VIEWS if view not in ("healthy", "control")]
    robots, control = total["healthy"]["robots"], total["control"]["parted"]
    looks = [
        view
        for view in views
        if _more(total[view]["parted"], control, robots) < CHANCE / len(views)
    ]
    if not looks:
        return "This policy ignores its camera: its robots walk alike, whatever they are shown."
    costs = {view: total[view] for view in views if total[view]["p"] < CHANCE / len(views)}
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
    return (
        f"This policy uses its camera: {total['healthy']['crossed']} of {robots} robots cross,"
        f" and {worst['crossed']} when they are shown {VIEWS[view]}"
        f" ({100 * worst['change']:+.0f} points, 95 % over robots of one seed"
        f" {100 * worst['change_ci95_low']:+.0f} to {100 * worst['change_ci95_high']:+.0f});"
        f" beyond chance on {', '.join(where) or 'no single ground'}."
    )


def _more(count: int, control: int, robots: int) -> float:
    """Fisher's one-sided probability of so many more robots than in the control."""
    table = [[count, robots - count], [control, robots - control]]
    return float(fisher_exact(table, alternative="greater").pvalue)
