"""Robots whose camera is unplugged before a gap, which memory crosses: `renet demo`."""

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
from renet.evaluation.results import column
from renet.evaluation.rollout import robot_numbers
from renet.evaluation.settings import StudyMode
from renet.evaluation.studies.grounds import EDGES, onset_before_edge, start_facing
from renet.evaluation.study import Figures, Part, Table, WalkingStudy
from renet.evaluation.trace import Trace
from renet.faults import Injection
from renet.files import read_bytes, remove, write_atomically
from renet.interface import CONTROL_DT, control_steps
from renet.terminal import show
from renet.terrain.tiles import tiles

if TYPE_CHECKING:
    from renet.evaluation.evaluator import Evaluator

_GROUND = "gap"
"""Kind of tile."""
_LEVEL = 8
"""Its level: a gap of 57 cm."""
_UNPLUGGED = ("unplugged", 5)
"""Fault and severity: no image any more."""
_LEAD = 0.5
"""Time before the edge, at the commanded speed, at which cameras are unplugged, s. Robots start up
to 0.3 m nearer or farther."""
_STRIDE = 2
"""Number of control steps from one picture of the film to the next, at normal speed."""
_SLOW_SECONDS = 2.0
"""Time after the fault's onset that the film shows at half speed, s."""
GOAL_MARGIN = 0.5
"""Distance beyond the gap at which a robot has crossed it, m."""
FILM_SPAN = (1.0, 3.2)
"""Longest time that the film shows before and after the fault's onset, s."""
_FILM_REST = 1.0
"""Time for which the film goes on once each of its robots has fallen or crossed, s."""
CONSEQUENCES = {
    "memory": "VP walks on from the ground that it remembers",
    "switch": "OP takes over once the image looks abnormal",
    "camera": "VP goes on with the last image",
    "blind": "nothing changes: OP drives from the start",
    "oracle": "OP takes over at once, told of the fault",
}
"""Behaviour in each mode once the camera is unplugged."""
_MAX_MEDIA_SIZE = 64_000_000
"""Size limit of the page's film and figure, bytes."""


@dataclass(frozen=True)
class DemoStudy(WalkingStudy):
    """Watch robots whose camera is unplugged about half a second before a gap."""

    out: Path = Path("renet-demo")
    """Folder for index.html, film.mp4, demo.png, summary.md, .json and .csv, and parts/."""
    modes: tuple[StudyMode, ...] = ("switch", "camera", "oracle", "memory")
    """Policy modes to compare; the film shows the first beside the last."""
    seconds: float = 9.0
    """Time to leave the tile."""

    name: ClassVar[str] = "demo"

    def __post_init__(self) -> None:
        super().__post_init__()
        onset = self.onset * CONTROL_DT
        if self.seconds <= onset:
            raise RenetError(f"seconds must be above {onset:g}, when cameras fail: {self.seconds}")

    @property
    def onset(self) -> int:
        """Control step at which cameras are unplugged."""
        return control_steps(onset_before_edge(self.speed, _LEAD))

    @property
    def gap(self) -> float:
        """Width of the gap, m."""
        return tiles()[_GROUND].measure_at(_LEVEL)

    def run(self, evaluator: Evaluator | None = None) -> dict[str, Any]:
        """Run the study; the robots walk again if the film is missing."""
        # A part from an earlier run would leave the page without a film.
        if not (self.out / "film.mp4").exists():
            self._forget()
        return super().run(evaluator)

    def _forget(self) -> None:
        """Delete kept parts, for the film shows the newest run only."""
        for part in (self.out / "parts").glob(f"{_GROUND}-*.json"):
            remove(part)

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """Return one part: all modes side by side."""
        return {_GROUND: partial(self._walk_and_film, evaluator)}

    def _walk_and_film(self, evaluator: Evaluator) -> Part:
        """Walk, and film twins of which the first mode's falls and the last mode's crosses."""
        from renet.evaluation.video import film, pictures

        unplugged = (Injection.of(*_UNPLUGGED, self.onset, self.seconds),)
        each = self.robots_each
        trials = self.trials_on((_GROUND,), unplugged)
        # Straight at the gap, as in the success study: obliquely it is wider, and is reached later.
        cfg = evaluator.terrain_env_cfg({_GROUND: _LEVEL})
        start_facing(cfg)
        env = evaluator.make_env(cfg, robot_numbers(trials), self.speed, self.seed)
        title = f"{len(trials)} robots"
        everybody = range(len(trials))
        trace = self.walk(evaluator, env, trials, title, until_ended=self.onset, film=everybody)
        # [modes, robots]
        crossed, fell, _ = trace.first_try()
        crossed = crossed.reshape(-1, each)
        fell = fell.reshape(-1, each)
        pair = int((fell[0] & crossed[-1]).argmax())
        # The first mode beside the last; a single robot if there is one mode.
        places = dict.fromkeys((pair, (len(self.modes) - 1) * each + pair))
        titles = {place: trials[place].mode for place in places}
        self._forget()
        goal = EDGES[_GROUND] + self.gap + GOAL_MARGIN
        path = self.out / "film.mp4"
        steps = self.film_steps(trace.robots(np.array([*places])), goal)
        film(path, pictures(env.scene_spec, trace, titles, _UNPLUGGED[0], steps, goal))
        return {
            "crossed": crossed,
            "fell": fell,
            "pair": pair,
            "remembers": bool((trace.vision & ~trace.has_image).any()),
        }

    def film_steps(self, trace: Trace, goal: float) -> list[int]:
        """Choose the control steps of the film's pictures, at half speed after the fault's onset.

        Args:
            trace: The run of the robots that the film shows.
            goal: Distance from the start at which a robot has crossed, m.
        """
        before = control_steps(FILM_SPAN[0])
        after = control_steps(FILM_SPAN[1])
        onset = self.onset
        normal = onset + control_steps(_SLOW_SECONDS)
        end = min(onset + after, len(trace.fell))
        # Where a robot has no outcome, the film is as long as it may be.
        decided = (trace.over | (trace.travelled >= goal)).all(axis=1)
        if decided.any():
            end = min(end, int(decided.argmax()) + control_steps(_FILM_REST))
        return [
            *range(max(onset - before, 0), onset, _STRIDE),
            *range(onset, min(normal, end), _STRIDE // 2),
            *range(normal, end, _STRIDE),
        ]

    def summarise(self, parts: Mapping[str, Part], evaluator: Evaluator) -> dict[str, Any]:
        """Return a row for each mode."""
        part = parts[_GROUND]
        ends = zip(self.modes, np.array(part["crossed"]), np.array(part["fell"]), strict=True)
        runs = []
        for mode, crossed, fell in ends:
            run = {
                "mode": mode,
                "robots": len(crossed),
                "crossed": int(crossed.sum()),
                "fell": int(fell.sum()),
                **metrics.share_columns("crossed", crossed),
            }
            runs.append(run)
        return {
            "runs": runs,
            "gap_m": self.gap,
            "before_s": _LEAD,
            "pair": part["pair"],
            "remembers": part["remembers"],
        }

    def draw(self, summary: dict[str, Any], parts: Mapping[str, Part]) -> Figures:
        """Draw demo.png: number of robots that cross, a bar for each mode."""
        runs = summary["runs"]
        counts = dict(zip(column(runs, "mode"), column(runs, "crossed"), strict=True))
        title = f"Unplugged {_LEAD} s before a gap of {100 * self.gap:.0f} cm: who crosses"
        return {"demo.png": figures.count_bars(counts, self.robots_each, title)}

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Tabulate the robots that crossed and that fell, a row for each mode."""
        rows = []
        for run in summary["runs"]:
            rows.append((run["mode"], run["crossed"], run["fell"], CONSEQUENCES[run["mode"]]))
        title = f"{self.robots_each} robots each before a gap of {100 * self.gap:.0f} cm"
        return [(title, ("mode", "crossed", "fell", "when the camera is unplugged"), rows)]


def run_demo(study: DemoStudy, evaluator: Evaluator | None = None) -> str:
    """Run the study, write its page and return the page's first sentence."""
    summary = study.run(evaluator)
    # The page is written first: a reader that leaves, such as `head`, ends the printing.
    page = study.out / "index.html"
    write_atomically(page, demo_page(summary, study.out).encode())
    for table in study.tables(summary):
        show(*table)
    print(f"Page: {page}; beside it: demo.png, film.mp4")
    return headline(summary)


def headline(summary: Mapping[str, Any]) -> str:
    """Say in a sentence how many robots cross in each mode."""
    robots = summary["runs"][0]["robots"]
    counts = ", ".join(f"{run['crossed']} in mode {run['mode']}" for run in summary["runs"])
    return (
        f"The camera is unplugged {summary['before_s']} s before a gap of "
        f"{100 * summary['gap_m']:.0f} cm: of {robots} robots each cross {counts}."
    )


def demo_page(summary: Mapping[str, Any], folder: Path) -> str:
    """Write the demo's HTML page, with film and figure inline.

    Args:
        summary: Summary of the study.
        folder: Folder of its film.mp4 and demo.png.
    """
    note = ""
    if not summary["remembers"] and "memory" in summary["settings"]["modes"]:
        note = (
            "<p>This bundle has no memory: where the camera fails, mode memory walks on blind.</p>"
        )
    rows = list(map(_page_row, summary["runs"]))
    provenance = []
    for name, value in summary["provenance"].items():
        term = escape(name.replace("_", " "))
        provenance.append(f"<dt>{term}</dt><dd>{escape(str(value))}</dd>")
    # Everything is inline, so that the page can be sent as one file.
    template = Template(Path(__file__).with_name("demo.html").read_text())
    return template.substitute(
        sentence=escape(headline(summary)),
        film=_data_uri(folder / "film.mp4", "video/mp4"),
        figure=_data_uri(folder / "demo.png", "image/png"),
        before=summary["before_s"],
        pair=summary["pair"] + 1,
        robots=summary["runs"][0]["robots"],
        note=note,
        rows="\n".join(rows),
        provenance="\n".join(provenance),
    )


def _page_row(run: Mapping[str, Any]) -> str:
    """Format a row of the page's table as HTML."""
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
    """Encode a file as a data URI of a media type."""
    content = read_bytes(path, _MAX_MEDIA_SIZE, "picture or film")
    return f"data:{media};base64,{base64.b64encode(content).decode()}"
