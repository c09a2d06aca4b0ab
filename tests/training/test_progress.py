"""A bar and its two lines within 80 columns, and lines in a file, on a clock that is made up."""

import io
import math
from types import SimpleNamespace

import pytest
from rich.console import Console

from renet.training import progress
from renet.training.progress import Report
from tests.clock import Clock

LEVELS = {
    f"Curriculum/level/{kind}": 10.0
    for kind in ("gap", "platform", "stairs_up", "stairs_down", "obstacles", "rough")
}
CURVES = {"Perf/total_fps": 10_110.4, "Train/mean_reward": 12.345}


@pytest.fixture
def clock(monkeypatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(progress, "time", clock)
    return clock


def runner(iteration: int = 0, steps: float = 0.0, **latest: float) -> SimpleNamespace:
    logger = SimpleNamespace(writer=SimpleNamespace(latest=latest))
    return SimpleNamespace(alg=SimpleNamespace(iteration=iteration, steps=steps), logger=logger)


def drawn(report: Report) -> list[str]:
    """The lines that a terminal of 80 columns shows."""
    console = Console(file=io.StringIO(), width=80, force_terminal=True, color_system=None)
    console.print(report.picture())
    return console.file.getvalue().splitlines()


def in_a_file(iterations: int, training, deadline: float = math.inf) -> tuple[Report, io.StringIO]:
    file = io.StringIO()
    return Report(Console(file=file, width=80), training, iterations, deadline), file


def iterate(report: Report, training, clock: Clock, seconds: float) -> None:
    clock.now += seconds
    training.alg.iteration += 1
    report.update()


def test_progress_fits_into_80_columns(clock):
    training = runner(14_900, 231.9e6, **CURVES, **LEVELS)
    report, _ = in_a_file(15_000, training)
    for _ in range(30):
        iterate(report, training, clock, 3600.0)
    first, second = drawn(report)
    assert max(len(first), len(second)) <= 80
    facts = "30% 14930/15000 231.90 M steps 10,110 steps/s 2 days, 22:00:00 left"
    assert first.split()[1:] == facts.split()
    assert second == (
        "gap 10.0 obstacles 10.0 platform 10.0 rough 10.0 stairs_down 10.0 stairs_up 10.0"
    )


def test_a_time_budget_counts_time(clock):
    training = runner(**CURVES)
    report, _ = in_a_file(15_000, training, deadline=clock.now + 20.0)
    for _ in range(3):
        iterate(report, training, clock, 5.0)
    first, second = drawn(report)
    facts = "75% iteration 3 0.00 M steps 10,110 steps/s 0:00:05 left"
    assert first.split()[1:] == facts.split()
    assert second == "reward 12.35", "the plane has no levels"


def test_remaining_time_from_last_iterations(clock):
    training = runner()
    report, _ = in_a_file(1000, training)
    assert "-:--:-- left" in drawn(report)[0], "nobody knows yet"
    for seconds in [1.0] * 30 + [4.0] * 20:
        iterate(report, training, clock, seconds)
    assert "5% 50/1000" in " ".join(drawn(report)[0].split())
    assert "1:03:20 left" in drawn(report)[0], "950 iterations of 4 s"
    clock.now += 2.0
    assert "1:03:18 left" in drawn(report)[0], "it counts between iterations, too"


def test_a_file_gets_a_line_a_minute(clock):
    training = runner(**CURVES, **LEVELS)
    report, file = in_a_file(100, training)
    with report:
        for _ in range(25):
            iterate(report, training, clock, 5.0)
    lines = file.getvalue().splitlines()
    assert [line.split()[0] for line in lines] == ["1/100", "13/100", "25/100"]
    assert lines[1].startswith("13/100  0.00 M steps  10,110 steps/s  0:07:15 left  gap 10.0")


def test_budget_used_up_by_loading(clock):
    training = runner()
    report, _ = in_a_file(10, training, deadline=clock.now - 5.0)
    assert "100%" in drawn(report)[0]
    assert "0:00:00 left" in drawn(report)[0]
