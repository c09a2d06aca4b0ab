"""Motors that obey, and others, against torques that commands ask for."""

from types import SimpleNamespace

import numpy as np
import pytest

from renet.deploy.watch.motors import ABSURD_READINGS, LONG_WINDOW, SHORT_WINDOW, MotorWatch

from ..fakes import STANDING, command, state, time_of

TORQUE, SPEED = np.tile([23.7, 23.7, 35.55], 4), np.full(12, 20.0)


def swing(step: int) -> np.ndarray:
    """Targets [12] rad of a walk."""
    return STANDING + 0.3 * np.sin(0.6 * step + np.arange(12))


def watch(motor, steps: int = 120) -> str:
    """What is said of a robot whose motors make [12] N m of what is asked, at once if anything."""
    motors = MotorWatch(TORQUE, SPEED, 0.12)
    said = ""
    for step in range(steps):
        told = command(swing(step))
        speed = 2.0 * np.cos(0.5 * step + np.arange(12))
        asked = np.clip(40.0 * (told.position - STANDING) - speed, -TORQUE, TORQUE)
        motors.told(told)
        reading = state(time_of(step), joint_velocity=speed, joint_torque=motor(asked, step))
        said = said or motors.problem(reading)
    return said


def one(joint: int, value) -> np.ndarray:
    """A share [12] of what is asked for: all of it, but for one joint."""
    share = np.ones(12)
    share[joint] = value
    return share


@pytest.mark.parametrize(
    "motor",
    [
        lambda asked, step: asked,
        lambda asked, step: 0.6 * asked,
        lambda asked, step: one(3, 0.45) * asked,
        lambda asked, step: asked + 3.0 * np.sin(step),
        lambda asked, step: np.zeros(12),  # A robot that measures none.
    ],
)
def test_motors_that_do_about_what_they_are_told_are_believed(motor):
    assert watch(motor) == ""


@pytest.mark.parametrize(
    ("motor", "steps", "reason"),
    [
        (
            lambda a, n: one(1, 0.0) * a,
            SHORT_WINDOW,
            "FR_thigh_joint does not obey: its motor gives no",
        ),
        (
            lambda a, n: one(5, 0.0) * a,
            SHORT_WINDOW,
            "FL_calf_joint does not obey: its motor gives no",
        ),
        (lambda a, n: one(4, 0.25) * a, LONG_WINDOW, "FL_thigh_joint is too weak"),
        # As much as half of what is asked for, but against it.
        (lambda a, n: one(4, -0.5) * a, LONG_WINDOW, "FL_thigh_joint is too weak"),
        (
            lambda a, n: a + 40.0 * (np.arange(12) == 8),
            SHORT_WINDOW,
            "RR_calf_joint does not obey: it gives",
        ),
        (lambda a, n: -3.0 * a, SHORT_WINDOW, "does not obey: it gives"),
        (
            lambda a, n: 1e9 + 0.0 * a,
            ABSURD_READINGS,
            "FR_hip_joint says 1e+09 N m, which no motor",
        ),
    ],
)
def test_a_motor_that_does_not_is_named_in_time(motor, steps, reason):
    assert reason in watch(motor, steps)
    assert watch(motor, steps - 1) == "", "not by a single odd reading, nor sooner than calibrated"


@pytest.mark.parametrize("torque", [60.0, 1e9])
def test_one_absurd_torque_is_a_mistake(torque):
    assert watch(lambda asked, step: asked + torque * (step == 40)) == ""


def test_what_was_before_is_forgotten():
    motors = MotorWatch(TORQUE, SPEED, 0.12)
    for step in range(2 * SHORT_WINDOW):
        if step % (SHORT_WINDOW - 1) == 0:
            motors.start_over()
        motors.told(command(swing(step)))
        reading = state(time_of(step), joint_torque=0.0 * TORQUE + (step == 0))
        assert motors.problem(reading) == ""


@pytest.mark.parametrize("every", [1, 2])
def test_a_joint_beyond_its_speed_is_not_compared(every):
    """Drivers only brake it, and go on until they hear that it is slower."""
    motors = MotorWatch(TORQUE, np.full(12, 1.0), 0.12)
    for step in range(3 * SHORT_WINDOW):
        motors.told(command(swing(step)))
        speed = np.full(12, 2.0 * (step % every == 0))
        fast = SimpleNamespace(
            joint_position=STANDING, joint_velocity=speed, joint_torque=np.full(12, 0.1)
        )
        assert motors.problem(fast) == ""
