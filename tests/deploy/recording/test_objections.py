"""Monitors that objected in flights made by hand."""

import numpy as np

from renet.deploy.recording.objections import objectors, ratios


def test_without_an_objection_the_timeline_shows_the_nearest_monitor(flight):
    flight.header["thresholds"] = {"frame_age": 0.2, "variance": 9.0}
    flight.ticks["variance"] = 8.0
    assert [*objectors(flight)] == ["variance"]
    del flight.header["thresholds"]
    assert objectors(flight) == {}


def test_a_frozen_image_objects_by_its_repeats(flight):
    flight.header["thresholds"] = {"duplicate": 3.0}
    image = np.random.default_rng(0).uniform(0, 1, (48, 64)).astype(np.float16)
    for row in (200, 205, 210, 215):
        flight.images[row] = image
    ratio = ratios(flight)["duplicate"]
    rows = [199, 200, 205, 210, 215, 499]
    np.testing.assert_allclose(ratio[rows], np.array([0, 1, 2, 3, 4, 4]) / 3)


def test_before_the_first_image_no_monitor_of_pixels_objects(flight):
    limits = {"duplicate": 3.0, "partly_frozen": 3.0, "uniformity": -0.03, "nearness": 10.0}
    flight.header["thresholds"] = limits
    flight.images.clear()
    for ratio in ratios(flight).values():
        np.testing.assert_array_equal(ratio, 0.0)
