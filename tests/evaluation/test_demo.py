import json
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest

from renet.evaluation import demo
from renet.evaluation.demo import DemoCfg, first_to_fall, run_demo, worst_of_vp
from renet.evaluation.report import video

from .fakes import FakeEvaluator
from .tiny import TINY

STUDY = TINY["noise"][0]


class Links(HTMLParser):
    """Collects what a page would load."""

    def __init__(self) -> None:
        super().__init__()
        self.links: list[str] = []
        self.open: list[str] = []

    def handle_starttag(self, tag, attrs) -> None:
        links = [value for name, value in attrs if name in ("src", "href")]
        self.links += [link for link in links if not link.startswith("#")]
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag) -> None:
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def page(run_study, tmp_path_factory: pytest.TempPathFactory) -> Path:
    patch, out = pytest.MonkeyPatch(), tmp_path_factory.mktemp("demo")
    # What the study's own tests have run is not run again.
    shutil.copytree(run_study("noise")[0] / "parts", out / "parts")
    patch.setattr(demo, "NoiseStudy", lambda **settings: replace(STUDY, **settings))
    patch.setattr(video, "PANEL", (96, 72))
    try:
        return run_demo(DemoCfg(out=out), FakeEvaluator())
    finally:
        patch.undo()


def test_the_page_needs_no_network(page: Path) -> None:
    html = page.read_text()
    page_links = Links()
    page_links.feed(html)
    assert not page_links.open
    assert len(page_links.links) == 3
    assert all(link.startswith("data:") for link in page_links.links)
    assert "http" not in re.sub(r"base64,[A-Za-z0-9+/=]+", "", html)
    assert all(text in html for text in ("prefers-color-scheme: dark", "width=device-width"))


def test_the_page_says_what_was_measured(page: Path) -> None:
    html = page.read_text()
    assert all(text in html for text in ("12 of 12", "0 with RENet", "SP 70 %"))


def test_the_folder_holds_everything(page: Path) -> None:
    names = "index.html summary.json summary.csv noise.png timeline.png video.mp4 parts"
    assert {path.name for path in page.parent.iterdir()} == set(names.split())
    assert (page.parent / "video.mp4").read_bytes()[4:8] == b"ftyp"


def test_the_film_shows_the_setting_vp_suffers_most_in(page: Path) -> None:
    evaluator = FakeEvaluator()
    trials = STUDY.trials([worst_of_vp(json.loads((page.parent / "summary.json").read_text()))])
    env = STUDY.make_env(evaluator, tuple(trial.robot for trial in trials))
    trace = evaluator.rollout(env, trials, STUDY.seed).run(STUDY.steps)
    assert trace.fallen[-1, :2].all()
    assert first_to_fall(STUDY, trace) in (0, 1)
    assert (page.parent / "video.mp4").stat().st_size > 1000
