import math

import numpy as np
import pytest

from renet.evaluation import metrics
from renet.evaluation.studies import fault_metrics
from renet.evaluation.studies.fault_settings import Setting
from renet.evaluation.trace import Trace

ONSET, OVER, STEPS = 20, 60, 100


def faulty() -> Trace:
    """Robot 0 leaves vision at once, 1 loses images late, 3 leaves after its fall, 4 before."""
    trace = Trace.empty(STEPS, 5)
    trace.forward_velocity[:] = 0.6
    trace.trusted[ONSET + 2 : OVER + 50, :, 0] = False
    trace.has_image[:] = True
    trace.has_image[ONSET + 20 : OVER + 15, 1] = False
    trace.fell[ONSET + 5, 3] = trace.ended[ONSET + 5, 3] = True
    trace.trusted[ONSET + 10 : OVER, :, 3] = False
    trace.trusted[ONSET - 3 : OVER, :, 4] = False
    return trace


def noticed(trace: Trace) -> dict:
    """Who noticed; the paper's selector trusts vision all along."""
    return fault_metrics.noticing(trace, np.ones_like(trace.trusted), ONSET, OVER)


def test_detection_return_and_survival_by_hand():
    five, four = faulty(), faulty().robots(np.arange(4))
    row = noticed(four) | fault_metrics.survival(four, STEPS)
    assert (row["detected"], row["detection_delay_s"]) == (2, pytest.approx((0.045 + 0.405) / 2))
    assert (row["detected_by_paper"], row["paper_detection_delay_s"]) == (0, None)
    assert (row["falls"], row["survival"]) == (1, 0.75)
    # Robot 0 is not back before the run ends, 1 after 15 steps and one update.
    assert (row["recovered"], row["away_at_end"]) == (1, 2)
    assert row["recovery_delay_s"] == pytest.approx(0.305)
    assert row["mean_forward_velocity"] == pytest.approx(0.6 * (3 * 100 + 25) / 400)
    # A robot without vision neither notices nor misses.
    for name in ("vision_active_at_onset", "detected", "detection_delay_s", "detected_by_paper"):
        assert noticed(five)[name] == row[name]
    assert row["vision_active_at_onset"] == 4


@pytest.mark.parametrize(
    ("fault", "severity", "end"),
    [("frozen", 1, 30), ("frozen", 4, 60), ("gaussian", 1, 60), ("mount_knocked", 1, 60)],
)
def test_a_fault_ends_by_itself_or_with_the_study(fault, severity, end):
    assert fault_metrics.end_of(Setting("flat", 0.4, fault, severity), 60) == end


def test_only_what_comes_before_a_fall_counts():
    trusted, gone = np.ones((50, 4, 2), bool), np.zeros((50, 2), bool)
    trusted[30:], gone[25:, 0] = False, True
    np.testing.assert_allclose(fault_metrics.departure(trusted, gone, 20, 50), [np.nan, 0.205])
    # One that starts anew after a fall has not returned to vision.
    trusted[10:31], trusted[31:], gone[:30, 0] = False, True, False
    np.testing.assert_allclose(fault_metrics.departure(~trusted, gone, 20), [np.nan, 0.225])
    # Nothing is seen after the run's end.
    assert np.isnan(fault_metrics.departure(~trusted, gone, 50)).all()


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


def test_every_measure_by_hand():
    measures = fault_metrics.robot_measures(walk(), 20, 0.6, STEPS)
    # Robot 1 stands still for the 40 of 80 steps after its fall.
    steps, speed = np.array([60, 40, np.nan, 80]), np.array([0.8, 0.6, np.nan, 0.6])
    expected = {
        "crossed": [1, 0, 0, 1],
        "upright": [1, 0, 1, 1],
        "speed_error": [0.2, 0.3, 0.6, 0.0],
        "energy_per_metre": 60.0 * steps * 0.02 / (steps * 0.02 * speed),
        "collisions": [0, 1, 2, 0],
        "seconds_without_sight": [0.4, 0, 0, 0],
        "switches": [2, 0, 0, 0],
    }
    assert list(measures) == list(expected)
    for name, values in expected.items():
        np.testing.assert_allclose(measures[name], values, atol=1e-12, err_msg=name)
    longer = fault_metrics.robot_measures(walk(), 20, 0.6, STEPS + 100)
    np.testing.assert_allclose(longer["speed_error"], [0.2, 84 / 180, 0.6, 0.0], atol=1e-12)
    mean = fault_metrics.survival(walk(), STEPS)["mean_forward_velocity"]
    assert mean == pytest.approx((0.8 + 0.36 + 0.0 + 0.6) / 4)  # Robot 0 until it crosses.


def test_changes_are_paired_by_robot():
    values = fault_metrics.robot_measures(walk(), 20, 0.6, STEPS)
    rows = fault_metrics.estimates(values, values | {"speed_error": values["speed_error"] - 0.1})
    assert rows["crossed"]["value"] == 0.5
    assert rows["crossed"]["ci95"] == pytest.approx([0.0676, 0.9324], abs=1e-4)  # Clopper, Pearson.
    assert rows["crossed"]["change"] == {"value": 0.0, "ci95": [0.0, 0.0]}
    # All robots change alike, however different they are.
    assert rows["speed_error"]["change"]["ci95"] == pytest.approx([0.1, 0.1])
    nothing = {name: [np.nan] for name in values}
    assert fault_metrics.estimates(nothing, nothing)["switches"]["value"] is None


def test_twins_and_op_are_matched_robot_by_robot():
    fell, calm, op = (
        {"upright": 1 - np.array(falls)} for falls in ([1, 1, 0, 0], [1, 0, 0, 1], [0, 1, 1, 0])
    )
    assert fault_metrics.pair_counts(fell, calm) == {"falls_by_fault": 1, "falls_spared": 1}
    row = fault_metrics.beside_op(fell, op)
    assert row["over_op_ci95_low"] < row["over_op"] == 0 < row["over_op_ci95_high"]
    assert set(fault_metrics.beside_op(fell, None).values()) == {None}


@pytest.mark.parametrize(("count", "limit"), [(0, 2.996), (1, 4.744), (5, 10.513)])
def test_the_poisson_limit_is_the_textbooks(count, limit):
    mean = metrics.poisson_upper(count)
    assert mean == pytest.approx(limit, abs=1e-3)
    chance = sum(math.exp(-mean) * mean**i / math.factorial(i) for i in range(count + 1))
    assert chance == pytest.approx(0.05)
