import numpy as np
import pytest

from renet.identification import replay
from renet.identification.fit import (
    END_STOP,
    MotorFitter,
    per_joint,
    per_kind,
    standard_error,
    valid_rows,
)
from renet.identification.motion_log import MotionLog
from renet.identification.replay import DELAY, SuspendedRobot
from renet.interface import JOINTS
from renet.robots import GO2

from .conftest import KD, KP

ROWS = range(20, 180)


@pytest.fixture
def log(motion) -> MotionLog:
    gains = {"stiffness": np.full(12, KP), "damping": np.full(12, KD)}
    return MotionLog(
        0.005, **{name: values[:200].copy() for name, values in motion.items()}, **gains
    )


@pytest.fixture
def robot(log) -> SuspendedRobot:
    return SuspendedRobot(GO2, log, 0.005)


def test_a_delay_of_whole_rows_is_a_shift(robot, log):
    table = robot.described_motors
    table[:, DELAY] = 3 * log.period
    late = robot.replay([table], ROWS)[0]
    log.target[3:] = log.target[:-3].copy()
    shifted = SuspendedRobot(GO2, log, 0.005).replay([robot.described_motors], ROWS)[0]
    np.testing.assert_allclose(late, shifted, atol=1e-9)
    assert np.abs(late - robot.replay([robot.described_motors], ROWS)[0]).max() > 0.01


def test_parts_of_a_replay_are_one(robot, monkeypatch):
    tables = [robot.described_motors, 1.5 * robot.described_motors]
    whole = robot.replay(tables, ROWS)
    monkeypatch.setattr(replay, "CHUNK_STEPS", 7)
    np.testing.assert_allclose(robot.replay(tables, ROWS), whole, atol=1e-6)


@pytest.mark.parametrize("groups", [3, 12])
def test_jacobian_is_that_of_one_parameter_at_a_time(robot, log, groups):
    fitter = MotorFitter(robot, log, ROWS, lambda line: None)
    motors = robot.described_motors[:groups] * np.linspace(0.8, 1.2, groups)[:, None]
    motors[:, DELAY] = 0.004
    jacobian = fitter.jacobian(motors.ravel())
    base = fitter.errors(motors.ravel())
    for place, step in enumerate(np.tile([1e-4, 2e-3, 3e-3, 3e-5], groups)):
        varied = motors.ravel().copy()
        varied[place] += step
        slope = (fitter.errors(varied) - base) / step
        np.testing.assert_allclose(jacobian[:, place], slope, atol=1e-5 * np.abs(slope).max())


def test_kinds_are_spread_over_legs():
    kinds = np.arange(12.0).reshape(3, 4)
    joints = per_joint(kinds)
    np.testing.assert_array_equal(joints, np.tile(kinds, (4, 1)))
    joints[:3] += 4.0
    np.testing.assert_array_equal(per_kind(joints), kinds + 1.0)


def test_rows_at_an_end_stop_are_invalid(robot, log):
    joint = JOINTS.index("RL_calf_joint")
    log.target[50:53, joint] = robot.upper[joint] + 0.01
    expected = np.ones((200, 12), bool)
    expected[50 : 53 + round(END_STOP / log.period), joint] = False
    np.testing.assert_array_equal(valid_rows(robot, log), expected)


def test_standard_error_of_independent_errors_is_the_textbooks():
    rng = np.random.default_rng(0)
    jacobian = rng.normal(size=(40_000, 3)) * [1.0, 10.0, 0.1]
    errors = 0.02 * rng.normal(size=40_000)
    found = standard_error(errors, jacobian, 20)
    textbook = 0.02 * np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    np.testing.assert_allclose(found, textbook, rtol=0.1)
    # Ten rows that say the same are one.
    repeated = standard_error(np.repeat(errors, 10), np.repeat(jacobian, 10, axis=0), 200)
    np.testing.assert_allclose(repeated, found, rtol=1e-6)
