"""Ctrl-C and TERM at every phase of a study, a calibration and the demo."""

import os
import shutil
import signal
from dataclasses import replace
from pathlib import Path

import pytest

from renet import cli
from renet.bundle import DEFAULT, pretrained
from renet.evaluation import calibrate, demo, figures, results, study
from renet.evaluation.demo import DemoCfg
from renet.evaluation.rollout import Rollout
from renet.evaluation.studies.memory import MemoryStudy

from .fakes import FakeEvaluator
from .tiny import TINY

PHASES = [(Rollout, "run"), (results, "write_json"), (study, "write_csv"), (figures, "save")]


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


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(("owner", "name"), PHASES)
def test_an_interrupted_study_says_how_to_go_on_and_does(
    tmp_path, monkeypatch, capsys, owner, name, number
) -> None:
    monkeypatch.setattr(MemoryStudy, "make_evaluator", lambda self: FakeEvaluator())
    command = [
        "evaluate",
        "memory",
        "--grounds",
        "gap:3",
        "platform:4",
        "--robots",
        "2",
        "--seconds",
        "4",
        "--out",
    ]
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


@pytest.mark.parametrize("name", ["recorded_scores", "calibrate_monitors", "write_manifest"])
def test_an_interrupted_calibration_leaves_the_bundle(tmp_path, monkeypatch, capsys, name) -> None:
    bundle = Path(shutil.copytree(pretrained(DEFAULT), tmp_path / "bundle"))
    before = files(bundle)
    scores = {name: [calibrate.np.linspace(0.01, 0.02, 300)] for name in calibrate.MONITORS}
    monkeypatch.setattr(calibrate, "recorded_scores", lambda logs, bundle: scores)
    interrupt(monkeypatch, calibrate, name)
    assert cli.main(["calibrate", str(bundle), "--log", "walk.log"]) == 130
    assert "interrupted: the bundle is as it was" in capsys.readouterr().err
    assert files(bundle) == before


@pytest.mark.parametrize("name", ["film_comparison", "write_page"])
def test_an_interrupted_demo_leaves_no_half_page(tmp_path, monkeypatch, name) -> None:
    noise = TINY["noise"][0]
    monkeypatch.setattr(demo, "NoiseStudy", lambda **settings: replace(noise, **settings))
    if name == "write_page":
        film = tmp_path / "video.mp4"
        monkeypatch.setattr(demo, "film_comparison", lambda *args: film)
        monkeypatch.setattr(demo, "render", lambda *args, **kwargs: None)
        monkeypatch.setattr(demo, "provenance_section", lambda summary: None)
    interrupt(monkeypatch, demo, name)
    with pytest.raises(KeyboardInterrupt):
        demo.run_demo(DemoCfg(out=tmp_path), FakeEvaluator())  # type: ignore[arg-type]
    assert "index.html" not in files(tmp_path)
    assert {"summary.json", "noise.png"} < files(tmp_path).keys()
