"""Every command that takes a bundle takes the Go2's, by its name."""

import shutil

import pytest

from renet import cli
from renet.bundle import pretrained, read_manifest
from renet.evaluation import calibrate_memory, painter
from renet.page import writer

SMALL = "--robots 1 --seconds 1"
WALKS = {
    "demo": "--robots 1 --seconds 2.5 --modes memory",
    "evaluate faults": f"{SMALL} --faults frozen:5 --grounds gap --onsets 0.5 --lasts 0.5"
    " --healthy-minutes 0.02",
    "evaluate terrain": f"{SMALL} --quick",
    "evaluate terrain --preset success": f"{SMALL} --kinds gap --levels 1",
    "evaluate terrain --preset dawn": f"{SMALL} --kinds gap --modes camera",
    "evaluate terrain --preset standing": f"{SMALL} --kinds flat",
    "evaluate memory": "--robots 1 --seconds 3 --grounds gap:3 --without 0.5 --modes memory",
    "evaluate camera-use": "--robots 2 --seconds 1 --grounds gap:3",
    "evaluate margins": f"{SMALL} --axes payload --grounds flat --modes memory --quick",
    "play": "--seconds 1 --modes memory",
    "deploy": "--seconds 2 --terrain stairs --fault blackout@1s",
    "page": "",
    "bundle inspect": "",
    "bundle card": "",
}
"""Commands and options with which they take seconds."""
FILES = {"page": "renet-page.json", "deploy": "score.json", "bundle card": "README.md"}
"""What tells of the bundle; a study's is its summary."""


@pytest.mark.parametrize("name", WALKS)
def test_it_is_known_by_name(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(painter, "PANEL", (96, 72))
    monkeypatch.setattr(writer, "VENDOR", ())
    bundle = ["go2-parkour"]
    if name.startswith(("demo", "evaluate")):
        bundle.insert(0, "--bundle")
    out = [] if name == "bundle inspect" else ["--out", "film.mp4" if name == "play" else "out"]
    assert cli.main([*name.split(), *bundle, *WALKS[name].split(), *out]) == 0
    if name == "play":
        assert (tmp_path / "film.mp4").stat().st_size > 1000
    elif name == "bundle inspect":
        assert "Unitree Go2" in capsys.readouterr().out
    else:
        assert "go2-parkour" in (tmp_path / "out" / FILES.get(name, "summary.json")).read_text()


def test_a_copy_is_calibrated_and_the_one_that_ships_stays(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(calibrate_memory, "BLACKOUT_RANGE", (0.1, 0.2))
    monkeypatch.setattr(calibrate_memory, "MEASURED_TIME", 0.6)
    command = ["--robots", "2", "--seconds", "2", "--terrains", "flat", "--no-sparse-grass"]
    before = read_manifest(pretrained("go2-parkour"))
    for shipped in ("go2-parkour", str(pretrained("go2-parkour"))):
        assert cli.main(["calibrate", shipped, *command]) == 2
        assert "keeps its thresholds: calibrate a copy" in capsys.readouterr().err
    shutil.copytree(pretrained("go2-parkour"), "go2-parkour")
    assert cli.main(["calibrate", "go2-parkour", *command]) == 0
    assert read_manifest(tmp_path / "go2-parkour").selector.healthy_hours < 0.01
    assert read_manifest(pretrained("go2-parkour")) == before
