"""Flights come back as they were written, whole or torn, and replay to the last bit."""

import math
import os
from contextlib import nullcontext
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from renet.bundle import Bundle
from renet.deploy.controller import Controller
from renet.deploy.recording import recorder
from renet.deploy.recording.recorder import Recorder, Recording, read_recording
from renet.deploy.recording.replay import mismatch, replay
from renet.deploy.teleop import TeleopCommand
from renet.errors import RenetError
from renet.pilot.inference import InlineInference, ThreadedInference

from ...hostile.files import HEAD, chunk
from ..fakes import QUICK, STANDING, Broken, frame, live, state, time_of, until

STEPS = 230


def run_control_loop(bundle: Bundle, path, inference=InlineInference) -> None:
    header = {"bundle_sha256": bundle.sha256, "safety": asdict(QUICK), "mode": "memory"}
    log = Recorder(path, header)
    controller = Controller(bundle, QUICK, inference, on_event=log.event)
    random = np.random.default_rng(3)
    for step in range(STEPS):
        now = time_of(step)
        reading = live(
            now,
            joint_position=STANDING + 0.05 * random.normal(size=12),
            temperature=30.0 + step // 100,
            battery=0.8 if step < 210 else math.nan,
        )
        picture = frame(step - step % 5, time_of(step - step % 5)) if step % 90 < 60 else None
        if 150 <= step < 153:
            reading = state(now, joint_position=np.zeros(5))
        if step == 100:
            picture = replace(frame(step, now), image=np.zeros((2, 2)))
        teleop = TeleopCommand(0.5, 0.0, 0.5, arm=step in (1, 165))
        controller.tick(reading, picture, teleop, now)
        log.append(reading, picture, teleop, now, controller.decision, compute_ms=1.5)
    controller.close()
    log.close()
    log.close()


@pytest.fixture(scope="module")
def recorded(bundle, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("run") / "logs" / "a.log"
    run_control_loop(bundle, path)
    return path


@pytest.fixture
def flight(recorded) -> Recording:
    return read_recording(recorded)


def test_a_flight_comes_back_whole(bundle, flight, recorded):
    assert flight.complete
    assert len(flight.ticks) == STEPS
    assert flight.header["bundle_sha256"] == bundle.sha256
    modes = [recorder.MODES[mode] for mode in flight.ticks["mode"][[0, 5, 100, 155, 229]]]
    assert modes == ["damping", "standing_up", "walking", "damping", "walking"]
    assert flight.events[0].what == "standing_up"
    assert any("joint_position has shape (5,)" in event.why for event in flight.events)
    said = [
        (0, 30.0, 0.8),
        (100, 31.0, 0.8),
        (150, np.nan, np.nan),
        (153, 31.0, 0.8),
        (200, 32.0, 0.8),
        (210, 32.0, np.nan),
    ]
    np.testing.assert_allclose(np.array(flight.power.tolist()), said, rtol=1e-6)
    np.testing.assert_array_equal(flight.images[15], frame(15, 0.3).image.astype(np.float16))
    assert flight.ticks["compute_ms"][7] == 1.5
    assert recorded.stat().st_size < 1_000_000


def test_replay_is_bit_for_bit(bundle, flight, tmp_path, monkeypatch):
    """Also of a flight with an impatient vision thread."""
    monkeypatch.setattr(ThreadedInference, "patience", 0.0)
    run_control_loop(bundle, tmp_path / "a.log", ThreadedInference)
    for recording in (flight, read_recording(tmp_path / "a.log")):
        assert mismatch(recording, bundle) == 0.0
    vision = [decision.vision for decision in replay(flight, bundle)]
    np.testing.assert_array_equal(vision, flight.ticks["vision"])
    assert 0 < np.mean(vision) < 1


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ({"bundle_sha256": "0" * 64}, "made with bundle 000000000000"),
        ({"safety": {"max_height": 1.0}}, "does not say what ran"),
        ({"safety": None}, "does not say what ran"),
        ({"mode": ...}, "does not say what ran: 'mode'"),
        ({"unseen": None}, "unseen None: walk, slow, stop"),
    ],
)
def test_a_run_of_another_bundle_cannot_be_replayed(bundle, flight, header, message):
    merged = {key: value for key, value in (flight.header | header).items() if value is not ...}
    with pytest.raises(RenetError, match=message):
        next(replay(replace(flight, header=merged), bundle))


def ends_of_chunks(data: bytes) -> list[int]:
    ends = [len(recorder.MAGIC)]
    while ends[-1] < len(data):
        ends.append(ends[-1] + recorder.CHUNK.size + recorder.CHUNK.unpack_from(data, ends[-1])[1])
    return ends


@pytest.mark.parametrize(
    "tail", [b"", bytes(3), bytes(recorder.CHUNK.size), bytes(5000), b"TICK" + bytes(8)]
)
def test_a_torn_flight_is_read_up_to_the_tear(recorded, tmp_path, tail):
    """Zeros are what a power cut leaves."""
    data = recorded.read_bytes()
    torn = tmp_path / "torn.flight"
    lengths = []
    sizes = {*range(len(recorder.MAGIC), len(data), len(data) // 100), *ends_of_chunks(data)[:-1]}
    for size in sorted(sizes):
        torn.write_bytes(data[:size] + tail)
        refused = pytest.raises(RenetError, match="no readable header")
        with refused if size < ends_of_chunks(data)[1] else nullcontext():
            flight = read_recording(str(torn))
            assert not flight.complete
            lengths.append(len(flight.ticks))
    assert lengths == sorted(lengths)
    assert lengths[-1] == STEPS


def test_a_flipped_bit_ends_the_flight_there(recorded, tmp_path):
    data = bytearray(recorded.read_bytes())
    data[len(data) // 2] ^= 4
    (tmp_path / "a.log").write_bytes(data)
    flight = read_recording(tmp_path / "a.log")
    assert not flight.complete
    assert 0 < len(flight.ticks) < STEPS


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"once", "not a recording"),
        (b"RENETLOG4\n" + bytes(9), r"a recording of renet 0\.1\.x: only that version reads it"),
        (HEAD + chunk(recorder.HEADER, b"[1]"), "another version"),
        (HEAD + chunk(recorder.HEADER, b"{"), "not JSON"),
        (HEAD + chunk(recorder.TICKS, b"123"), "another version"),
        (HEAD + chunk(recorder.EVENTS, b'[{"when": 3}]'), "another version"),
        (HEAD + chunk(recorder.EVENTS, b'[{"time": "a", "what": 1, "why": 2}]'), "another version"),
        (HEAD + chunk(recorder.EVENTS, b"7"), "another version"),
        (HEAD + chunk(recorder.IMAGES, bytes(6150)), "another version"),
    ],
)
def test_another_versions_chunks_are_refused(tmp_path, data, message):
    (tmp_path / "a.log").write_bytes(data)
    with pytest.raises(RenetError, match=message):
        read_recording(tmp_path / "a.log")


def test_a_full_disk_ends_the_log_and_not_the_flight(bundle, tmp_path, monkeypatch):
    monkeypatch.setattr(recorder, "create", lambda *_: open("/dev/full", "wb"))  # noqa: SIM115
    log = Recorder(tmp_path / "a.log", {})
    controller = Controller(bundle, QUICK)
    until(lambda: log.problem != "")
    for step in range(60):
        controller.tick(state(time_of(step)), None, TeleopCommand(), time_of(step))
        log.append(None, None, TeleopCommand(), time_of(step), controller.decision, 0.0)
    assert log._chunks.empty(), "nothing piles up in memory"
    log.close()
    assert "ends early" in log.problem


def test_objects_that_fail_are_logged_as_bad(tmp_path):
    broken: Any = Broken()
    log = Recorder(tmp_path / "a.log", {})
    log.append(broken, broken, broken, 0.0, Controller(Bundle.load()).decision, 0.0)
    log.close()
    (tick,) = read_recording(tmp_path / "a.log").ticks
    assert (tick["state"], tick["frame"], tick["stop"]) == (recorder.BAD, recorder.BAD, True)


def test_no_more_is_unpacked_than_what_was_read_can_hold(recorded, tmp_path):
    """A hole takes no room on the disk: what counts is what was read before it."""
    path, data = tmp_path / "a.log", recorded.read_bytes()
    data = data[: ends_of_chunks(data)[-2]]
    size = recorder.TICK_DTYPE.itemsize
    bomb = chunk(recorder.TICKS, bytes(recorder.MAX_CHUNK // size * size))
    for count, reason in ((9, "run backwards"), (20, "unpacks to far more than its size")):
        path.write_bytes(data + bomb * count)
        os.truncate(path, 1_000_000_000)
        with pytest.raises(RenetError, match=reason):
            read_recording(path)
