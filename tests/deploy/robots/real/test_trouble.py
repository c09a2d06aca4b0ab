"""What motors say of themselves."""

import math

import numpy as np
import pytest

from renet.deploy.robots.real.braking import PERIOD
from renet.deploy.robots.real.trouble import BEGUN, IN_A_ROW, MotorTrouble
from renet.interface import JOINTS


def watch(modes, lost, steps: int = 500, commanded: float = 0.0) -> str:
    """The first word said of motors whose modes and lost messages are functions of the step."""
    trouble = MotorTrouble()
    for step in range(steps):
        now = step * PERIOD
        values = np.array(modes(step)), np.array(lost(step), np.uint32)
        if word := trouble.look(*values, commanded, now):
            return word
    return ""


def healthy(step: int) -> list[int]:
    return [1] * 12


def none(step: int) -> list[int]:
    return [7] * 12


def one(joint: int, value, otherwise) -> list:
    return [value if n == joint else otherwise for n in range(12)]


@pytest.mark.parametrize(
    ("modes", "lost"),
    [
        (healthy, none),
        (lambda n: [0] * 12 if n * PERIOD < BEGUN else [1] * 12, none),
        (lambda n: one(3, 0, 1) if n == 200 else [1] * 12, none),
        (healthy, lambda n: [10_000] * 12 if n == 200 else [0] * 12),
        (healthy, lambda n: [n // 20] * 12),
        (lambda n: [255] * 12, none),
    ],
)
def test_what_is_usual_or_happens_once_is_no_trouble(modes, lost):
    assert watch(modes, lost) == ""


def test_a_motor_that_leaves_its_mode_is_named():
    left = 300

    def modes(step: int) -> list[int]:
        return one(3, 0, 1) if step >= left else [1] * 12

    assert watch(modes, none) == f"the motor of {JOINTS[3]} has left its mode"
    assert watch(modes, none, left + IN_A_ROW - 1) == ""
    assert watch(modes, none, commanded=-math.inf) == "", "nobody commanded it"


def test_a_motor_that_loses_its_commands_is_named():
    word = watch(healthy, lambda n: one(8, max(n - 250, 0), 3))
    assert word == f"the motor of {JOINTS[8]} loses its commands"
