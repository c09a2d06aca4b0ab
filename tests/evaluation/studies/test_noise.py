from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from renet.errors import RenetError
from renet.evaluation import noise
from renet.evaluation.results import plain
from renet.evaluation.studies.noise import CLEAN, NoiseCfg, run_noise, setting_rows, walk

from .fakes import SPEED, FakeEvaluator

RUN_KEYS = {
    "mode",
    "noise",
    "level",
    "robots",
    "falls",
    "mean_forward_velocity",
    "detection_delay_s",
    "seed",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("noise") / "deep" / "er"
    run_noise(NoiseCfg(out=out, robots=2, steps=250, onset=50), FakeEvaluator())
    return out


def test_summary_has_one_row_for_each_mode_and_setting(folder: Path) -> None:
    summary = json.loads((folder / "summary.json").read_text())
    runs = summary["runs"]
    assert all(run.keys() >= RUN_KEYS for run in runs)
    settings = [(run["mode"], run["noise"], run["level"]) for run in runs]
    noises = [("gaussian", level) for level in (0.3, 0.7, 1.0)]
    noises += [("salt_and_pepper", level) for level in (0.1, 0.3, 0.7)]
    assert settings == [(mode, *noise) for mode in ("vp", "renet") for noise in noises]
    assert {run["robots"] for run in runs} == {2}
    assert [run["mode"] for run in summary["baseline"]] == ["vp", "renet"]
    assert summary["provenance"].keys() >= {"bundle_hash", "engine", "seed", "command", "date"}
    assert summary["healthy"]["false_switches"] == 0


def test_measured_values_are_those_of_the_robots(folder: Path) -> None:
    runs = json.loads((folder / "summary.json").read_text())["runs"]
    for run in runs:
        if run["mode"] == "renet":
            assert run["falls"] == 0
            assert run["mean_forward_velocity"] == pytest.approx(SPEED, abs=1e-6)
            assert run["detection_delay_s"] == pytest.approx(0.035)
            assert run["detected"] == 2
        else:
            assert run["detection_delay_s"] is None
    strongest = next(
        r for r in runs if (r["mode"], r["noise"], r["level"]) == ("vp", "gaussian", 1.0)
    )
    assert strongest["falls"] == 2
    assert strongest["mean_forward_velocity"] == 0


def test_figures_and_table_are_written_whole(folder: Path) -> None:
    for name in ("noise.png", "timeline.png"):
        assert (folder / name).read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert len((folder / "summary.csv").read_text().splitlines()) == 1 + 12 + 2
    assert not list(folder.glob("*.part"))


def test_the_timelines_camera_recovers() -> None:
    last = setting_rows(NoiseCfg(steps=450, onset=150), ("gaussian", 1.0))[-1]
    assert last.mode == "renet"
    at_work = np.array([last.schedule[0].elapsed(k) >= 0 for k in range(450)])
    np.testing.assert_array_equal(at_work, (np.arange(450) >= 150) & (np.arange(450) < 300))


def test_an_interrupted_study_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cfg = NoiseCfg(out=tmp_path, quick=True, steps=60, onset=10)
    walked: list[tuple[str, float]] = []

    def spy(cfg, evaluator, world, setting, title, film=()):
        walked.append(setting)
        if setting == ("gaussian", 0.7) and walked.count(setting) == 1:
            raise KeyboardInterrupt
        return walk(cfg, evaluator, world, setting, title, film)

    monkeypatch.setattr(noise, "walk", spy)
    with pytest.raises(KeyboardInterrupt):
        run_noise(cfg, FakeEvaluator())
    assert not (tmp_path / "summary.json").exists()
    summary = run_noise(cfg, FakeEvaluator())
    settings = [CLEAN, *cfg.settings]
    assert walked == [*settings[:3], *settings[2:]]
    assert {run["robots"] for run in summary["runs"]} == {5}
    whole = run_noise(replace(cfg, out=tmp_path / "whole"), FakeEvaluator())
    assert plain(whole["runs"]) == plain(summary["runs"])


@pytest.mark.parametrize(
    "wrong",
    [
        {"modes": ("blind",)},
        {"modes": ()},
        {"speed": 0.0},
        {"robots": 0},
        {"onset": 450},
        {"gaussian": (), "salt_and_pepper": ()},
        {"selector": "coin"},
    ],
)
def test_bad_settings_are_refused(wrong) -> None:
    with pytest.raises(RenetError):
        NoiseCfg(**wrong)


def test_a_file_in_the_way_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RenetError, match="cannot write"):
        run_noise(NoiseCfg(out=tmp_path / "file"), FakeEvaluator())


def test_a_folder_that_is_not_ours_is_reported(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("os.access", lambda path, mode: False)
    with pytest.raises(RenetError, match="permission denied"):
        run_noise(NoiseCfg(out=tmp_path), FakeEvaluator())
