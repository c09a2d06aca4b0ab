"""Ctrl-C and TERM at every phase of a study, a calibration, an export and the demo."""

import os
import shutil
import signal
from pathlib import Path

import numpy as np
import pytest

from renet import cli
from renet.bundle import DEFAULT, Bundle, pretrained
from renet.evaluation import calibrate, demo, evaluator, figures, results, study, video
from renet.evaluation.demo import DemoStudy
from renet.evaluation.rollout import Rollout
from renet.evaluation.studies.memory import MemoryStudy
from renet.training import export

from .fakes import FakeEvaluator

SIMULATED = ["--terrains", "flat", "--robots", "2", "--seconds", "2"]
"""A calibration that is over at once: a healthy run, and one through grass."""


def interrupt(monkeypatch, owner, name: str, call: int = 1, number: int = signal.SIGINT) -> None:
    """Send this process a signal at the `call`-th call of a function, once."""
    function, calls = getattr(owner, name), []

    def interrupted(*args, **kwargs):
        calls.append(name)
        if len(calls) == call:
            os.kill(os.getpid(), number)
        return function(*args, **kwargs)

    monkeypatch.setattr(owner, name, interrupted)


def files(folder: Path) -> dict[str, bytes]:
    """Whole files by name, without the folder's own."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.fixture(autouse=True)
def handlers():
    before = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, before)


@pytest.mark.parametrize(
    ("owner", "name", "number"),
    [
        (Rollout, "run", signal.SIGINT),
        (results, "write_json", signal.SIGTERM),
        (study, "write_csv", signal.SIGINT),
        (figures, "save_figure", signal.SIGTERM),
    ],
)
def test_an_interrupted_study_says_how_to_go_on_and_does(
    tmp_path, monkeypatch, capsys, owner, name, number
) -> None:
    monkeypatch.setattr(MemoryStudy, "make_evaluator", lambda self: FakeEvaluator())
    options = "--grounds gap:3 platform:4 --robots 2 --seconds 4 --out"
    command = ["evaluate", "memory", *options.split()]
    with monkeypatch.context() as patch:
        # The second part is interrupted, or the only figure.
        interrupt(patch, owner, name, 1 if owner in (figures, study) else 2, number)
        assert cli.main([*command, str(tmp_path)]) == 130
    last = capsys.readouterr().err.splitlines()[-1]
    assert last == f"renet: interrupted: {cli.KEPT}"
    left = files(tmp_path)
    assert not [file for file in left if file.endswith(".partial")]
    kept = {file: content for file, content in left.items() if file.startswith("parts")}
    assert len(kept) == (1 if owner in (Rollout, results) else 2)
    assert cli.main([*command, str(tmp_path)]) == 0
    assert {"summary.json", "summary.csv", "memory.png"} < files(tmp_path).keys()
    assert kept.items() <= files(tmp_path).items(), "what had finished was run again"


@pytest.mark.parametrize(
    ("owner", "name", "call", "source", "number"),
    [
        (calibrate, "recorded_scores", 1, ["--log", "walk.log"], signal.SIGINT),
        (calibrate, "write_manifest", 1, ["--log", "walk.log"], signal.SIGTERM),
        (Rollout, "run", 1, SIMULATED, signal.SIGTERM),
        (Rollout, "run", 2, SIMULATED, signal.SIGINT),
        (calibrate, "calibrate_monitors", 1, SIMULATED, signal.SIGTERM),
        (calibrate, "write_manifest", 1, SIMULATED, signal.SIGINT),
    ],
)
def test_an_interrupted_calibration_leaves_the_bundle(
    tmp_path, monkeypatch, capsys, owner, name, call, source, number
) -> None:
    bundle = Path(shutil.copytree(pretrained(DEFAULT), tmp_path / "bundle"))
    before = files(bundle)
    fake = FakeEvaluator()
    fake.bundle = Bundle.load(bundle)  # type: ignore[attr-defined]
    monkeypatch.setattr(evaluator, "Evaluator", lambda *arguments: fake)
    scores = {name: [np.linspace(0.01, 0.02, 300)] for name in calibrate.MONITORS}
    monkeypatch.setattr(calibrate, "recorded_scores", lambda *arguments: scores)
    monkeypatch.setattr(calibrate, "healthy_series", lambda *arguments: scores)
    monkeypatch.setattr(calibrate, "memory_limits", lambda *arguments: ({}, 0.0))
    interrupt(monkeypatch, owner, name, call, number)
    assert cli.main(["calibrate", str(bundle), *source]) == 130
    assert capsys.readouterr().err.splitlines()[-1] == f"renet: interrupted: {cli.AT_ONCE}"
    assert files(bundle) == before


@pytest.mark.parametrize(
    ("name", "number"),
    [("load_networks", signal.SIGINT), ("anomaly_score", signal.SIGTERM)],
)
def test_an_interrupted_export_leaves_the_bundle(
    tmp_path, monkeypatch, capsys, name, number
) -> None:
    """Also from within ONNX's tracing; hostile/test_ends.py interrupts each step of writing."""
    bundle = Path(shutil.copytree(pretrained(DEFAULT), tmp_path / "bundle"))
    before = files(bundle)
    interrupt(monkeypatch, export, name, number=number)
    weights = str(pretrained("checkpoint"))
    assert cli.main(["export", weights, "--out", str(bundle)]) == 130
    assert capsys.readouterr().err.splitlines()[-1] == f"renet: interrupted: {cli.AT_ONCE}"
    assert files(bundle) == before


@pytest.mark.parametrize(
    ("owner", "name", "number"),
    [(video, "film", signal.SIGTERM), (demo, "demo_page", signal.SIGINT)],
)
def test_an_interrupted_demo_leaves_no_half_page(
    tmp_path, monkeypatch, capsys, owner, name, number
) -> None:
    if name == "demo_page":
        monkeypatch.setattr(video, "film", lambda *args: None)
    monkeypatch.setattr(DemoStudy, "make_evaluator", lambda self: FakeEvaluator())
    interrupt(monkeypatch, owner, name, number=number)
    command = ["demo", "--robots", "2", "--seconds", "2", "--out", str(tmp_path)]
    assert cli.main(command) == 130
    assert capsys.readouterr().err.splitlines()[-1] == f"renet: interrupted: {cli.KEPT}"
    assert "index.html" not in files(tmp_path)
    assert ("demo.png" in files(tmp_path)) == (name == "demo_page")
