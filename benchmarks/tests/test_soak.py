"""Some seconds of the soak, in which things go wrong far more often than in its hour."""

from dataclasses import fields

import numpy as np
import pytest

from disturbances import Failure, Means
from hardware_faults import Fault
from promises import Promises
from renet.deploy.recording.reader import read_recording
from renet.robots import GO1
from soak import Cfg, Soak, growth, hardware, read_all, soak

OFTEN = Means(**{field.name: 3.0 for field in fields(Means)})
CFG = Cfg(minutes=0.2, terrain="flat", level=1, means=OFTEN)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("soak")


@pytest.fixture(scope="module")
def results(folder) -> dict:
    return soak(CFG, folder)


def test_nothing_is_broken_and_every_recording_is_whole(results, folder):
    assert results["breaches"] == {}
    assert results["recording_problems"] == {}
    assert results["simulated_minutes"] == pytest.approx(0.2, abs=0.02)
    assert results["programs"] > 1
    paths = [folder / f"recording-{number}.mcap" for number in range(results["programs"])]
    now = np.concatenate([read_recording(path).ticks["now"] for path in paths])
    assert (np.diff(now) > 0.0).all(), "the robot's clock goes on from one program to the next"


def test_every_kind_of_disturbance_was_given(results):
    happened = {name for name in results["given"] if hasattr(OFTEN, name)}
    assert {"push", "reading_lost", "hardware", "second_robot", "heat", "battery"} <= happened
    assert len(happened) >= 15
    assert results["commands_checked"] > 1000
    assert results["failures"]


def test_a_breach_on_the_way_to_the_motors_is_found(tmp_path, monkeypatch):
    """A limit of the checks is narrower than the robot's: its targets lie outside."""
    begin = Promises.begin

    def narrow(promises, controller, link) -> None:
        promises._most[:12] = GO1.lower
        begin(promises, controller, link)

    monkeypatch.setattr(Promises, "begin", narrow)
    hour = Soak(Cfg(minutes=0.01, terrain="flat", level=1), tmp_path)
    hour.run()
    assert set(hour.promises.broken) == {"a joint target is outside of its range"}


def test_a_torn_or_missing_recording_is_a_problem(results, folder, tmp_path):
    whole = folder / "recording-0.mcap"
    torn = tmp_path / "torn.mcap"
    data = whole.read_bytes()
    torn.write_bytes(data[: len(data) // 2])
    missing = tmp_path / "missing.mcap"
    parts, _, problems = read_all([whole, torn, missing], GO1)
    assert len(parts) == 2
    assert problems["incomplete"] == 1
    assert problems.total() == 2


def test_growth_is_that_of_the_settled_minutes():
    assert growth([1.0] * 6) is None
    assert growth([90.0, 95.0, 99.0, 100.0, 100.0, *(100.0 + 0.5 * m for m in range(10))]) == 30.0


def test_faults_are_counted_by_part_kind_and_outcome():
    dead = Fault("motor", "dies", 0, 3.0, 1.0)
    failures = [
        Failure(dead, True, 0.1, "why"),
        Failure(dead, True),
        Failure(dead, False, 0.1, "why"),
    ]
    assert hardware(failures) == {"motor dies": {"told soon": 1, "not told": 1}}
