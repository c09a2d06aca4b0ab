"""Scores of a flight's log against what the models say of its images."""

import json
import shutil
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from renet.bundle import DEFAULT, Bundle, pretrained
from renet.deploy.catalogue import ReplayCfg
from renet.deploy.cfg import DeployCfg
from renet.deploy.main import deploy
from renet.deploy.recording import calibration_log
from renet.deploy.recording.calibration_log import healthy_walks, recorded_scores
from renet.deploy.recording.reader import Recording, read_recording
from renet.deploy.recording.tick import MODES
from renet.deploy.safety.machine import Mode
from renet.errors import RenetError
from renet.evaluation.calibrate import CalibrateCfg, run_calibrate
from renet.selector import MONITORS

from ..fakes import BRISK


@pytest.fixture(scope="module")
def bundle(tmp_path_factory) -> Path:
    """A copy of the shipped bundle."""
    return Path(shutil.copytree(pretrained(DEFAULT), tmp_path_factory.mktemp("copy") / "bundle"))


@pytest.fixture(scope="module")
def flight(log) -> Recording:
    return read_recording(log)


def test_scores_are_the_models_own_of_the_logged_images(log, flight, bundle, monkeypatch):
    monkeypatch.setattr(calibration_log, "MIN_MINUTES", 0.0)
    scores = recorded_scores((log,), Bundle.load(bundle))
    assert [len(runs) for runs in scores.values()] == [1] * len(MONITORS)
    (walk,) = healthy_walks(flight)
    assert len(walk) > 150
    # The newest image may not have had its tick.
    rows = [row for row in sorted(flight.images) if walk.start < row < walk.stop - 5]
    pairs = np.stack([(flight.images[b], flight.images[a]) for a, b in pairwise(rows)])
    vision = Bundle.load(bundle).sessions["vision"]
    (expected,) = vision.run(["anomaly_score"], {"depth": pairs.astype(np.float32)})
    measured = scores["reconstruction"][0][:, None]
    assert np.isclose(measured, expected.reshape(1, -1), rtol=1e-4).any(axis=0).all()
    blank = -np.std([flight.images[row].astype(np.float32) for row in rows], axis=(1, 2))
    assert np.isclose(scores["uniformity"][0][:, None], blank, rtol=1e-4).any(axis=0).all()
    assert set(scores["duplicate"][0]) == {1.0}
    assert (scores["invalid_fraction"][0] == 0.0).all()
    assert (scores["frame_age"][0] < 0.11).all()


def altered(flight: Recording, name: str, rows, value) -> Recording:
    """A flight with other values in some rows of a column."""
    ticks = flight.ticks.copy()
    ticks[name][rows] = value
    return replace(flight, ticks=ticks)


def test_a_walk_that_ended_in_trouble_or_had_no_camera_does_not_count(flight):
    (*before, end), everywhere = flight.events, slice(None)
    last = np.flatnonzero(flight.ticks["mode"] == MODES.index(Mode.WALKING))[-1]
    leaning = np.cos(0.42), np.sin(0.42), 0.0, 0.0  # 48 degrees.
    for cause, run in {
        "it fell": replace(flight, events=[*before, replace(end, why="tilted by 71 degrees")]),
        "nobody knows how it ended": replace(flight, events=before, complete=False),
        "it leans": altered(flight, "quaternion", slice(last - 3, None), leaning),
        "no frame": altered(flight, "frame", everywhere, 0),
        "an old frame": altered(flight, "frame_age", -100, 1.5),
        "no walk": altered(flight, "mode", everywhere, MODES.index(Mode.DAMPING)),
        "no images": replace(flight, images={}),
    }.items():
        assert list(healthy_walks(run)) == [], cause
    damped = altered(flight, "quaternion", slice(last + 1, None), leaning)
    assert any(healthy_walks(damped)), "once damped it may fall"


def test_a_late_tick_of_vision_parts_a_walk(flight):
    (walk,) = healthy_walks(flight)
    late = slice(walk.start + 50, walk.start + 55)
    first, second = healthy_walks(altered(flight, "anomaly", late, np.inf))
    assert (first.start, first.stop) == (walk.start, late.start)
    assert second.start == late.stop + calibration_log.SETTLING_STEPS


def test_calibrate_writes_what_the_log_says(log, flight, bundle, monkeypatch):
    monkeypatch.setattr(calibration_log, "MIN_MINUTES", 0.0)
    beta = run_calibrate(CalibrateCfg(bundle, log=(log,)))
    (walk,) = healthy_walks(flight)
    assert beta == pytest.approx(float(flight.ticks["anomaly"][walk.start : walk.stop].max()))
    selector = Bundle.load(bundle).manifest.selector
    assert selector.beta == beta
    assert "1 recording(s)" in selector.calibration
    assert selector.thresholds["variance"] > flight.ticks["variance"][walk.start : walk.stop].max()
    assert "reconstruction" not in selector.thresholds
    before = (bundle / "manifest.json").read_bytes()
    assert run_calibrate(CalibrateCfg(bundle, log=(log,))) == beta, "again, though beta is new"
    assert (bundle / "manifest.previous.json").read_bytes() == before, "the old one is kept"


def test_one_log_given_25_times_is_no_long_walk(log, bundle, tmp_path):
    copies = tuple(Path(shutil.copy(log, tmp_path / f"{number}.log")) for number in range(25))
    with pytest.raises(RenetError, match=r"1\.log holds the same walk as .*0\.log"):
        recorded_scores(copies, Bundle.load(bundle))


def test_too_short_walks_and_a_forged_log_are_refused(flight, bundle, monkeypatch):
    forged = altered(flight, "anomaly", slice(None), 1e9)
    monkeypatch.setattr(calibration_log, "read_recording", lambda path: forged)
    before = (bundle / "manifest.json").read_bytes()
    for why in (r"hold 0\.1 minutes of healthy walking.*at least 5", "beta 1e.09 would never obj"):
        with pytest.raises(RenetError, match=why):
            run_calibrate(CalibrateCfg(bundle, log=(Path("forged.log"),)))
        assert (bundle / "manifest.json").read_bytes() == before
        monkeypatch.setattr(calibration_log, "MIN_MINUTES", 0.0)


def test_a_run_that_was_shown_another_runs_images_is_refused(log, bundle, tmp_path, monkeypatch):
    monkeypatch.setattr(calibration_log, "MIN_MINUTES", 0.0)
    replayed = deploy(
        DeployCfg(
            bundle,
            camera="replay",
            camera_cfg=ReplayCfg(log),
            safety=BRISK,
            seconds=2.0,
            out=tmp_path,
        )
    )
    with pytest.raises(RenetError, match=r"recording\.mcap shows the images of an earlier run"):
        recorded_scores((replayed / "recording.mcap",), Bundle.load(bundle))


def test_other_models_injected_faults_and_dry_runs_are_refused(log, bundle, bundle_path, tmp_path):
    with pytest.raises(RenetError, match="made with other models"):
        recorded_scores((log,), Bundle.load(bundle_path))
    spoilt = deploy(DeployCfg(bundle, seconds=0.1, fault=("blackout@5s",), out=tmp_path))
    with pytest.raises(RenetError, match="injected faults"):
        recorded_scores((spoilt / "recording.mcap",), Bundle.load(bundle))
    dry = deploy(DeployCfg(bundle, seconds=0.1, dry_run=True, out=tmp_path))
    with pytest.raises(RenetError, match=r"\.mcap is of a dry run, in which nothing walked"):
        recorded_scores((dry / "recording.mcap",), Bundle.load(bundle))
    short = deploy(DeployCfg(bundle, seconds=0.1, out=tmp_path))
    with pytest.raises(RenetError, match="no walk with a camera"):
        recorded_scores((short / "recording.mcap",), Bundle.load(bundle))
    assert json.loads((short / "score.json").read_text())["walking_seconds"] == 0.0
