"""When memory is stale: simulated hazards whose answer is known."""

from dataclasses import replace

import numpy as np
import pytest

from renet.bundle import write_bundle
from renet.evaluation import calibrate_memory
from renet.evaluation.calibrate_memory import MEASURED_TIME, MEMORY, limits_of_trace
from renet.evaluation.evaluator import Evaluator
from renet.evaluation.rollout import Rollout
from renet.evaluation.trace import Trace

ROBOTS, STEPS = 400, 500


def test_robots_walk_from_memory_and_twins_with_op(tmp_path, models, manifest, monkeypatch):
    monkeypatch.setattr(calibrate_memory, "BLACKOUT_RANGE", (0.1, 0.2))
    monkeypatch.setattr(calibrate_memory, "MEASURED_TIME", 0.6)
    spec = replace(manifest.selector, beta=0.25, longest_memory=0.1)
    path = write_bundle(tmp_path / "b", models, replace(manifest, selector=spec))
    traces: list[Trace] = []
    run = Rollout.run
    monkeypatch.setattr(Rollout, "run", lambda *a, **k: traces.append(run(*a, **k)) or traces[0])
    assert calibrate_memory.memory_limits(Evaluator(path), 6, 2, 0.6, 3)[1] == 0.6
    (trace,) = traces
    assert trace.vision[:, :6].all(), "its own limit does not end the memory"
    assert not trace.vision[:, 6:].any()
    assert trace.has_image[:5, :6].all()
    assert not trace.has_image[15:, :6].any()


def walk(hazard) -> Trace:
    """Robots that fall with a probability in each step [T, N], then their twins with OP."""
    random = np.random.default_rng(2)
    trace = Trace.empty(STEPS, 2 * ROBOTS)
    trace.fell[:] = trace.ended[:] = random.random((STEPS, 2 * ROBOTS)) < np.hstack(
        [hazard, np.full((STEPS, ROBOTS), 0.002)]
    )
    return trace


def test_limits_of_a_run_whose_robots_fall_where_they_err_or_never():
    dies = np.full(ROBOTS, 50)
    since = np.maximum(np.arange(STEPS)[:, None] - dies, 0)
    error = 0.05 + 0.001 * since  # 0.5 m after nine seconds.
    late = walk(np.where(error > 0.3, 0.02, 0.0005))
    late.map_error[:, :ROBOTS] = error
    ground = np.arange(ROBOTS) % 7
    thresholds, longest = limits_of_trace(late, dies, ground)
    # Half a second before the falls: 25 steps, 0.025 m.
    assert thresholds[MEMORY] == pytest.approx(0.275, abs=0.02)
    assert longest == pytest.approx(250 * 0.02, abs=0.3)
    never = walk(np.full((STEPS, ROBOTS), 0.0005))
    never.map_error[:, :ROBOTS] = error
    assert limits_of_trace(never, dies, ground) == ({}, MEASURED_TIME)
