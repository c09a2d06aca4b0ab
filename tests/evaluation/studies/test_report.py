import json
import os
import re
import shutil
from pathlib import Path

import pytest

from renet.errors import RenetError
from renet.evaluation.report.summary import FACTS, WORSE, worse_section
from renet.evaluation.studies.report import STUDIES, ReportCfg, make_report, run_studies
from renet.evaluation.study import Study
from tests.browser import compare, open_browser, watch

from ..tiny import TINY


@pytest.fixture(scope="module")
def results(run_study) -> Path:
    folders = [run_study(name)[0] for name in TINY]
    return folders[0].parent


@pytest.fixture(scope="module")
def page(results: Path, tmp_path_factory) -> Path:
    return make_report(ReportCfg(results, tmp_path_factory.mktemp("page") / "new" / "page.html"))


@pytest.fixture
def standing(results: Path, tmp_path: Path) -> Path:
    """The summary of one study, alone in a folder of results."""
    return Path(shutil.copytree(results / "standing", tmp_path / "standing")) / "summary.json"


def test_the_report_holds_every_study_and_needs_no_network(page):
    html = re.sub(r"base64,[A-Za-z0-9+/=]+", "", page.read_text()).replace("&#39;", "'")
    headings = """Where RENet does worse,Noise in the camera,Every way a depth camera fails
Camera use,One try at each obstacle,Parkour,Standing on command,How far from the simulator"""
    assert all(f">{heading}" in html for heading in re.split("[,\n]", headings))
    assert ("http" in html, "∞ s" in html) == (False, True)
    assert (html.count("bundle hash"), html.count("<img")) == (len(STUDIES), 10)


def test_one_study_alone_makes_a_page_and_text_is_escaped(standing, tmp_path):
    content = json.loads(standing.read_text())
    content["provenance"]["command"] = "<script>alert(1)</script>"
    standing.write_text(json.dumps(content))
    page = make_report(ReportCfg(tmp_path))
    assert page == tmp_path / "index.html"
    html = page.read_text()
    assert not re.search("Parkour|<script", html)
    assert all(text in html for text in ("none of what was run", "&lt;script&gt;"))


def test_results_of_different_bundles_are_pointed_out(page, results, standing, tmp_path):
    assert "Careful" not in page.read_text()
    shutil.copytree(results / "noise", tmp_path / "noise")
    standing.write_text(standing.read_text().replace("0" * 64, "f" * 64))
    html = " ".join(make_report(ReportCfg(tmp_path)).read_text().split())
    assert "2 different bundles, 0000000000, ffffffffff" in html


def test_what_is_worse_than_op_alone_is_listed():
    glare = {"fault": "glare", "severity": 5, "ground": "gap", "memory": 0.5, "blind": 1.0}
    frozen = {"fault": "frozen", "severity": 3, "ground": "stairs_up", "undetected": 2}
    frozen |= {"vp_falls": 4, "vp_spared": 1, "beyond_chance": False}
    faults = {"harmful": [glare | {"beyond_chance": True}], "missed": [frozen]}
    assert WORSE["faults"](faults) == [("faults", "glare 5 on gap", "50 %", "100 %")]
    html = " ".join(worse_section({"faults": faults}).html.split())
    above, folded = html.split("1 within chance")
    assert "glare 5 on gap" in above
    assert "frozen 3 on stairs up goes unnoticed; 4 fall with VP only then, 1 only" in folded
    worse = [{"kind": "gap", "size_m": 0.1, "memory": 0.2, "blind": 0.3}]
    assert WORSE["success"]({"worse": worse}) == [("obstacles", "gap 10 cm", "20 %", "30 %")]


def test_what_was_not_measured_is_no_large_number():
    calm = {"false_switches": 0, "false_switches_per_hour": None}
    blind = {"mode": "blind", "robots": 2, "falls": 1, "vision_active_at_onset": 2, "detected": 0}
    faults = {"runs": [blind], "healthy": calm}
    assert FACTS["noise"]({"runs": [blind], "healthy": calm}) == []
    assert FACTS["faults"](faults) == []
    off = blind | {"mode": "memory", "vision_active_at_onset": 0, "falls": 0}
    seen = blind | {"mode": "memory", "vision_active_at_onset": 1, "detected": 1, "falls": 0}
    assert [v for v, _ in FACTS["faults"](faults | {"runs": [off]})] == ["100 %"]
    assert [v for v, _ in FACTS["faults"](faults | {"runs": [off, seen]})] == ["100 %", "100 %"]


def test_no_results_are_reported(tmp_path):
    with pytest.raises(RenetError, match="no results in"):
        make_report(ReportCfg(tmp_path, tmp_path / "page.html"))
    assert not (tmp_path / "page.html").exists()


@pytest.mark.parametrize(
    "damaged",
    [
        lambda summary: "[" * 100_000,
        lambda summary: '{"half',
        lambda summary: "[1, 2]",
        lambda summary: '{"runs": [], "provenance": {"bundle_hash": "b"}}',
        lambda summary: '{"runs": "text"}',
        lambda summary: json.dumps(summary | {"runs": [[1]]}),
        lambda summary: json.dumps(summary | {"runs": [summary["runs"][0] | {"still": "many"}]}),
    ],
    ids=["deep", "half", "list", "incomplete", "text for rows", "list for row", "text for number"],
)
def test_damaged_results_end_in_one_line(standing, tmp_path, damaged):
    standing.write_text(damaged(json.loads(standing.read_text())))
    with pytest.raises(RenetError, match="standing") as caught:
        make_report(ReportCfg(tmp_path, tmp_path / "page.html"))
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "page.html").exists()


@pytest.mark.parametrize("spoil", ["link", "pipe", "text", "folder", "summary"])
def test_only_pictures_of_the_folder_itself_are_shown(results, tmp_path, spoil):
    """A stranger's folder of results must not put this computer's files on the page."""
    folder, picture = tmp_path / "r" / "terrain", tmp_path / "r" / "terrain" / "terrain.png"
    shutil.copytree(results / "terrain", folder)
    linked = {"folder": folder, "summary": folder / "summary.json"}.get(spoil, picture)
    linked.rename(tmp_path / "elsewhere")
    if spoil == "pipe":
        os.mkfifo(picture)
    elif spoil == "text":
        picture.write_text("root:x:0:0")
    else:
        linked.symlink_to(tmp_path / "elsewhere")
    messages = {"pipe": "not a regular file", "text": "is no PNG file"}
    with pytest.raises(RenetError, match=messages.get(spoil, "is a link")):
        make_report(ReportCfg(tmp_path / "r"))
    assert not (tmp_path / "r" / "index.html").exists()


def test_run_runs_every_study_into_its_folder(tmp_path, monkeypatch):
    ran = []
    monkeypatch.setattr(Study, "main", lambda self: ran.append(self))
    run_studies(ReportCfg(tmp_path, run=True, quick=True, seed=7))
    settings = [(study.out, study.seed, study.quick) for study in ran]
    assert settings == [(tmp_path / name, 7, True) for name in STUDIES]


@pytest.mark.parametrize("width", [390, 1200])
def test_a_real_browser_shows_the_page_without_complaint(page, width):
    address = page.resolve().as_uri()
    with open_browser() as browser:
        window = browser.new_page(viewport={"width": width, "height": 844})
        complaints, requests = watch(window)
        window.goto(address)
        compare(window.screenshot(), Path(__file__).with_name("golden") / f"report-{width}.png")
        assert [url for url in requests if not url.startswith("data:")] == [address]
        assert window.evaluate("document.documentElement.scrollWidth") == width
        assert window.evaluate("[...document.images].every(i => i.complete && i.naturalWidth > 0)")
        for scheme in ("light", "dark"):
            window.emulate_media(color_scheme=scheme)
            ink, paper = window.evaluate(
                "['color', 'backgroundColor'].map(name => getComputedStyle(document.body)[name]"
                ".match(/\\d+/g).map(Number).reduce((a, b) => a + b) / 3)"
            )
            bright, dim = (ink, paper) if scheme == "dark" else (paper, ink)
            assert bright > 200 > 50 > dim
        assert complaints == []
