"""The demo, with stand-ins: VP falls on an image that does not change, OP at the gap."""

import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

from renet.evaluation import demo, painter, video
from renet.evaluation.demo import DemoStudy, demo_page, headline, run_demo
from renet.evaluation.results import read_results
from renet.evaluation.trace import Trace
from renet.selector import SelectorSpec, make_selector

from .fakes import FakeEnv, FakeEvaluator, FakePolicy


class Gap(FakeEnv):
    """Whoever is upright after 3 s has crossed; no image is like the one before."""

    def result(self, speed, fell):
        result = super().result(speed, fell)
        result.ended[:] |= self.clock == 150
        result.depth[:, ::2] = 0.53 + self.clock / 2000
        return result


class Remembering(FakePolicy):
    """VP falls where an image that the gate lets through is the last one again, OP always."""

    def __init__(self, num_robots: int) -> None:
        super().__init__(num_robots)
        self.has_image, self.fresh = np.ones((2, num_robots), bool)
        self.height_map = np.zeros((num_robots, 132), np.float32)
        self.last, self.clock = np.zeros((num_robots, 1, 1)), 0

    def step(self, proprioception, depth, op_mask, gate=None):
        action = super().step(proprioception, depth, op_mask)
        if self.clock % 5 == 0:
            if gate is not None:
                self.has_image = gate.judge({"anomaly_score": self.anomaly_score})
            repeated = (depth == self.last).all(axis=(1, 2))
            self.fresh, self.last = ~(repeated & self.has_image), depth
        self.clock += 1
        action[:, 0] = np.where(op_mask | ~self.fresh, 1.0, 0.0)
        return action


class GapEvaluator(FakeEvaluator):
    """With every monitor that needs no model."""

    def __init__(self, longest_memory: float) -> None:
        super().__init__(Gap, Remembering)
        limits = {"frame_age": 0.2, "uniformity": -0.005}
        self.spec = SelectorSpec(self.beta, thresholds=limits, longest_memory=longest_memory)

    def make_selector(self, kind: str, num_robots: int):
        return make_selector(kind, self.spec, num_robots)


class Links(HTMLParser):
    """Collects what a page loads when it opens, and what a reader may click on."""

    def __init__(self) -> None:
        super().__init__()
        self.loaded, self.clicked, self.open = [], [], []

    def handle_starttag(self, tag, attrs) -> None:
        links = [value for name, value in attrs if name in ("src", "href", "data", "poster")]
        if tag == "a":
            self.clicked += links
        else:
            self.loaded += links
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag) -> None:
        assert self.open.pop() == tag


def check_page(path, media: int) -> str:
    html = path.read_text()
    links = Links()
    links.feed(html)
    assert not links.open
    assert len(links.loaded) == media
    assert all(link.startswith("data:") for link in links.loaded)
    text = re.sub(r"base64,[A-Za-z0-9+/=]+", "", html)
    assert text.count("http") == sum(link.startswith("https:") for link in links.clicked)
    assert all(words in html for words in ("prefers-color-scheme: dark", "width=device-width"))
    return text


def test_the_page_says_what_was_measured_and_needs_no_network(tmp_path, monkeypatch):
    monkeypatch.setattr(painter, "PANEL", (120, 90))
    monkeypatch.setattr(demo, "FILM_SPAN", (0.2, 0.6))
    sentence = run_demo(DemoStudy(tmp_path, robots=3, seconds=3.4), GapEvaluator(9.0))
    assert sentence == (
        "The camera is unplugged 0.5 s before a gap of 57 cm: of 3 robots each cross 0 in mode"
        " switch, 0 in mode camera, 0 in mode oracle, 3 in mode memory."
    )
    names = "index.html summary.md summary.json summary.csv demo.png film.mp4 parts"
    assert {path.name for path in tmp_path.iterdir()} == set(names.split())
    assert (tmp_path / "film.mp4").read_bytes()[4:8] == b"ftyp"
    text = check_page(tmp_path / "index.html", media=2)
    assert text.count("0 of 3") == 3
    assert "$" not in text
    assert all(words in text for words in ("3 of 3", "number 1 of 3"))
    assert "no memory" not in text


def test_the_film_says_who_fell_and_who_crossed(tmp_path, monkeypatch):
    written = set()

    def write(image, outcome, colour):
        written.add(outcome)

    monkeypatch.setattr(painter, "PANEL", (120, 90))
    monkeypatch.setattr(video, "_write_outcome", write)
    monkeypatch.setattr(demo, "GOAL_MARGIN", -0.5)
    monkeypatch.setattr(demo, "FILM_SPAN", (0.2, 1.2))
    run_demo(DemoStudy(tmp_path, robots=1, seconds=3.4), GapEvaluator(9.0))
    assert written == {"fell", "crossed"}


def test_an_outcome_takes_the_place_of_the_state():
    image = Image.new("RGB", (400, 300))
    video._write_outcome(image, "crossed", video.DARK_GREEN)
    assert image.getpixel((310, 2)) == video.DARK_GREEN
    assert image.getpixel((100, 2)) == (0, 0, 0)


def test_a_fallen_robots_picture_is_dim_and_its_bars_are_not():
    image = Image.new("RGB", (400, 300), (200, 200, 200))
    video._dim(image)
    pixels = np.asarray(image)
    assert (pixels[:30] == 200).all()
    assert (pixels[-30:] == 200).all()
    assert (pixels[30:-30] < 100).all()


def test_a_bundle_without_memory_runs_and_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(video, "film", lambda path, *args: path.write_bytes(b"\0\0\0\0ftyp"))
    study = DemoStudy(tmp_path, robots=2, seconds=3.4, modes=("camera", "memory"))
    sentence = run_demo(study, GapEvaluator(0.0))
    assert sentence.endswith("of 2 robots each cross 0 in mode camera, 0 in mode memory.")
    assert "This bundle has no memory" in (tmp_path / "index.html").read_text()
    assert [run["fell"] for run in read_results(tmp_path / "summary.json")["runs"]] == [2, 2]


def test_a_reader_that_leaves_early_does_not_cost_the_page(tmp_path, monkeypatch):
    def leave(*table):
        raise BrokenPipeError

    monkeypatch.setattr(video, "film", lambda path, *args: path.write_bytes(b"\0\0\0\0ftyp"))
    monkeypatch.setattr(demo, "show", leave)
    with pytest.raises(BrokenPipeError):
        run_demo(DemoStudy(tmp_path, robots=1, seconds=3.4), GapEvaluator(9.0))
    check_page(tmp_path / "index.html", media=2)


def test_the_film_is_slow_after_the_cameras_death_and_ends_with_the_run(monkeypatch):
    monkeypatch.setattr(demo, "FILM_SPAN", (1.0, 4.0))
    study, end = DemoStudy(speed=0.6), 160
    steps = study.film_steps(Trace.empty(end, 1), goal=2.0)
    assert study.onset == 75
    assert [*steps[:3], *steps[25:27], steps[-1]] == [25, 27, 29, 75, 76, end - 1]


def test_the_film_ends_one_second_after_its_last_robot_fell_or_crossed():
    trace = Trace.empty(300, 2)
    trace.fell[90, 0] = trace.ended[90, 0] = True
    undecided = DemoStudy(speed=0.6).film_steps(trace, goal=2.0)
    assert undecided[-1] > 220
    trace.travelled[110:, 1] = 2.0
    steps = DemoStudy(speed=0.6).film_steps(trace, goal=2.0)
    assert steps[-1] == 110 + 49
    assert steps == [step for step in undecided if step < 160]


def test_the_film_is_of_the_walk_that_is_told(tmp_path, monkeypatch):
    films = []
    monkeypatch.setattr(video, "film", lambda path, *args: films.append(path.write_bytes(b"")))
    study = DemoStudy(tmp_path, robots=2, seconds=3.4)
    for seed in (1, 2, 1, 1):
        replace(study, seed=seed).run(GapEvaluator(0.0))
    assert len(films) == 3, "the last walk's film lay there already"
    (tmp_path / "film.mp4").unlink()
    study.run(GapEvaluator(0.0))
    assert len(films) == 4


def test_only_modes_that_walked_are_in_the_headline():
    run = {"mode": "camera", "robots": 3, "crossed": 2}
    summary = {"before_s": 0.5, "gap_m": 0.37, "runs": [run]}
    assert headline(summary).endswith("of 3 robots each cross 2 in mode camera.")


def test_what_a_file_holds_is_no_markup_on_the_page(tmp_path):
    for name in ("film.mp4", "demo.png"):
        (tmp_path / name).write_bytes(b"x")
    run = {"mode": "memory", "robots": 1, "crossed": 1, "fell": 0}
    run |= {"crossed_ci95_low": 0.0, "crossed_ci95_high": 1.0}
    summary = {"before_s": 0.5, "gap_m": 0.37, "pair": 0, "remembers": True, "runs": [run]}
    origin = {"command": "<script>alert(1)</script>"}
    page = demo_page(summary | {"settings": {"modes": ["memory"]}, "provenance": origin}, tmp_path)
    assert "&lt;script&gt;" in page
    assert "<script" not in page
