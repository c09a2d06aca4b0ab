"""Scores of flights made by hand, whose falls, metres and delays are known."""

import json
from dataclasses import replace

import numpy as np
import pytest

from renet.deploy.controller import Event
from renet.deploy.recording import score
from renet.deploy.recording.reader import Recording
from renet.deploy.recording.score import (
    ScoreCfg,
    score_log,
    score_run,
    state_shares,
    summary,
    track,
    write_score,
)
from renet.deploy.recording.tick import MODES, NONE, TICK_DTYPE
from renet.deploy.safety.machine import ENDED, Mode
from renet.errors import RenetError
from renet.interface import CONTROL_DT

from ..fakes import turned
from .conftest import BLIND, RISEN, STEPS


def test_a_robots_flight_is_reckoned_from_its_estimators(flight):
    result = score_run(flight, [5.8])
    assert result["walking_seconds"] == 8.0
    assert result["distance_from"] == "estimator"
    assert result["distance_m"] == pytest.approx(4 * 0.5 + 4 * 0.4, abs=0.02)
    assert result["speed_m_s"] == pytest.approx(0.45, abs=0.01)
    assert result["commanded_m_s"] == 0.6
    assert result["vision_share"] == 0.5
    assert 0 < result["memory_share"] < 0.5
    assert (result["switches"], result["blind_before_first_fault"]) == (1, 0)
    assert result["switch_delay_s"] == [pytest.approx(0.2)]
    assert result["compute_ms"] == {"p50": 1.0, "p99": pytest.approx(1.0), "max": 9.0}
    assert result["period_ms"]["max"] == pytest.approx(20.0)
    np.testing.assert_allclose(track(flight.ticks)[-1], [0.0, 3.6, 0.0], atol=0.02)


def test_a_dry_run_does_not_claim_that_a_robot_walked(flight):
    dry = replace(flight, header=flight.header | {"dry_run": True})
    assert summary(score_run(dry, [])).startswith("dry run, the robot was left alone; ")
    assert "dry run" not in summary(score_run(flight, []))


def test_a_simulators_truth_wins(flight):
    flight.ticks["base_position"] = np.linspace((0, 0, 0.3), (3, 4, 0.3), STEPS)
    result = score_run(flight, [])
    assert result["distance_from"] == "simulator"
    assert result["distance_m"] == pytest.approx(5.0 * 0.8, abs=0.02)
    assert result["blind_before_first_fault"] == 1, "without a fault it is a false alarm"


@pytest.mark.parametrize(("told", "commanded"), [("twist", 0.5), ("heading", 0.3)])
def test_the_way_of_a_robot_that_comes_back_counts(flight, told, commanded):
    """Ahead and back, to the left and back, with the sway of a gait."""
    flight.header["told"] = told
    ticks = flight.ticks
    corners = np.array([(0, 0), (1, 0), (0, 0), (0, 1), (0, 0)])
    walking = np.linspace(0, 4, STEPS - RISEN)
    for axis in (0, 1):
        ticks["base_position"][RISEN:, axis] = np.interp(walking, range(5), corners[:, axis])
        ticks["base_position"][:RISEN, axis] = 0.0
    ticks["base_position"][:, 1] += 0.02 * np.sin(2 * np.pi * ticks["now"] / 0.5)
    ticks["base_position"][:, 2] = 0.3
    ticks["told"][:] = (-0.3, 0.4, 0.1)
    result = score_run(flight, [])
    assert result["path_m"] == pytest.approx(4.0, abs=0.1)
    assert result["speed_m_s"] == pytest.approx(0.5, abs=0.02)
    assert result["commanded_m_s"] == pytest.approx(commanded)
    assert result["distance_m"] == pytest.approx(0.0, abs=0.03)
    assert "walked 8.0 s and 4.0 m (simulator)" in summary(result)


def test_switch_delays(flight):
    assert score_run(flight, [7.0, 9.999])["switch_delay_s"] == [0.0, None]
    flight.ticks["vision"][RISEN:] = True
    assert score_run(flight, [5.8])["switch_delay_s"] == [None]


def test_falls_are_counted_once_each(flight):
    quaternion = flight.ticks["quaternion"]
    quaternion[200:220] = turned("x", 61)
    quaternion[300:] = turned("x", -120)
    quaternion[:5], quaternion[5:8] = np.nan, 0.0
    quaternion[100:120] = turned("x", 59)
    flight.ticks["state"][250:260] = NONE
    assert score_run(flight, [])["falls"] == 2
    flight.events.append(Event(1005.9, "damping", ENDED))
    assert score_run(flight, [])["falls"] == 1, "who topples when it is let go does not fall"


def test_one_odd_reading_and_a_robot_that_begins_on_its_back_are_no_falls(flight):
    flight.ticks["quaternion"][300] = turned("x", 180)
    assert score_run(flight, [])["falls"] == 0
    flight.ticks["quaternion"][:] = turned("x", 180)
    flight.ticks["mode"] = MODES.index(Mode.DAMPING)
    assert score_run(flight, [])["falls"] == 0


def test_a_drop_off_the_ground_is_a_fall_and_stairs_are_none(flight):
    position = flight.ticks["base_position"]
    position[:] = (0.0, 0.0, 0.3)
    position[150:200, 2], position[200:, 2] = np.linspace(0.3, -0.3, 50), -0.3
    assert score_run(flight, [])["falls"] == 0
    position[300:, 2] -= 4.9 * (CONTROL_DT * np.arange(STEPS - 300)) ** 2
    assert score_run(flight, [])["falls"] == 1


def in_the_gap(flight: Recording, height: float) -> dict:
    """The score of a walk into a gap of 43 cm, where the base is so high from 8 s on."""
    flight.header.update(terrain="gap", level=6)
    position = flight.ticks["base_position"]
    position[:] = np.linspace((0.0, 0.0, 0.3), (1.4, 0.1, 0.3), STEPS)
    position[400:] = (1.4, 0.1, height)
    # It struggles: a single fall all the same.
    position[450:460, 2] = 0.3
    return score_run(flight, [5.8])


def test_a_robot_whose_trunk_lies_across_a_gap_has_fallen_into_it(flight):
    sunk = in_the_gap(flight, 0.06)
    assert (sunk["crossed"], sunk["falls"]) == ("fell into the gap", 1)
    assert "fell into the gap; " in summary(sunk)


def test_a_robot_that_stands_across_a_gap_has_not_fallen(flight):
    above = in_the_gap(flight, 0.28)
    assert (above["crossed"], above["falls"]) == ("did not cross the gap", 0)
    flight.ticks["base_position"][400:] = (1.0, 0.1, 0.06)
    assert score_run(flight, [])["crossed"] == "did not cross the gap", "it lies before the gap"


@pytest.mark.parametrize(("at", "verdict"), [(1.8, "did not cross"), (2.0, "crossed")])
def test_a_robot_that_stops_behind_a_gap_has_crossed_it(flight, at, verdict):
    # It ends 1.63 m from the start; the hind feet are 0.3 m behind the base.
    flight.header.update(terrain="gap", level=6)
    flight.ticks["base_position"][:] = np.linspace((0.0, 0.0, 0.3), (at, 0.1, 0.3), STEPS)
    assert score_run(flight, [])["crossed"] == f"{verdict} the gap"


@pytest.mark.parametrize(
    ("terrain", "end"),
    [("platform", 2.8), ("stairs_up", 3.6), ("stairs", 3.9), ("rough", 4.0), ("obstacles", 4.0)],
)
def test_a_robot_has_crossed_once_its_hind_feet_have_left_the_obstacle(flight, terrain, end):
    flight.header.update(terrain=terrain, level=6)
    for at, verdict in ((end + 0.29, "did not cross"), (end + 0.31, "crossed")):
        flight.ticks["base_position"][:] = np.linspace((0.0, 0.0, 0.3), (0.1, at, 0.3), STEPS)
        crossed = score_run(flight, [])["crossed"]
        assert crossed == f"{verdict} the {terrain.replace('_', ' ')}"


def test_an_unknown_tile_has_no_verdict(flight):
    for header in ({"terrain": "lava", "level": 6}, {"terrain": "gap", "level": 11}):
        flight.header.update(header)
        assert score_run(flight, [])["crossed"] == ""


def test_an_image_that_vision_takes_for_new_though_it_is_old_is_not_sight(flight):
    flight.ticks["has_image"] = True
    flight.ticks["frame_age"][200:] = 0.5
    # OP drives from `BLIND` on, and trusts no image.
    assert score_run(flight, [])["old_image_share"] == (BLIND - 200) / (STEPS - RISEN)
    flight.ticks["has_image"][200:] = False
    assert score_run(flight, [])["old_image_share"] == 0.0


def test_an_empty_flight(tmp_path):
    empty = Recording({}, np.zeros(0, TICK_DTYPE), {}, [], False)
    result = write_score(empty, tmp_path / "new", [1.0])
    assert result["walking_seconds"] == result["distance_m"] == result["falls"] == 0
    assert result["path_m"] == 0
    assert result["switch_delay_s"] == [None]
    assert json.loads((tmp_path / "new" / "score.json").read_text()) == result


@pytest.mark.parametrize("onset", [np.nan, -0.1, 10.1, 5800.0])
def test_an_onset_outside_of_the_run_is_refused(flight, tmp_path, monkeypatch, onset):
    monkeypatch.setattr(score, "read_recording", lambda path: flight)
    cfg = ScoreCfg(tmp_path / "recording.mcap", onset=(5.8, onset))
    with pytest.raises(RenetError, match=rf"--onset .* 0 to 9.98, got {onset:g}"):
        score_log(cfg)
    assert not any(tmp_path.iterdir())


def test_a_folder_that_cannot_be_written(flight, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RenetError, match="cannot write the score"):
        write_score(flight, tmp_path / "file")


@pytest.mark.parametrize(
    ("vision", "memory", "old", "words"),
    [
        (1.0, 0.0, 0.0, "saw 100 %"),
        (1.0, 0.0, 0.53, "saw 47 %, trusted an old image 53 %"),
        (0.875, 0.7725, 0.0, "saw 10 %, remembered 77 %, blind 13 %"),
        (0.668, 0.33, 0.0, "saw 34 %, remembered 33 %, blind 33 %"),
        (0.0, 0.0, 0.0, "blind 100 %"),
    ],
)
def test_shares_of_a_walk_add_up(vision, memory, old, words):
    shares = {"vision_share": vision, "memory_share": memory, "old_image_share": old}
    assert state_shares(shares) == words
    percent = [int(part.split()[-2]) for part in words.split(", ")]
    assert sum(percent) == 100
