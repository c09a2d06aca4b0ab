from __future__ import annotations

import re
from pathlib import Path

import pytest

from renet.errors import RenetError
from renet.evaluation.fault_study import FaultsCfg, run_faults
from renet.evaluation.filter_study import FilterCfg, run_filter
from renet.evaluation.noise import NoiseCfg, run_noise
from renet.evaluation.report import ReportCfg, make_report

from .fakes import FakeLab


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("results")
    faults = ("gaussian", "unplugged", "wrong_scale")
    run_noise(NoiseCfg(out=folder / "noise", robots=1, steps=170, onset=10), FakeLab())
    run_faults(
        FaultsCfg(out=folder / "faults", faults=faults, robots=1, onset=10, steps=60), FakeLab()
    )
    run_filter(FilterCfg(out=folder / "filter", robots=1, onset=10, steps=60), FakeLab())
    return folder


def test_the_report_holds_every_study_found_and_needs_no_network(
    results: Path, tmp_path: Path
) -> None:
    page = make_report(ReportCfg(results, tmp_path / "new" / "page.html"))
    html = re.sub(r"base64,[A-Za-z0-9+/=]+", "", page.read_text())
    for heading in ("Six ways to spoil", "Every way a depth camera fails", "selector's filter"):
        assert heading in html.replace("&#x27;", "'")
    assert "Parkour" not in html
    assert html.count("<img") == 5
    assert "http" not in html
    assert "∞ s" in html
    assert html.count("bundle hash") == 3


def test_no_results_are_reported(tmp_path: Path) -> None:
    with pytest.raises(RenetError, match="no results in"):
        make_report(ReportCfg(tmp_path, tmp_path / "page.html"))
    assert not (tmp_path / "page.html").exists()


def test_incomplete_results_are_reported(results: Path, tmp_path: Path) -> None:
    (tmp_path / "filter").mkdir()
    (tmp_path / "filter" / "summary.json").write_text('{"runs": []}')
    with pytest.raises(RenetError, match="results of filter"):
        make_report(ReportCfg(tmp_path, tmp_path / "page.html"))
