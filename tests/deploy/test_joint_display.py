"""What the joint-order check says, against the kinematics of the model."""

import mujoco
import numpy as np
import pytest

from renet.deploy.joint_display import TURN, WAYS, JointDisplay
from renet.interface import JOINTS

from .fakes import STANDING, robot_on, state, turned


@pytest.fixture
def watched():
    """A display that has seen the default pose, and what it said."""
    said = []
    display = JointDisplay(said.append)
    display.step(state())
    return display, said


def test_each_joint_by_name_once_per_turn_and_nothing_before(watched):
    display, said = watched
    for reading in (state(joint_position=STANDING + 0.9 * TURN), None, state()):
        display.step(reading)
        assert said == []
    for joint, name in enumerate(JOINTS):
        position = STANDING.copy()
        position[joint] -= 1.2 * TURN
        for _ in range(2):
            display.step(state(joint_position=position))
        assert len(said) == 1
        assert said.pop().startswith(f"{name.removesuffix('_joint')} -0.30 to ")
        display.step(state())
        assert said.pop().startswith(f"{name.removesuffix('_joint')} +0.30 to ")


@pytest.mark.parametrize("name", JOINTS)
def test_the_words_are_what_the_model_does(name):
    """Turn one joint of the standing model and see where its foot goes, in the base frame."""
    leg, part, _ = name.split("_")

    def foot(turn: float) -> tuple[np.ndarray, float]:
        robot = robot_on()
        data = robot.data
        data.joint(name).qpos += turn
        mujoco.mj_forward(robot.model, data)
        at = data.geom(f"{leg}_foot_collision").xpos
        return at.copy(), float(np.linalg.norm(at - data.body(f"{leg}_thigh").xpos))

    (before, reach), (after, further) = foot(0.0), foot(0.1)
    left, back = after[1] > before[1], after[0] < before[0]
    expected = {
        "foot moves to the robot's left": left and part == "hip",
        "foot moves back": back and part == "thigh",
        "knee straightens": further > reach,
    }
    assert expected[WAYS[part][0]]


@pytest.mark.parametrize(
    ("end", "axis", "degrees"),
    [("nose", "y", 30), ("tail", "y", -30), ("left side", "x", -30), ("right side", "x", 30)],
)
def test_which_end_is_down(watched, end, axis, degrees):
    display, said = watched
    for _ in range(2):
        display.step(state(quaternion=turned(axis, degrees)))
    assert said == [f"the base leans: {end} down"]


def test_a_lean_that_shakes_about_the_limit_is_told_once(watched):
    display, said = watched
    limit = np.degrees(np.arcsin(TURN))
    for step in range(50):
        display.step(state(quaternion=turned("y", limit + 0.5 * (-1) ** step)))
    assert said == ["the base leans: nose down"]
    for degrees in (0.0, limit + 0.5):
        display.step(state(quaternion=turned("y", degrees)))
    assert said == 2 * ["the base leans: nose down"]
