"""Breaches of what must hold of a robot, each of which the soak must find."""

import warnings
from types import SimpleNamespace

import numpy as np
import pytest

from promises import Promises, watch_warnings
from renet.deploy.controller import Event
from renet.deploy.robots.base import JointCommand
from renet.deploy.robots.real.braking import SILENCE
from renet.deploy.safety.machine import Mode
from renet.robots import GO1

STANDING = np.tile([0.1, 0.9, -1.8, -0.1, 0.9, -1.8], 2)


def command(position=STANDING, stiffness=40.0, damping=1.0) -> JointCommand:
    return JointCommand(np.array(position), np.full(12, stiffness), np.full(12, damping))


def changed(value: float) -> np.ndarray:
    """A pose with one joint elsewhere."""
    position = STANDING.copy()
    position[7] = value
    return position


@pytest.fixture
def machine() -> SimpleNamespace:
    return SimpleNamespace(mode=Mode.DAMPING, since=0.0)


@pytest.fixture
def link() -> SimpleNamespace:
    return SimpleNamespace(problem="")


@pytest.fixture
def promises(machine, link) -> Promises:
    watched = Promises(GO1)
    watched.begin(SimpleNamespace(machine=machine), link)
    return watched


@pytest.mark.parametrize(
    ("sent", "breach"),
    [
        (command(), None),
        (command(stiffness=100.0, damping=10.0), None),
        (command(changed(np.nan)), "a command is not finite"),
        (command(damping=np.inf), "a command is not finite"),
        (command(changed(5.0)), "a joint target is outside of its range"),
        (command(stiffness=101.0), "a gain is outside of its range"),
        (command(stiffness=-1.0), "a gain is outside of its range"),
        (command(damping=11.0), "a gain is outside of its range"),
    ],
)
def test_a_command_beyond_the_envelope_is_a_breach(promises, machine, sent, breach):
    machine.mode = Mode.WALKING
    promises.sent(sent, 1.0)
    assert list(promises.broken) == ([] if breach is None else [breach])


def test_a_braked_robot_may_not_be_driven(promises, machine, link):
    promises.sent(command(stiffness=0.0), 9.0)
    promises.sent(command(), SILENCE / 2)
    assert not promises.broken, "the last command before the brake may still be on its way"
    promises.sent(command(), SILENCE + 0.01)
    assert promises.broken == {"a braked robot is driven": 1}
    machine.mode = Mode.WALKING
    link.problem = "another robot answers"
    promises.sent(command(), 1.0)
    assert promises.broken["a robot braked for good is driven"] == 1
    assert promises.first["a braked robot is driven"] == pytest.approx(0.11)


@pytest.mark.parametrize(
    ("why", "whole"),
    [
        ("the gyroscope is frozen", True),
        ("OSError: no device", True),
        ("", False),
        ("two\nlines", False),
        ("long " * 100, False),
        ("IndexError: list index out of range", False),
        ("the robot takes no commands: TypeError: not a number", False),
    ],
)
def test_the_operator_is_told_in_one_line_without_an_exception(promises, why, whole):
    promises.event(Event(1.0, "robot", why))
    assert bool(promises.broken) is not whole


def test_a_robot_rises_only_when_it_is_armed_and_says_so(promises, machine):
    def step(mode: Mode, armed: bool = False, told: bool = True, stiffness: float = 0.0) -> list:
        promises.broken.clear()
        if told:
            promises.event(Event(1.0, mode, "why"))
        machine.mode = mode
        promises.step(command(stiffness=stiffness), armed)
        return list(promises.broken)

    assert step(Mode.DAMPING, told=False) == []
    assert step(Mode.STANDING_UP, armed=True) == []
    assert step(Mode.WALKING) == []
    assert step(Mode.DAMPING, told=False) == ["nobody was told of damping"]
    assert step(Mode.DAMPING) == []
    assert step(Mode.DAMPING, stiffness=1.0) == ["a braked robot is commanded"]
    assert step(Mode.STANDING_UP) == ["from damping to standing_up without being armed"]
    assert step(Mode.DAMPING) == []
    assert step(Mode.WALKING, armed=True) == ["from damping to walking without being armed"]


def test_a_refusal_is_told(promises):
    promises.step(command(stiffness=0.0), armed=True)
    assert list(promises.broken) == ["nobody was told why the robot does not stand up"]
    promises.event(Event(1.0, "refused", "the battery is empty"))
    promises.step(command(stiffness=0.0), armed=True)
    assert promises.broken.total() == 1


def test_warnings_and_failures_of_the_checks_are_kept(promises):
    with warnings.catch_warnings():
        watch_warnings(promises)
        warnings.warn("invalid value", RuntimeWarning, stacklevel=1)
    with pytest.raises(KeyError), promises.checked():
        raise KeyError("mode")
    assert list(promises.broken) == [
        "a warning: RuntimeWarning: invalid value",
        "a check failed: KeyError: 'mode'",
    ]
