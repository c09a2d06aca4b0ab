from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest

from renet.errors import RenetError
from renet.evaluation import report
from renet.evaluation.report.report import SECTIONS, ReportCfg, make_report
from renet.evaluation.report.summary import FACTS, WORSE
from renet.evaluation.studies.course import CourseCfg, run_course
from renet.evaluation.studies.faults import FaultsCfg, run_faults
from renet.evaluation.studies.filter import FilterCfg, run_filter
from renet.evaluation.studies.noise import NoiseCfg, run_noise
from renet.evaluation.studies.standing import StandingCfg, run_standing
from renet.evaluation.studies.terrain import SuccessCfg, TerrainCfg, run_success, run_terrain

from .browser import Browser, find_browser
from .fakes import FakeEvaluator
from .test_course import StillLab
from .test_standing import QUICK, ObedientLab
from .test_success import HurdlesLab
from .test_terrain import LadderLab


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every study, tiny."""
    folder = tmp_path_factory.mktemp("results")
    run_noise(NoiseCfg(out=folder / "noise", robots=1, steps=170, onset=10), FakeEvaluator())
    run_faults(
        FaultsCfg(
            out=folder / "faults",
            faults=("gaussian", "unplugged", "wrong_scale"),
            robots=1,
            onset=10,
            over=40,
            steps=60,
            healthy_minutes=0,
        ),
        FakeEvaluator(),
    )
    run_filter(FilterCfg(out=folder / "filter", robots=1, onset=10, steps=60), FakeEvaluator())
    run_terrain(TerrainCfg(out=folder / "terrain", robots=2, seconds=2), LadderLab())
    run_standing(StandingCfg(out=folder / "standing", **QUICK), ObedientLab())
    run_success(
        SuccessCfg(out=folder / "success", levels=(1, 3), trials=2, seconds=2), HurdlesLab()
    )
    run_course(
        CourseCfg(out=folder / "course", lap=("flat", "grass"), laps=1, robots=1, patience=0.2),
        StillLab(),
    )
    return folder


@pytest.fixture(scope="module")
def page(results: Path) -> Path:
    return make_report(ReportCfg(results, results / "new" / "page.html"))


def test_the_report_holds_every_study_and_needs_no_network(page: Path) -> None:
    html = re.sub(r"base64,[A-Za-z0-9+/=]+", "", page.read_text()).replace("&#x27;", "'")
    for heading in (
        "Where RENet does worse",
        "Noise in the camera",
        "Every way a depth camera fails",
        "One try at each obstacle",
        "Parkour",
        "Standing on command",
        "The course",
        "selector's filter",
    ):
        assert f">{heading}" in html or heading in html
    assert "http" not in html
    assert "∞ s" in html
    # Pictures need a real bundle: test_pictures.py reports them.
    assert html.count("bundle hash") == len(SECTIONS) - 1
    assert html.count("<img") == 12


def test_one_study_alone_makes_a_page(results: Path, tmp_path: Path) -> None:
    (tmp_path / "filter").symlink_to(results / "filter")
    page = make_report(ReportCfg(tmp_path))
    assert page == tmp_path / "index.html"
    html = page.read_text()
    assert "Parkour" not in html
    assert "none of what was run" in html


def test_results_of_different_bundles_are_pointed_out(results: Path, tmp_path: Path) -> None:
    assert "Careful" not in make_report(ReportCfg(results, tmp_path / "one.html")).read_text()
    shutil.copytree(results / "filter", tmp_path / "filter")
    shutil.copytree(results / "noise", tmp_path / "noise")
    summary = tmp_path / "filter" / "summary.json"
    summary.write_text(summary.read_text().replace("0" * 64, "f" * 64))
    html = make_report(ReportCfg(tmp_path)).read_text()
    assert "2 different bundles, 0000000000, ffffffffff" in html


def test_what_is_worse_than_op_alone_is_listed() -> None:
    faults = {
        "harmful": [
            {"fault": "glare", "severity": 5, "renet": 0.5, "op": 1.0, "beyond_chance": True}
        ],
        "missed": [
            {
                "fault": "frozen",
                "severity": 3,
                "undetected": 2,
                "vp_falls": 4,
                "vp_spared": 1,
                "beyond_chance": False,
            }
        ],
    }
    assert WORSE["faults"](faults) == [
        ("faults", "glare 5", "50 %", "100 %"),
        (
            "faults",
            "frozen 3 goes unnoticed; 4 fall with VP only then, 1 only without it (within chance)",
            "2 robots",
            "",
        ),
    ]
    passages = [
        {"mode": "renet", "kind": "gap", "crossed": 1, "tries": 4},
        {"mode": "op", "kind": "gap", "crossed": 2, "tries": 4},
        {"mode": "renet", "kind": "flat", "crossed": 4, "tries": 4},
        {"mode": "op", "kind": "flat", "crossed": 4, "tries": 4},
    ]
    assert WORSE["course"]({"passages": passages}) == [("course", "gap", "1 of 4", "2 of 4")]
    worse = [{"kind": "gap", "size_m": 0.1, "renet": 0.2, "op": 0.3}]
    assert WORSE["success"]({"worse": worse}) == [("obstacles", "gap 10 cm", "20 %", "30 %")]


def test_what_was_not_measured_is_no_large_number() -> None:
    calm = {"false_switches": 0, "false_switches_per_hour": None}
    blind = {"mode": "op", "robots": 2, "falls": 1, "vision_active_at_onset": 2, "detected": 0}
    faults = {"runs": [blind], "healthy": calm}
    assert FACTS["noise"]({"runs": [blind], "healthy": calm}) == []
    assert FACTS["faults"](faults) == []
    off = blind | {"mode": "renet", "vision_active_at_onset": 0, "falls": 0}
    seen = blind | {"mode": "renet", "vision_active_at_onset": 1, "detected": 1, "falls": 0}
    assert [value for value, _ in FACTS["faults"](faults | {"runs": [off]})] == ["100 %"]
    both = FACTS["faults"](faults | {"runs": [off, seen]})
    assert [value for value, _ in both] == ["100 %", "100 %"]


def test_no_results_are_reported(tmp_path: Path) -> None:
    with pytest.raises(RenetError, match="no results in"):
        make_report(ReportCfg(tmp_path, tmp_path / "page.html"))
    assert not (tmp_path / "page.html").exists()


def test_incomplete_results_are_reported(tmp_path: Path) -> None:
    (tmp_path / "filter").mkdir()
    summary = {"runs": [], "provenance": {"bundle_hash": "b"}}
    (tmp_path / "filter" / "summary.json").write_text(json.dumps(summary))
    with pytest.raises(RenetError, match="results of filter"):
        make_report(ReportCfg(tmp_path, tmp_path / "page.html"))


def test_run_runs_every_study_into_its_folder(tmp_path: Path, monkeypatch) -> None:
    ran = {}

    def study(name: str):
        def run(cfg) -> None:
            ran[name] = (cfg.out, cfg.seed, getattr(cfg, "quick", None))

        return run

    for name in SECTIONS:
        monkeypatch.setattr(report, f"run_{name}", study(name))
    report.run_studies(ReportCfg(tmp_path, run=True, quick=True, seed=7))
    assert set(ran) == set(SECTIONS)
    for name, (out, seed, quick) in ran.items():
        assert (out, seed) == (tmp_path / name, 7)
        assert quick is not False


@pytest.fixture(scope="module")
def browser():
    program = find_browser()
    if program is None:
        pytest.skip("no Chromium on this machine: install chromium-headless-shell")
    browser = Browser(program)
    yield browser
    browser.close()


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", [390, 1200])
def test_a_real_browser_shows_the_page_without_complaint(
    page: Path, browser: Browser, width: int, dark: bool
) -> None:
    browser.open(page, width, dark)
    assert browser.requests == [page.resolve().as_uri()]
    assert browser.complaints == []
    assert browser.ask("document.documentElement.scrollWidth") == width
    assert browser.ask("[...document.images].every(i => i.complete && i.naturalWidth > 0)")
    colours = browser.ask(
        "['color', 'backgroundColor'].map(name => getComputedStyle(document.body)[name]"
        ".match(/\\d+/g).map(Number).reduce((a, b) => a + b) / 3)"
    )
    ink, paper = colours
    assert (ink > 200 and paper < 50) if dark else (ink < 50 and paper > 200)


def test_the_browser_is_told_of_errors_requests_and_overflow(
    browser: Browser, tmp_path: Path
) -> None:
    bad = tmp_path / "bad.html"
    bad.write_text(
        '<img src="http://localhost:9/x.png"><div style="width:900px">x</div>'
        "<script>console.error('no'); undefined.x</script>"
    )
    browser.open(bad, 390, dark=False)
    assert "http://localhost:9/x.png" in browser.requests
    assert len(browser.complaints) >= 2
    assert browser.ask("document.documentElement.scrollWidth") > 390
