"""`renet demo`: a robot's camera dies half a second before a gap, and who remembers it crosses."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from renet.errors import RenetError
from renet.evaluation import figures, metrics
from renet.evaluation.report.page import render, study_sections, write_page
from renet.evaluation.report.summary import gap_headline, noise_headline
from renet.evaluation.rollout import Mode, Trial
from renet.evaluation.studies.one_try import EDGES
from renet.evaluation.study import Figures, Part, Study, Table, WalkingStudy
from renet.evaluation.trace import Trace
from renet.faults import Injection
from renet.files import remove
from renet.interface import CONTROL_DT
from renet.terminal import show
from renet.terrain.tiles import LEVELS, tiles

if TYPE_CHECKING:
    from renet.evaluation.evaluator import Evaluator

GROUND, LEVEL = "gap", 5
"""Kind and level of the tile: a gap of 37 cm."""
DEAD = "unplugged", 5
"""The fault and its severity: no image any more."""
BEFORE = 0.5
"""Seconds before the edge, at the commanded speed, at which cameras die."""
STRIDE, SLOWLY = 2, 2.0
"""Control steps from one picture of the film to the next; half of it for seconds after death."""
SHOWN = 1.0, 4.0
"""Seconds of the film before and after death."""
TITLES = {
    "camera": "trusts its last image",
    "switch": "the paper's switch",
    "oracle": "goes blind at once",
    "memory": "RENet",
}
"""What films and figures call each mode."""


@dataclass(frozen=True)
class DemoStudy(WalkingStudy):
    """Watch robots whose camera dies before a gap; --preset noise: the paper's noise figure."""

    out: Path = Path("renet-demo")
    """Folder for index.html, film.mp4, demo.png, summary.json, summary.csv and parts/."""
    modes: tuple[Mode, ...] = ("camera", "switch", "oracle", "memory")
    """Policy modes to compare; the film shows the first beside the last."""
    seconds: float = 9.0
    """Time to leave the tile."""

    name: ClassVar[str] = "demo"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.seconds <= (dies := self.onset * CONTROL_DT):
            raise RenetError(f"seconds must be above {dies:g}, when cameras die: {self.seconds}")

    @property
    def onset(self) -> int:
        """Control step at which cameras die."""
        return max(round((EDGES[GROUND] / self.speed - BEFORE) / CONTROL_DT), 0)

    @property
    def gap(self) -> float:
        """Width of the gap, m."""
        return tiles()[GROUND].measure((LEVEL - 1) / (LEVELS - 1))

    def run(self, evaluator: Evaluator | None = None) -> dict[str, Any]:
        """As every study; walks again where the film is missing."""
        if not (self.out / "film.mp4").exists():
            self._forget()
        return super().run(evaluator)

    def _forget(self) -> None:
        """Delete kept walks: the film shows the newest one alone."""
        for part in (self.out / "parts").glob(f"{GROUND}-*.json"):
            remove(part)

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """All modes side by side."""
        return {GROUND: partial(self._walk, evaluator)}

    def _walk(self, evaluator: Evaluator) -> Part:
        """Walk, and film the first pair of twins whose left robot alone falls."""
        from renet.evaluation.report.video import film

        dead = (Injection.of(*DEAD, self.onset, self.seconds),)
        each = self.robots_each
        trials = [Trial(mode, dead, robot, GROUND) for mode in self.modes for robot in range(each)]
        robots = [trial.robot for trial in trials]
        env = evaluator.make_env({GROUND: LEVEL}, robots, self.speed, self.seed)
        env.place_on([GROUND] * len(trials))
        steps = round(self.seconds / CONTROL_DT)
        rollout = evaluator.rollout(env, trials, self.seed)
        title = f"{len(trials)} robots"
        trace = rollout.run(steps, title, until_ended=self.onset, film=range(len(trials)))
        crossed, fell, _ = (ends.reshape(-1, each) for ends in trace.first_try())
        pair = int((fell[0] & crossed[-1]).argmax())
        titles = {row * each + pair: TITLES.get(self.modes[row], "") for row in (0, -1)}
        titles = {row % len(trials): title for row, title in titles.items()}
        self._forget()
        film(self.out / "film.mp4", env.scene_spec, trace, titles, "no image", self.pace(trace))
        return {
            "crossed": crossed,
            "fell": fell,
            "pair": pair,
            "remembers": bool((trace.vision & ~trace.has_image).any()),
        }

    def pace(self, trace: Trace) -> list[int]:
        """Control steps of the film's pictures: time slows down from the camera's death on."""
        before, after = (round(seconds / CONTROL_DT) for seconds in SHOWN)
        dead, normal = self.onset, self.onset + round(SLOWLY / CONTROL_DT)
        end = min(dead + after, len(trace.fell))
        slowly = range(dead, min(normal, end), STRIDE // 2)
        return [*range(max(dead - before, 0), dead, STRIDE), *slowly, *range(normal, end, STRIDE)]

    def summarise(self, parts: Mapping[str, Part], evaluator: Evaluator) -> dict[str, Any]:
        """A row for each mode."""
        part = parts[GROUND]
        ends = zip(self.modes, np.array(part["crossed"]), np.array(part["fell"]), strict=True)
        runs = [
            {"mode": mode, "robots": len(crossed), "crossed": int(crossed.sum())}
            | {"fell": int(fell.sum()), "crossed_rate": float(crossed.mean())}
            | metrics.with_share_interval("crossed", crossed)
            for mode, crossed, fell in ends
        ]
        film = {name: part[name] for name in ("pair", "remembers")}
        return {"runs": runs, "gap_m": self.gap, "before_s": BEFORE} | film

    def draw(self, summary: dict[str, Any], parts: Mapping[str, Part]) -> Figures:
        """demo.png: how many cross, a bar for each mode."""
        counts = {run["mode"]: run["crossed"] for run in summary["runs"]}
        title = f"The camera dies {BEFORE} s before a gap of {100 * self.gap:.0f} cm: who crosses"
        return {"demo.png": figures.count_bars(counts, TITLES, self.robots_each, title)}

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Who crossed and who fell."""
        rows = [
            (TITLES.get(run["mode"], run["mode"]), run["crossed"], run["fell"])
            for run in summary["runs"]
        ]
        title = f"{self.robots_each} robots each before a gap of {100 * self.gap:.0f} cm"
        return [(title, ("when the camera dies", "crossed", "fell"), rows)]


def run_demo(study: Study, evaluator: Evaluator | None = None) -> str:
    """Run the demo's or the noise study, put it on one page and return what it comes to."""
    summary = study.run(evaluator)
    for table in study.tables(summary):
        show(*table)
    sentence = {"demo": gap_headline, "noise": noise_headline}[study.name](summary)
    sections = study_sections(study.name, summary, study.out)
    sections.insert(1, render("demo_method"))
    page = write_page(study.out / "index.html", "A robot dog loses its eyes", sentence, sections)
    pictures = sorted(path.name for path in study.out.iterdir() if path.suffix in (".png", ".mp4"))
    print(f"Page: {page}; beside it: {', '.join(pictures)}")
    return sentence
