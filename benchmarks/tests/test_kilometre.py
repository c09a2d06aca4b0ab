"""The paper's long walk: where sections lie, who fails where, and what is counted."""

from pathlib import Path

import numpy as np
import pytest
import torch

from paper.kilometre import (
    RUN_UP,
    SECTIONS,
    SET_DOWN,
    KilometreStudy,
    Lap,
    LapEnv,
    SectionFaults,
    total,
)
from renet.errors import RenetError
from renet.evaluation.trace import StepResult
from renet.faults import Frames

LAP = Lap()


def test_sections_begin_where_the_last_one_ends():
    first_edges = iter(LAP.course.edges[:, 0])
    for section, start in zip(SECTIONS, LAP.starts, strict=False):
        edges = [next(first_edges) for _ in section.obstacles]
        assert edges[0] == pytest.approx(start + RUN_UP)
    assert LAP.starts[-1] == pytest.approx(LAP.course.edges[-1, 1])
    # What goes up comes down.
    assert LAP.course.walking_height(LAP.starts)[-1] == pytest.approx(0.0)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"modes": ()}, "modes none"),
        ({"modes": ("memory", "memory")}, "modes has memory more than once"),
        ({"modes": ("memory",), "film": Path("lap.webp")}, "two modes side by side"),
        ({"film": Path("lap.mp4")}, "give --film lap.webp"),
    ],
)
def test_what_cannot_be_counted_or_filmed_is_refused_before_the_walk(settings, message):
    with pytest.raises(RenetError, match=message):
        KilometreStudy(**settings)


class Robot:
    """Stands in for the simulation: is where it is put, or where it is set down."""

    num_robots = 1
    perturb_cameras = poses = None

    def __init__(self):
        self.fell = False
        self.env = self
        self.scene = self
        self.env_origins = torch.zeros(1, 3)

    def place_on(self, names):
        pass

    def reset(self):
        return self.step(None)

    def step(self, action):
        one = np.ones(1)
        ended = np.array([self.fell])
        return StepResult(
            proprioception=one,
            depth=one,
            angular_velocity=one,
            forward_velocity=one,
            travelled=one,
            collisions=one,
            power=one,
            fell=ended,
            ended=ended.copy(),
        )


class Walked(LapEnv):
    """Without a simulation."""

    where = 0.0
    height = 0.3

    def _place(self):
        return np.array([self.where]), np.zeros(1), np.array([self.height])

    def _steer(self):
        pass

    def _set_down(self, mask):
        if mask.any():
            self.set_down = True


@pytest.fixture
def lap():
    env = Walked(Robot(), LAP)
    env.reset()
    return env


def go(env, where, fell=False, height=None):
    env.where = where
    env.height = (
        0.3 + float(LAP.course.walking_height(np.array(where))) if height is None else height
    )
    env._inner.fell = fell
    return env.step(None)


def test_a_walk_is_counted_section_by_section(lap):
    for where in np.arange(0.1, LAP.starts[-1] + 0.1, 0.1):
        go(lap, where)
    assert lap.finished.all()
    assert set(lap.ends[0]) == {"crossed"}
    assert lap.metres[0] == pytest.approx(LAP.starts[-1], abs=0.2)


def test_a_fall_is_counted_where_it_happens_and_the_next_section_begins(lap):
    go(lap, 5.0)
    assert lap.section == [1]
    result = go(lap, 5.1, fell=True)
    assert result.ended.all()
    assert lap.ends[0, 1] == "fell"
    assert lap.section == [2]
    assert lap.position == pytest.approx(LAP.starts[2] + SET_DOWN)
    # Being set down is no way walked.
    assert lap.metres[0] == pytest.approx(5.0)


def test_robots_are_set_down_on_level_ground_that_their_cameras_still_see(lap):
    # A Go1's feet are up to 0.3 m before and behind its base.
    feet = np.linspace(-0.3, 0.3, 13)
    for number, start in enumerate(LAP.starts[:-1]):
        heights = LAP.course.walking_height(start + SET_DOWN + feet)
        assert np.ptp(heights) == 0.0
        edges = LAP.course.edges
        inside = (edges[:, 0] < start + SET_DOWN + 0.3) & (edges[:, 1] > start + SET_DOWN - 0.3)
        assert not inside.any(), SECTIONS[number].name
    go(lap, LAP.starts[-2] - 0.1, fell=True)
    assert not SectionFaults(lap, LAP, [0], seed=1).at_work(0).any()


def test_a_body_in_a_gap_has_fallen_and_is_set_down(lap):
    gap = LAP.course.edges[[o.kind for o in LAP.course.obstacles].index("gap"), 0]
    go(lap, gap - 0.1)
    assert go(lap, gap + 0.2, height=-0.4).fell.all()
    assert lap.set_down


def test_who_stands_is_stuck(lap):
    for _ in range(1252):
        go(lap, 1.0)
    assert lap.ends[0, 0] == "stuck"
    assert lap.section == [1]


def test_cameras_fail_in_their_sections(lap):
    faults = SectionFaults(lap, LAP, [0], seed=1)
    number = [section.name for section in SECTIONS].index("covered lens, gap")
    image = np.full((1, 48, 64), 0.8, np.float32)

    def shown():
        return faults.apply(Frames.healthy(image), 0).image.mean()

    lap.section[:], lap.position[:] = number, LAP.starts[number] + 0.4
    assert shown() == pytest.approx(0.8)
    lap.position[:] = LAP.starts[number] + 0.6
    assert shown() == pytest.approx(0.02)
    lap.section[:], lap.position[:] = 2, LAP.starts[2] + 1.0
    assert shown() == pytest.approx(0.8)


def test_falls_per_kilometre_have_an_exact_interval():
    run = {"metres": 500.0, "ends": ["fell", "crossed"], "sees": 0.5, "remembers": 0.2}
    found = total([run | {"blind": 0.3}, run | {"blind": 0.1, "ends": ["stuck", "fell"]}])
    assert (found["falls"], found["stuck"], found["falls_per_km"]) == (2, 1, 2.0)
    # The textbook's limits of two events: 0.242 and 7.225.
    assert found["ci95_low"] == pytest.approx(0.2422, abs=1e-3)
    assert found["ci95_high"] == pytest.approx(7.2247, abs=1e-3)
    assert found["blind"] == pytest.approx(0.2)
