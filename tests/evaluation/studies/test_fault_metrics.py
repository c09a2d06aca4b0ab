import math

import numpy as np
import pytest

from renet.evaluation import metrics
from renet.evaluation.studies.fault_metrics import (
    Batch,
    beside_op,
    departure,
    end_of,
    estimates,
    noticing,
    pair_counts,
    robot_measures,
    survival,
)
from renet.evaluation.trace import Trace

ONSET, OVER, STEPS = 20, 60, 100


def batch(count: int = 4) -> Batch:
    """Robot 0 notices at once, 1 late, 2 never, 3 after it fell; vision is back after the end."""
    trace = Trace.empty(STEPS, count)
    trace.forward_velocity[:] = 0.6
    trace.trusted[ONSET + 2 : OVER + 50, :, 0] = False
    trace.trusted[ONSET + 20 : OVER + 15, :, 1] = False
    trace.fell[ONSET + 5, 3] = trace.ended[ONSET + 5, 3] = True
    trace.trusted[ONSET + 10 : OVER, :, 3] = False
    if count > 4:  # A fifth robot had left vision before.
        trace.trusted[ONSET - 3 : OVER, :, 4] = False
    return Batch(trace, np.ones_like(trace.trusted), ONSET, OVER)


def test_detection_return_and_survival_by_hand() -> None:
    row = noticing(batch()) | survival(batch().trace, STEPS)
    assert row["detected"] == 2
    assert row["detection_delay_s"] == pytest.approx((0.045 + 0.405) / 2)
    assert row["detected_by_paper"] == 0
    assert row["paper_detection_delay_s"] is None
    assert (row["falls"], row["survival"]) == (1, 0.75)
    # Robot 0 is not back before the run ends, 1 after 15 steps and one update.
    assert (row["recovered"], row["away_at_end"]) == (1, 2)
    assert row["recovery_delay_s"] == pytest.approx(0.305)
    assert row["mean_forward_velocity"] == pytest.approx(0.6 * (3 * 100 + 25) / 400)


def test_a_robot_without_vision_neither_notices_nor_misses() -> None:
    four, five = noticing(batch(4)), noticing(batch(5))
    for name in ("vision_active_at_onset", "detected", "detection_delay_s", "detected_by_paper"):
        assert five[name] == four[name]
    assert four["vision_active_at_onset"] == 4


def test_a_fault_ends_by_itself_or_with_the_study() -> None:
    assert [end_of("frozen", severity, 20, 60) for severity in (1, 4)] == [30, 60]
    assert end_of("gaussian", 1, 20, 60) == end_of("mount_knocked", 1, 20, 60) == 60


def test_only_what_comes_before_a_fall_counts() -> None:
    trusted, gone = np.ones((50, 4, 2), bool), np.zeros((50, 2), bool)
    trusted[30:], gone[25:, 0] = False, True
    np.testing.assert_allclose(departure(trusted, gone, 20, 50), [np.nan, 0.205])
    # One that starts anew after a fall has not returned to vision.
    trusted[10:31], trusted[31:], gone[:30, 0] = False, True, False
    np.testing.assert_allclose(departure(~trusted, gone, 20), [np.nan, 0.225])
    # Nothing is seen after the run's end.
    assert np.isnan(departure(~trusted, gone, 50)).all()


def walk() -> Trace:
    """From step 20 on: 0 crosses at 80, 1 falls at 60, 2 stands, 3 walks on without an end."""
    trace = Trace.empty(STEPS, 4)
    trace.forward_velocity[:] = (0.8, 0.6, 0.0, 0.6)
    trace.travelled[:] = np.arange(STEPS)[:, None] * 0.02 * trace.forward_velocity
    trace.travelled[:, 3] += 3.0
    trace.power[:], trace.collisions[:] = 60.0, (0, 1, 2, 0)
    trace.vision[:] = True
    trace.vision[30:50, 0] = False
    trace.ended[80, 0] = trace.ended[60, 1] = trace.fell[60, 1] = True
    trace.fell[90, 0] = trace.ended[90, 0] = True  # A second try does not count.
    trace.vision[85:, 0] = False
    return trace


def test_every_measure_by_hand() -> None:
    found = robot_measures(walk(), 20, 0.6, STEPS)
    np.testing.assert_array_equal(found["crossed"], [1, 0, 0, 1])
    np.testing.assert_array_equal(found["upright"], [1, 0, 1, 1])
    # Robot 1 stands still for the 40 of 80 steps after its fall.
    np.testing.assert_allclose(found["speed_error"], [0.2, 0.3, 0.6, 0.0], atol=1e-12)
    longer = robot_measures(walk(), 20, 0.6, STEPS + 100)
    np.testing.assert_allclose(longer["speed_error"], [0.2, 84 / 180, 0.6, 0.0], atol=1e-12)
    mean = survival(walk(), STEPS)["mean_forward_velocity"]
    assert mean == pytest.approx((0.8 + 0.36 + 0.0 + 0.6) / 4)  # Robot 0 until it crosses.
    steps = np.array([60, 40, np.nan, 80])
    speed = np.array([0.8, 0.6, np.nan, 0.6])
    expected = 60.0 * steps * 0.02 / (steps * 0.02 * speed)
    np.testing.assert_allclose(found["energy_per_metre"], expected)
    np.testing.assert_array_equal(found["collisions"], [0, 1, 2, 0])
    np.testing.assert_allclose(found["seconds_without_sight"], [0.4, 0, 0, 0])
    np.testing.assert_array_equal(found["switches"], [2, 0, 0, 0])


def test_changes_are_paired_by_robot() -> None:
    values = robot_measures(walk(), 20, 0.6, STEPS)
    found = estimates(values, values | {"speed_error": values["speed_error"] - 0.1})
    assert found["crossed"]["value"] == 0.5
    assert found["crossed"]["ci95"] == pytest.approx([0.150, 0.850], abs=1e-3)  # Wilson's.
    assert found["crossed"]["change"] == {"value": 0.0, "ci95": [0.0, 0.0]}
    # All robots change alike, however different they are.
    assert found["speed_error"]["change"]["ci95"] == pytest.approx([0.1, 0.1])
    nothing = {name: [np.nan] for name in values}
    assert estimates(nothing, nothing)["switches"]["value"] is None


def test_twins_and_op_are_matched_robot_by_robot() -> None:
    fell, calm, op = [1, 1, 0, 0], [1, 0, 0, 1], [0, 1, 1, 0]
    own, twin, blind = ({"upright": 1 - np.array(falls)} for falls in (fell, calm, op))
    assert pair_counts(own, twin) == {"falls_by_fault": 1, "falls_spared": 1}
    found = beside_op(own, blind)
    assert found["over_op_ci95_low"] < found["over_op"] == 0 < found["over_op_ci95_high"]
    assert set(beside_op(own, None).values()) == {None}


@pytest.mark.parametrize(("count", "limit"), [(0, 2.996), (1, 4.744), (5, 10.513)])
def test_the_poisson_limit_is_the_textbooks(count: int, limit: float) -> None:
    found = metrics.poisson_upper(count)
    assert found == pytest.approx(limit, abs=1e-3)
    chance = sum(math.exp(-found) * found**i / math.factorial(i) for i in range(count + 1))
    assert chance == pytest.approx(0.05)
