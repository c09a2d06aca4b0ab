"""Flights come back as they were written, whole or torn, and replay to the last bit."""

import math
import os
import threading
from contextlib import nullcontext
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from renet.bundle import Bundle
from renet.deploy.controller import Controller, Event
from renet.deploy.recording import channels, reader, recorder
from renet.deploy.recording.channels import Topic
from renet.deploy.recording.reader import Recording, read_recording
from renet.deploy.recording.recorder import Recorder
from renet.deploy.recording.replay import replay_error, replay_run
from renet.deploy.recording.tick import BAD, MODES
from renet.deploy.teleop.base import TeleopCommand
from renet.errors import RenetError
from renet.interface import DEPTH_SHAPE
from renet.pilot.inference import InlineInference, ThreadedInference

from ...hostile.files import EMPTY, SECOND, recording
from ..fakes import QUICK, STANDING, Broken, frame, live, state, time_of, until

STEPS = 230


def run_control_loop(bundle: Bundle, path, inference=InlineInference) -> None:
    header = {
        "bundle_sha256": bundle.sha256,
        "safety": asdict(QUICK),
        "mode": "memory",
        "unseen": "walk",
    }
    log = Recorder(path, header)
    controller = Controller(bundle, QUICK, inference, on_event=log.event)
    random = np.random.default_rng(3)
    for step in range(STEPS):
        now = time_of(step)
        reading = live(
            now,
            joint_position=STANDING + 0.05 * random.normal(size=12),
            temperature=np.arange(12) + step // 100,
            battery=0.8 if step < 210 else math.nan,
            voltage=24.5,
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
    path = tmp_path_factory.mktemp("run") / "logs" / "a.mcap"
    run_control_loop(bundle, path)
    return path


@pytest.fixture
def flight(recorded) -> Recording:
    return read_recording(recorded)


def test_a_flight_comes_back_whole(bundle, flight, recorded):
    assert flight.complete
    assert len(flight.ticks) == STEPS
    assert flight.header["bundle_sha256"] == bundle.sha256
    modes = [MODES[mode] for mode in flight.ticks["mode"][[0, 5, 100, 155, 229]]]
    assert modes == ["damping", "standing_up", "walking", "damping", "walking"]
    assert flight.events[0].what == "standing_up"
    assert any("joint_position has shape (5,)" in event.why for event in flight.events)
    changes = [0, 100, 150, 153, 200, 210]
    np.testing.assert_array_equal(flight.power["now"], [time_of(step) for step in changes])
    np.testing.assert_array_equal(flight.power["temperature"][:2], [[*range(12)], [*range(1, 13)]])
    np.testing.assert_array_equal(flight.power["temperature"][2], np.nan)
    charge = [0.8, 0.8, np.nan, 0.8, 0.8, np.nan]
    np.testing.assert_allclose(flight.power["battery"], charge, rtol=1e-6)
    assert flight.power["voltage"][-1] == 24.5
    np.testing.assert_array_equal(flight.images[15], frame(15, 0.3).image.astype(np.float16))
    assert flight.ticks["compute_ms"][7] == 1.5
    assert recorded.stat().st_size < 1_000_000


def test_replay_is_bit_for_bit(bundle, flight, tmp_path, monkeypatch):
    """Also of a flight with an impatient vision thread."""
    monkeypatch.setattr(ThreadedInference, "patience", 0.0)
    run_control_loop(bundle, tmp_path / "a.mcap", ThreadedInference)
    for run in (flight, read_recording(tmp_path / "a.mcap")):
        assert replay_error(run, bundle) == 0.0
    vision = [decision.vision for decision in replay_run(flight, bundle)]
    np.testing.assert_array_equal(vision, flight.ticks["vision"])
    assert 0 < np.mean(vision) < 1


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ({"bundle_sha256": "0" * 64}, "made with bundle 000000000000"),
        ({"safety": {"max_height": 1.0}}, "does not say what ran"),
        ({"safety": None}, "does not say what ran"),
        ({"mode": ...}, "does not say what ran: 'mode'"),
        ({"unseen": "sit"}, "unknown unseen 'sit': choose one of walk, slow, stop"),
    ],
)
def test_a_run_of_another_bundle_cannot_be_replayed(bundle, flight, header, message):
    merged = {key: value for key, value in (flight.header | header).items() if value is not ...}
    with pytest.raises(RenetError, match=message):
        next(replay_run(replace(flight, header=merged), bundle))


def ends_of_chunks(data: bytes) -> list[int]:
    """Places after each chunk, without the index at the end."""
    place = len(reader.MAGIC)
    ends = []
    while True:
        opcode, length = reader.RECORD.unpack_from(data, place)
        if opcode == Opcode.DATA_END:
            return ends
        place += reader.RECORD.size + length
        if opcode == Opcode.CHUNK:
            ends.append(place)


@pytest.mark.parametrize(
    "tail", [b"", bytes(3), bytes(reader.RECORD.size), bytes(5000), b"\x06" + bytes(8)]
)
def test_a_torn_flight_is_read_up_to_the_tear(recorded, tmp_path, tail):
    """Zeros are what a power cut leaves."""
    data = recorded.read_bytes()
    torn = tmp_path / "torn.flight"
    lengths = []
    ends = ends_of_chunks(data)
    for size in sorted({*range(len(reader.MAGIC), ends[-1], len(data) // 100), *ends}):
        torn.write_bytes(data[:size] + tail)
        refused = pytest.raises(RenetError, match="no readable header")
        with refused if size < ends[0] else nullcontext():
            flight = read_recording(str(torn))
            assert not flight.complete
            lengths.append(len(flight.ticks))
    assert lengths == sorted(lengths)
    assert lengths[-1] == STEPS


def test_a_tear_between_an_image_and_its_tick_loses_the_two(bundle, tmp_path, monkeypatch):
    monkeypatch.setattr(channels, "CHUNK_SIZE", 1)  # A chunk for each message.
    run_control_loop(bundle, tmp_path / "whole.mcap")
    whole = read_recording(tmp_path / "whole.mcap")
    data = (tmp_path / "whole.mcap").read_bytes()
    torn = tmp_path / "torn.mcap"
    for end in ends_of_chunks(data):
        torn.write_bytes(data[:end])
        flight = read_recording(torn)
        count = len(flight.ticks)
        assert flight.ticks.tobytes() == whole.ticks[:count].tobytes()
        assert list(flight.images) == [row for row in whole.images if row < count]


def test_texts_and_seconds_of_any_size_are_read_back(tmp_path):
    """In one chunk these events would be twice what the reader accepts."""
    log = Recorder(tmp_path / "a.mcap", {})
    reasons = ["\N{SNOWMAN}\N{ROBOT FACE}" * 1000] * 999 + ["x" * 5_000_000]
    for why in reasons:
        log.event(Event(0.0, "robot", why))
    log.append(None, None, TeleopCommand(), 0.0, Controller(Bundle.load()).decision, 0.0)
    log.close()
    assert log.problem == ""
    flight = read_recording(tmp_path / "a.mcap")
    assert flight.complete
    assert [event.why for event in flight.events] == [why[: channels.MAX_REASON] for why in reasons]


def test_a_robot_that_lies_still_with_a_covered_camera_is_read_back(tmp_path, monkeypatch):
    """Nothing that a run writes compresses as well."""
    monkeypatch.setattr(reader, "FREE", 0)
    decision = Controller(Bundle.load()).decision
    log = Recorder(tmp_path / "a.mcap", {}, patient=True)
    for step in range(500):
        now = time_of(step)
        picture = replace(frame(step, now), image=np.ones(DEPTH_SHAPE))
        log.append(live(now), picture, TeleopCommand(), now, decision, 0.0)
    log.close()
    assert len(read_recording(tmp_path / "a.mcap").images) == 500


def test_a_message_too_large_to_read_ends_the_log(tmp_path):
    log = Recorder(tmp_path / "a.mcap", {"notes": "x" * 1_000_001})
    log.close()
    assert log.problem.endswith("ends early: a message of /run has more than 1 MB")


def test_a_flipped_bit_ends_the_flight_there(recorded, tmp_path):
    data = bytearray(recorded.read_bytes())
    data[len(data) // 2] ^= 4
    (tmp_path / "a.mcap").write_bytes(data)
    flight = read_recording(tmp_path / "a.mcap")
    assert not flight.complete
    assert 0 < len(flight.ticks) < STEPS


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"once", "not a recording: give an MCAP file"),
        (b"RENETLOG4\n" + bytes(9), r"a recording of renet 0\.1: only that version reads it"),
        (recording([(Topic.RUN, b"[1]")]), "another version"),
        (recording([(Topic.RUN, b"{")]), "not JSON"),
        (recording(EMPTY, [(Topic.TICK, b"123")]), "not little-endian CDR"),
        (recording(EMPTY, [(Topic.TICK, b"\0\1\0\0abc")]), "a message has 3 bytes in place of"),
        (recording(EMPTY, [(Topic.EVENTS, b"\0\1\0\0\0\0\0\0")]), "a message ends early"),
        (recording(EMPTY, [(Topic.DEPTH, b"\0\1\0\0" + bytes(99))]), "an image has 0 x 0 pixels"),
    ],
)
def test_another_versions_chunks_are_refused(tmp_path, data, message):
    (tmp_path / "a.mcap").write_bytes(data)
    with pytest.raises(RenetError, match=message):
        read_recording(tmp_path / "a.mcap")


def test_ticks_with_other_fields_are_refused(tmp_path, monkeypatch):
    other = channels.MessageType("renet_msgs/msg/Tick", "float64 later\n")
    with monkeypatch.context() as patch:
        patch.setitem(channels.MESSAGE_TYPES, Topic.TICK, other)
        (tmp_path / "a.mcap").write_bytes(recording(EMPTY))
    with pytest.raises(RenetError, match="the messages of /tick are of another type"):
        read_recording(tmp_path / "a.mcap")


def test_a_full_disk_ends_the_log_and_not_the_flight(bundle, tmp_path, monkeypatch):
    monkeypatch.setattr(recorder, "create", lambda *_: open("/dev/full", "wb"))  # noqa: SIM115
    log = Recorder(tmp_path / "a.mcap", {})
    controller = Controller(bundle, QUICK)
    until(lambda: log.problem != "")
    for step in range(60):
        controller.tick(state(time_of(step)), None, TeleopCommand(), time_of(step))
        log.append(None, None, TeleopCommand(), time_of(step), controller.decision, 0.0)
    assert log._chunks.empty(), "nothing piles up in memory"
    log.close()
    assert "ends early" in log.problem


def test_a_disk_that_catches_up_at_the_end_of_a_run_loses_nothing(tmp_path, monkeypatch):
    stalled = threading.Event()
    fsync = os.fsync
    monkeypatch.setattr(recorder, "MAX_CHUNKS", 1)
    monkeypatch.setattr(recorder.os, "fsync", lambda file: stalled.wait() and fsync(file))
    log = Recorder(tmp_path / "a.mcap", {})
    # The disk is at the header.
    until(log._chunks.empty)
    decision = Controller(Bundle.load()).decision
    for step in range(51):
        log.append(None, None, TeleopCommand(), time_of(step), decision, 0.0)
    threading.Timer(0.2, stalled.set).start()
    log.close()
    assert log.problem == ""
    flight = read_recording(tmp_path / "a.mcap")
    assert (len(flight.ticks), flight.complete) == (51, True)


def test_a_writing_thread_that_fails_in_any_way_is_told(tmp_path, monkeypatch):
    def fail(*_) -> None:
        raise RuntimeError("a mistake in the writer")

    monkeypatch.setattr(recorder, "ChannelWriter", fail)
    log = Recorder(tmp_path / "a.mcap", {})
    until(lambda: log.problem != "")
    log.close()
    assert log.problem.endswith("ends early: a mistake in the writer")


def test_objects_that_fail_are_logged_as_bad(tmp_path):
    broken: Any = Broken()
    log = Recorder(tmp_path / "a.mcap", {})
    log.append(broken, broken, broken, 0.0, Controller(Bundle.load()).decision, 0.0)
    log.close()
    (tick,) = read_recording(tmp_path / "a.mcap").ticks
    assert (tick["state"], tick["frame"], tick["stop"]) == (BAD, BAD, True)


def test_no_more_is_unpacked_than_what_was_read_can_hold(recorded, tmp_path):
    """A hole takes no room on the disk: what counts is what was read before it."""
    path, data = tmp_path / "a.mcap", recorded.read_bytes()
    data = data[: ends_of_chunks(data)[-1]]
    for count, reason in ((9, "run backwards"), (60, "unpacks to far more than its size")):
        path.write_bytes(data + SECOND * count)
        os.truncate(path, 1_000_000_000)
        with pytest.raises(RenetError, match=reason):
            read_recording(path)


def test_a_flight_too_long_for_memory_is_read_up_to_there(recorded, flight, monkeypatch):
    """As one of three hours with a camera of 30 Hz."""
    monkeypatch.setattr(reader, "_MAX_BYTES", recorded.stat().st_size)
    part = read_recording(recorded)
    assert 0 < len(part.ticks) < len(flight.ticks)
    assert part.ticks.tobytes() == flight.ticks[: len(part.ticks)].tobytes()
    assert list(part.images) == [row for row in flight.images if row < len(part.ticks)]
    assert flight.complete
    assert not part.complete


def test_ros_tools_read_it(recorded, flight):
    """Independent code, which knows the messages by the file's own schemas alone."""
    with recorded.open("rb") as file:
        found = [
            *make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages(
                [Topic.TICK, Topic.DEPTH, Topic.EVENTS, Topic.POWER]
            )
        ]
    by_topic = {topic: [m for _, c, _, m in found if c.topic == topic] for topic in Topic}
    for tick, decoded in zip(flight.ticks, by_topic[Topic.TICK], strict=True):
        for name in flight.ticks.dtype.names:
            np.testing.assert_array_equal(getattr(decoded, name), tick[name], err_msg=name)
    for image, decoded in zip(flight.images.values(), by_topic[Topic.DEPTH], strict=True):
        assert (decoded.encoding, decoded.step) == ("32FC1", 256)
        pixels = np.frombuffer(decoded.data, "<f4").reshape(decoded.height, decoded.width)
        np.testing.assert_array_equal(pixels, image)
    for event, decoded in zip(flight.events, by_topic[Topic.EVENTS], strict=True):
        assert (decoded.name, decoded.msg) == (event.what, event.why)
    assert by_topic[Topic.POWER][0].voltage == 24.5


def test_times_of_events_are_exactly_their_ticks(tmp_path):
    """Though ROS 2 counts whole nanoseconds."""
    log = Recorder(tmp_path / "a.mcap", {})
    decision = Controller(Bundle.load()).decision
    times = 98765.4321 + np.cumsum(np.full(9, 1.0 / 49.9))
    for now in times.tolist():
        log.event(Event(now, "robot", "ä\n"))
        log.append(None, None, TeleopCommand(), now, decision, 0.0)
    log.event(Event(times[-1] + 1.0, "later", ""))
    log.close()
    flight = read_recording(tmp_path / "a.mcap")
    assert [event.time for event in flight.events[:-1]] == times.tolist()
    assert flight.events[0].why == "ä\n"
    assert flight.events[-1].time == pytest.approx(times[-1] + 1.0, abs=1e-8)
