"""A robot that is as fast as it believes, and one that is not."""

import numpy as np

from renet.deploy.watch.legs import Legs
from renet.deploy.watch.speed import MAX_DIFFERENCE, MIN_READINGS, SpeedWatch
from renet.robots import GO1

from ..fakes import STANDING, state, time_of


def gliding(speed: float) -> np.ndarray:
    """Joint speeds [12] rad/s of feet that go back at a speed, m/s, straight below their hips."""
    legs, step = Legs(GO1), 1e-6
    turns = np.eye(12)
    moved = [
        (legs.feet(STANDING + step * turn, 0.0 * turn)[0] - legs.feet(STANDING, 0 * turn)[0])
        for turn in turns
    ]
    jacobian = np.stack(moved, axis=-1).reshape(12, 12) / step
    return np.linalg.solve(jacobian, np.tile([-speed, 0.0, 0.0], 4))


def watch(speed: float, estimate: float, turn: float = 0.0, steps: int = 200) -> list[str]:
    seen = SpeedWatch(Legs(GO1))
    spin = np.array([0.0, 0.0, turn])
    reading = [
        state(time_of(n), joint_velocity=gliding(speed), angular_velocity=spin)
        for n in range(steps)
    ]
    return [seen.problem(one, np.array([estimate, 0.0, 0.0])) for one in reading]


def test_a_robot_as_fast_as_it_believes_is_believed():
    assert set(watch(0.8, 0.8)) == {""}
    assert set(watch(0.8, 0.8 + 0.9 * MAX_DIFFERENCE)) == {""}


def test_one_that_is_faster_is_not_once_that_is_sure():
    said = watch(1.8, 0.5)
    assert set(said[: MIN_READINGS - 1]) == {""}
    assert said[-1].startswith("the legs move 1.3 m/s faster or slower than the policy believes")


def test_the_past_is_forgotten():
    seen = SpeedWatch(Legs(GO1))
    for n in range(3 * MIN_READINGS):
        if n % (MIN_READINGS - 1) == 0:
            seen.start_over()
        reading = state(time_of(n), joint_velocity=gliding(3.0))
        assert seen.problem(reading, np.zeros(3)) == ""
