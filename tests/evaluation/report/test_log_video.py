"""A film shows what the log holds; the drawing itself is `video`'s, and replaced."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from renet.deploy.main import DeployCfg, deploy
from renet.deploy.recording import Recorder, read_recording
from renet.deploy.safety import SafetyCfg
from renet.errors import RenetError
from renet.evaluation.report import log_video
from renet.evaluation.report.log_video import film_log as film
from renet.interface import JOINTS


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("flight")
    fault = ("blackout@1s+0.2s", "frozen:1@0.4s")
    safety = SafetyCfg(stand_up_seconds=0.4)
    deploy(DeployCfg(out=out, terrain="stairs_down", seconds=1.5, fault=fault, safety=safety))
    return out / "recording.log"


@pytest.fixture
def drawn(monkeypatch) -> dict:
    seen: dict = {}

    def draw(path, spec, poses, panels, look):
        seen.update(path=path, model=spec.compile(), poses=poses[:, 0], panel=panels[0])
        return path

    monkeypatch.setattr(log_video, "make_video", draw)
    return seen


def test_the_film_shows_the_flight(log, drawn):
    assert film(log) == log.with_suffix(".mp4")
    flight = read_recording(log)
    rows = np.arange(0, len(flight.ticks), 2)
    assert len(drawn["poses"]) == len(rows)
    np.testing.assert_allclose(drawn["poses"][:, :3], flight.ticks["base_position"][rows])
    joints = [drawn["model"].joint(name).qposadr[0] for name in JOINTS]
    np.testing.assert_allclose(drawn["poses"][:, joints], flight.ticks["joint_position"][rows])
    assert drawn["model"].nmesh > 0
    assert drawn["model"].ngeom > 40, "the tile is there"
    panel = drawn["panel"]
    np.testing.assert_array_equal(panel.vision, flight.ticks["vision"][rows])
    assert panel.fault[25:30] == ["blackout"] * 5
    assert panel.fault[10:15] == ["frozen"] * 5, "it ends by itself"
    assert {panel.fault[row] for row in (9, 15, 24, 30)} == {""}
    assert not panel.depth[27].any()
    assert panel.depth[20].any()
    assert not panel.fallen[:-13].any(), "until it is damped for the last half second"


def test_a_real_flight_is_shown_on_flat_ground_where_it_is_reckoned_to_be(
    log, drawn, monkeypatch, tmp_path
):
    flight = read_recording(log)
    ticks = flight.ticks.copy()
    ticks["base_position"] = np.nan
    ticks["joint_position"][10] = np.nan
    real = replace(flight, ticks=ticks, header=flight.header | {"robot": "go1"})
    monkeypatch.setattr(log_video, "read_recording", lambda path: real)
    film(log, tmp_path / "new" / "film.mp4")
    assert drawn["path"].parent.is_dir()
    assert np.isfinite(drawn["poses"]).all()
    assert drawn["poses"][0, :3] == pytest.approx([0.0, 0.0, 0.3])
    assert drawn["poses"][-1, 0] > 0.2
    assert drawn["model"].ngeom < 60


def test_an_empty_log_is_refused(tmp_path):
    Recorder(tmp_path / "recording.log", {}).close()
    with pytest.raises(RenetError, match="nothing to show"):
        film(tmp_path / "recording.log")
