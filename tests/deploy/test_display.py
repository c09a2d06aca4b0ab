"""The operator's line, from decisions made by hand."""

from dataclasses import replace

import numpy as np
import pytest

from renet.deploy.controller import Decision
from renet.deploy.display import SHOW_EVERY, VelocityDisplay
from renet.deploy.safety.machine import Mode
from renet.deploy.teleop.base import Velocity

from .fakes import state


@pytest.fixture
def walking(run) -> Decision:
    """To walk by vision, asked for less than what is walked."""
    return replace(
        run.controller.decision,
        mode=Mode.WALKING,
        vision=True,
        has_image=True,
        asked=Velocity(-0.6, 0.3, 0.5),
        followed=Velocity(0.6, -0.1, 0.5),
        velocity_vp=np.array([0.7, -0.05, 0.0]),
        velocity_op=np.array([9.0, 9.0, 9.0]),
    )


@pytest.fixture
def display() -> tuple[VelocityDisplay, list[str]]:
    lines: list[str] = []
    return VelocityDisplay(lines.append), lines


def test_the_velocity_followed_stands_beside_the_one_walked(display, walking):
    velocity, lines = display
    turning = state(angular_velocity=np.array([0.0, 0.0, 0.4]))
    for _ in range(200):
        velocity.step(walking, turning)
    told = "sees; told +0.60 ahead -0.10 left m/s +0.50 rad/s"
    assert lines[-1] == f"{told}; walks +0.70 ahead -0.05 left m/s +0.40 rad/s"
    assert len(lines) == 200 / SHOW_EVERY


def test_the_estimator_that_drives_is_shown_and_a_gait_is_smoothed(display, walking):
    velocity, lines = display
    blind = replace(walking, vision=False)
    for step in range(200):
        swing = np.array([0.5 + 0.4 * (-1) ** step, 0.0, 0.0])
        velocity.step(replace(blind, velocity_op=swing), state())
    assert "walks +0.5" in lines[-1]


def test_a_robot_that_does_not_walk_shows_its_mode(display, walking):
    velocity, lines = display
    for mode in (Mode.DAMPING, Mode.STANDING_UP):
        for _ in range(SHOW_EVERY):
            velocity.step(replace(walking, mode=mode), None)
    assert lines == ["damping", "standing_up"]


def test_numbers_that_are_none_do_not_stay(display, walking):
    velocity, lines = display
    velocity.step(replace(walking, velocity_vp=np.full(3, np.nan)), None)
    for _ in range(200):
        velocity.step(walking, state())
    assert "walks +0.70" in lines[-1]


@pytest.mark.parametrize(
    ("vision", "has_image", "state"),
    [(True, True, "sees"), (True, False, "remembers"), (False, True, "blind")],
)
def test_sight_is_named(display, walking, vision, has_image, state):
    velocity, lines = display
    velocity.step(replace(walking, vision=vision, has_image=has_image), None)
    assert lines[0].startswith(f"{state}; told ")
