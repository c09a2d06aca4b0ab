"""Timelines of flights made by hand."""

import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest

from renet.deploy.controller import Event
from renet.deploy.recording.objections import objectors
from renet.deploy.recording.reader import Recording
from renet.deploy.recording.tick import TICK_DTYPE
from renet.deploy.recording.timeline import BANDS, draw_run

from .conftest import STEPS


def drawn(flight: Recording, onsets, folder) -> str:
    """Everything the timeline shows as text, with the colours of its shapes."""
    draw_run(flight, onsets, folder / "timeline.svg")
    page = (folder / "timeline.svg").read_text()
    ET.fromstring(page)
    return page


def test_the_timeline_shows_bands_faults_and_reasons(flight, tmp_path):
    from matplotlib import rc_context

    with rc_context({"svg.fonttype": "none"}):
        page = drawn(flight, [5.8, 7.0], tmp_path)
        for colour, _ in BANDS:
            assert page.count(f"fill: {colour}") >= 4, "three panels and the legend"
        assert page.count("stroke: #a3121f") == 6, "two onsets in three panels"
        reason = next(line for line in page.splitlines() if "blind: no &lt;new&gt; image" in line)
        assert "text-anchor: end" in reason, "else a late one leaves the picture"
        flight.events.append(Event(flight.ticks["now"][300], "unseen", "the ground ends: it stops"))
        assert "unseen: the ground ends: it stops" in drawn(flight, [], tmp_path)
        hostile = replace(
            flight, header={"bundle": "$\\frac{$<script>", "thresholds": {"reconstruction": 1e14}}
        )
        assert "&lt;script&gt;" in drawn(hostile, [], tmp_path)


def test_the_timeline_shows_how_a_robot_walks_to_the_side(flight, tmp_path):
    from matplotlib import rc_context

    with rc_context({"svg.fonttype": "none"}):
        # The sine of a heading is no speed.
        flight.ticks["told"][:, 1] = 0.4
        assert "to the left" not in drawn(flight, [], tmp_path)
        flight.header["told"] = "twist"
        assert "pale: to the left" in drawn(flight, [], tmp_path)
        flight.ticks["told"][:, 1] = 0.0
        assert "to the left" not in drawn(flight, [], tmp_path)


def test_long_and_tiny_runs_are_drawn(flight, tmp_path):
    for end in (0.0, 1e-3, 5e5):
        flight.ticks["now"] = np.linspace(0.0, end, STEPS)
        assert len(drawn(flight, [], tmp_path)) < 400_000
    many = [Event(1000.0 + i, "blind", "x" * 500) for i in range(1000)]
    nothing = Recording({}, np.zeros(0, TICK_DTYPE), {}, many, False)
    assert len(drawn(nothing, [], tmp_path)) < 400_000


def test_the_timeline_names_the_monitor_that_objected(flight, tmp_path):
    from matplotlib import rc_context

    flight.header["thresholds"] = {"frame_age": 0.2, "uniformity": -0.03, "variance": 9.0}
    flight.ticks["frame_age"] = 0.05
    flight.ticks["frame_age"][300:] = 0.5
    flight.ticks["variance"] = 8.0
    rng = np.random.default_rng(0)
    flight.images[0] = rng.uniform(0, 1, (48, 64)).astype(np.float16)
    flight.images[400] = np.zeros((48, 64), np.float16)
    found = objectors(flight)
    assert [*found] == ["uniformity", "frame_age"]
    np.testing.assert_allclose(found["frame_age"][[299, 300]], [0.25, 2.5], rtol=1e-6)
    assert found["uniformity"][399] == pytest.approx(0.03 / 0.2887, rel=0.05)
    assert found["uniformity"][400] > 1.0
    with rc_context({"svg.fonttype": "none"}):
        page = drawn(flight, [], tmp_path)
    assert "frame age: no new image" in page
    assert "uniformity: the image is blank" in page
    assert "variance" not in page
