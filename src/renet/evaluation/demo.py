"""`renet demo`: a robot's camera dies half a second before a gap, and who remembers it crosses."""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from html import escape
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from renet.errors import RenetError
from renet.evaluation import figures, metrics
from renet.evaluation.rollout import Mode, Trial
from renet.evaluation.studies.one_try import EDGES
from renet.evaluation.study import Figures, Part, Table, WalkingStudy
from renet.evaluation.trace import Trace
from renet.faults import Injection
from renet.files import read_bytes, remove, write_atomically
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
MARGIN = 0.5
"""Distance beyond the gap at which a robot has crossed it, m."""
SHOWN = 1.0, 3.2
"""Seconds of the film before and after death."""
CONSEQUENCES = {
    "memory": "VP walks on from the ground that it remembers",
    "switch": "OP takes over once the image looks abnormal",
    "camera": "VP goes on with the last image",
    "blind": "nothing changes: OP drives from the start",
    "oracle": "OP takes over at once, told of the fault",
}
"""Behaviour in each mode once the camera is dead."""
MAX_MEDIA = 64_000_000
"""Size limit of the page's film and figure, bytes."""


@dataclass(frozen=True)
class DemoStudy(WalkingStudy):
    """Watch robots whose camera dies half a second before a gap."""

    out: Path = Path("renet-demo")
    """Folder for index.html, film.mp4, demo.png, summary.md, .json and .csv, and parts/."""
    modes: tuple[Mode, ...] = ("switch", "camera", "oracle", "memory")
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
        from renet.evaluation.video import film

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
        # The first mode beside the last; one robot where there is one mode.
        places = dict.fromkeys((pair, (len(self.modes) - 1) * each + pair))
        titles = {place: trials[place].mode for place in places}
        self._forget()
        beyond = EDGES[GROUND] + self.gap + MARGIN
        path = self.out / "film.mp4"
        film(path, env.scene_spec, trace, titles, "no image", self.pace(trace), beyond)
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
        """demo.png: number of robots that cross, a bar for each mode."""
        counts = {run["mode"]: run["crossed"] for run in summary["runs"]}
        title = f"The camera dies {BEFORE} s before a gap of {100 * self.gap:.0f} cm: who crosses"
        return {"demo.png": figures.count_bars(counts, self.robots_each, title)}

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Robots that crossed and robots that fell, a row for each mode."""
        rows = [
            (run["mode"], run["crossed"], run["fell"], CONSEQUENCES[run["mode"]])
            for run in summary["runs"]
        ]
        title = f"{self.robots_each} robots each before a gap of {100 * self.gap:.0f} cm"
        return [(title, ("mode", "crossed", "fell", "when the camera dies"), rows)]


def run_demo(study: DemoStudy, evaluator: Evaluator | None = None) -> str:
    """Run the study, write its page and return the page's first sentence."""
    summary = study.run(evaluator)
    for table in study.tables(summary):
        show(*table)
    page = study.out / "index.html"
    write_atomically(page, demo_page(summary, study.out).encode())
    print(f"Page: {page}; beside it: demo.png, film.mp4")
    return headline(summary)


def headline(summary: Mapping[str, Any]) -> str:
    """A sentence that says how many robots cross in each mode."""
    robots = summary["runs"][0]["robots"]
    counts = ", ".join(f"{run['crossed']} in mode {run['mode']}" for run in summary["runs"])
    return (
        f"The camera dies {summary['before_s']} s before a gap of {100 * summary['gap_m']:.0f} cm:"
        f" of {robots} robots each cross {counts}."
    )


def demo_page(summary: Mapping[str, Any], folder: Path) -> str:
    """Self-contained HTML page of the demo: everything inline, no network.

    Args:
        summary: of the study.
        folder: where its film.mp4 and demo.png are.
    """
    note = ""
    if not summary["remembers"] and "memory" in summary["settings"]["modes"]:
        note = (
            "<p>This bundle has no memory: where the camera fails, mode memory walks on blind.</p>"
        )
    template = Template(Path(__file__).with_name("demo.html").read_text())
    return template.substitute(
        sentence=escape(headline(summary)),
        film=_data_uri(folder / "film.mp4", "video/mp4"),
        figure=_data_uri(folder / "demo.png", "image/png"),
        before=summary["before_s"],
        pair=summary["pair"] + 1,
        robots=summary["runs"][0]["robots"],
        note=note,
        rows="\n".join(_page_row(run) for run in summary["runs"]),
        provenance="\n".join(
            f"<dt>{escape(name.replace('_', ' '))}</dt><dd>{escape(str(value))}</dd>"
            for name, value in summary["provenance"].items()
        ),
    )


def _page_row(run: Mapping[str, Any]) -> str:
    """A row of the page's table, HTML."""
    low = 100 * run["crossed_ci95_low"]
    high = 100 * run["crossed_ci95_high"]
    cells = (
        run["mode"],
        f"{run['crossed']} of {run['robots']}",
        f"{low:.0f} to {high:.0f} %",
        run["fell"],
        CONSEQUENCES[run["mode"]],
    )
    return "<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>"


def _data_uri(path: Path, media: str) -> str:
    """A file as a data URI of a media type."""
    content = read_bytes(path, MAX_MEDIA, "picture or film")
    return f"data:{media};base64,{base64.b64encode(content).decode()}"
