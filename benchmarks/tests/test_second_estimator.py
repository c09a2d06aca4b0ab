"""What OP adds: intervals over trainings, and VP that is never handed over."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import scipy

import second_estimator
from renet.bundle import Bundle
from renet.errors import RenetError
from renet.evaluation.trace import Trace
from renet.interface import CONTROL_DT
from renet.selector.monitors import SelectorInput
from second_estimator import (
    DEAD,
    FAULTS,
    HEALTHY,
    Cfg,
    NeverHandedOver,
    difference,
    falls_per_minute,
    main,
    mean_interval,
    schedules,
    summarise,
)


def test_intervals_over_trainings_are_students():
    # t of 0.975 with 2 degrees of freedom is 4.303 (any table of Student's t).
    interval = mean_interval([0.5, 0.6, 0.7])
    half = 4.303 * 0.1 / np.sqrt(3)
    assert interval["mean"] == pytest.approx(0.6)
    assert [interval["low"], interval["high"]] == pytest.approx([0.6 - half, 0.6 + half], rel=1e-3)


def test_a_difference_of_equal_spreads_has_four_degrees_of_freedom():
    # t of 0.975 with 4 degrees of freedom is 2.776.
    interval = difference([0.5, 0.6, 0.7], [0.2, 0.3, 0.4])
    half = 2.776 * 0.1 * np.sqrt(2 / 3)
    assert interval["mean"] == pytest.approx(0.3)
    assert [interval["low"], interval["high"]] == pytest.approx([0.3 - half, 0.3 + half], rel=1e-3)


def test_welchs_interval_is_that_of_scipy():
    first, second = [0.5, 0.8, 0.7], [0.2, 0.3]
    expected = scipy.stats.ttest_ind(first, second, equal_var=False).confidence_interval()
    interval = difference(first, second)
    assert [interval["low"], interval["high"]] == pytest.approx([*expected])


def test_trainings_without_any_spread_have_a_mean_alone():
    assert difference([0.5, 0.5], [0.2, 0.2]) == pytest.approx(
        {"mean": 0.3, "low": 0.3, "high": 0.3}
    )


def test_falls_are_counted_in_first_tries_from_a_step_on():
    trace = Trace.empty(100, 3)
    # The first robot falls before the step, the second after it and again in its second try.
    for robot, step in ((0, 10), (1, 60), (1, 80)):
        trace.fell[step, robot] = True
        trace.ended[step, robot] = True
    minutes = (11 + 50) * CONTROL_DT / 60.0
    assert falls_per_minute(trace, 50) == pytest.approx(1 / minutes)


def test_rows_compare_trainings_of_both_with_those_of_vision_alone():
    def run(crossed: float, falls: float) -> dict:
        return {"crossed": {HEALTHY: crossed, DEAD: crossed / 2}, "falls_per_minute": falls}

    results = {
        "both": [run(0.8, 1.0), run(0.6, 2.0)],
        "vision_alone": [run(0.5, 4.0), run(0.5, 5.0)],
    }
    rows = {row["measure"]: row for row in summarise(results)}
    assert [*rows] == [HEALTHY, DEAD, "falls_per_minute"]
    assert rows[HEALTHY]["both"]["mean"] == pytest.approx(0.7)
    assert rows[DEAD]["adds"]["mean"] == pytest.approx(0.1)
    assert rows["falls_per_minute"]["adds"]["mean"] == pytest.approx(-3.0)


def test_a_camera_is_dead_from_the_start_and_others_fail_before_the_edge():
    cameras = schedules(0.6)
    assert [*cameras] == [HEALTHY, *FAULTS, DEAD]
    assert cameras[HEALTHY] == ()
    assert cameras[DEAD][0].onset == 0
    # The nearest edge is 1.2 m away: half a second before it is 1.5 s after the start.
    assert cameras["frozen"][0].onset == pytest.approx(1.5 / CONTROL_DT, abs=1)


def test_vp_is_never_handed_over_however_old_its_memory_is():
    evaluator = NeverHandedOver()
    limits = {"map_error": 0.01, "disagreement": 0.01}
    manifest = evaluator.bundle.manifest
    selector = replace(manifest.selector, thresholds=limits, longest_memory=1.0)
    changed = replace(manifest, selector=selector)
    evaluator.bundle = SimpleNamespace(manifest=changed)  # type: ignore[assignment]
    never = evaluator.make_selector("memory", 1)
    without_image = SelectorInput(
        anomaly_score=np.zeros(1),
        image=np.zeros((1, 48, 64)),
        fresh=np.zeros(1, bool),
        age=np.full(1, 99.0),
        invalid=np.zeros(1),
        velocity_op=np.ones((1, 3)),
        velocity_vp=np.zeros((1, 3)),
        surprise=np.zeros(1),
        has_image=np.zeros(1, bool),
        map_error=np.full(1, 9.0),
    )
    for step in range(200):
        assert not never.look(without_image).acceptable.any()
        assert never.update(without_image, step * CONTROL_DT).all()


def test_a_single_training_has_no_interval():
    with pytest.raises(RenetError, match="two bundles of each kind"):
        main(Cfg((Path("go1-parkour"),), (Path("go1-parkour"),)))


def test_robots_walk_with_every_kind_of_camera_and_pilot(tmp_path: Path, monkeypatch):
    monkeypatch.setattr(second_estimator, "FAULTS", ("blackout",))
    monkeypatch.setattr(second_estimator, "SECONDS", 4.0)
    out = tmp_path / "rows.json"
    bundle = Bundle.load().path
    cfg = Cfg((bundle, bundle), (bundle, bundle), out, robots=1, levels={"gap": 1})
    main(cfg)
    assert '"measure": "dead from the start"' in out.read_text()
