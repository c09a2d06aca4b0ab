"""What each adapter makes of a robot that stands, and of its model's answer."""

import numpy as np
import pytest

from renet.bundle import pretrained, read_manifest
from renet.evaluation.adapters import evaluator, himloco, playground, robogauge, robot_lab
from renet.evaluation.adapters.base import LEFT_FIRST, Senses
from renet.interface import JOINTS


class Recorder:
    """A model that keeps its inputs, and moves one joint."""

    name = "recorder"

    def __init__(self, moved):
        self.answer = np.zeros((1, 12), np.float32)
        self.answer[0, moved] = 1.0
        self.seen = []
        self.resets = []

    def run(self, *inputs, robot=0, method="forward"):
        self.seen.append(inputs)
        return [np.repeat(self.answer, len(inputs[0]), axis=0)]

    def reset(self, robot):
        self.resets.append(robot)


def senses(joints, count=2):
    def repeated(values):
        return np.tile(np.array(values, np.float32), (count, 1))

    return Senses(
        angular_velocity=repeated((0.4, 0.0, 0.0)),
        gravity=repeated((0.0, 0.0, -1.0)),
        command=repeated((0.5, 0.0, 0.2)),
        joint_position=repeated(joints),
        joint_velocity=repeated([2.0, *[0.0] * 11]),
        depth=np.full((count, 48, 64), 2.0, np.float32),
        velocity=repeated((0.3, 0.0, 0.0)),
        feet_contact=np.ones((count, 4), bool),
    )


MODULES = {
    "playground": (playground, 48),
    "himloco": (himloco, 6 * 45),
    "robogauge": (robogauge, 45),
    "robot-lab": (robot_lab, 45),
}


def pose_of(module):
    """Of the module, in our order."""
    pose = module.Adapter.pose
    return pose[LEFT_FIRST] if module in (himloco, robogauge) else pose


@pytest.mark.parametrize("name", MODULES)
def test_inputs_have_the_policys_size_and_scales(name):
    module, size = MODULES[name]
    model = Recorder(0)
    adapter = evaluator.find_adapter(name)(model, 2)
    adapter.act(senses(pose_of(module)))
    seen = model.seen[0][0]
    assert seen.shape[1] == size
    # In its own pose all joints are at zero; the first joint of the right leg turns.
    numbers = np.sort(np.abs(seen[0][seen[0] != 0.0]))
    assert 1.0 in numbers
    speeds = {"playground": 2.0}.get(name, 0.1)
    assert speeds in np.round(numbers, 6)


@pytest.mark.parametrize("name", MODULES)
def test_an_action_moves_the_joint_that_it_is_for(name):
    module, _ = MODULES[name]
    # The first number is of FR's hip, where left legs come first of FL's.
    moved = JOINTS.index("FL_hip_joint" if module in (himloco, robogauge) else "FR_hip_joint")
    adapter = evaluator.find_adapter(name)(Recorder(0), 2)
    target = adapter.act(senses(pose_of(module)))
    change = target - pose_of(module)
    scale = np.atleast_1d(module.Adapter.action_scale)[0]
    expected = np.zeros((2, 12))
    expected[:, moved] = scale
    np.testing.assert_allclose(change, expected, atol=1e-6)


def test_last_actions_are_fed_back_and_forgotten():
    model = Recorder(3)
    adapter = robot_lab.Adapter(model, 2)
    for _ in range(2):
        adapter.act(senses(robot_lab.Adapter.pose))
    np.testing.assert_array_equal(model.seen[1][0][:, -12:], np.repeat(model.answer, 2, axis=0))
    adapter.reset(np.array([True, False]))
    adapter.act(senses(robot_lab.Adapter.pose))
    assert model.seen[2][0][0, -9] == 0.0
    assert model.seen[2][0][1, -9] == 1.0


def test_a_history_begins_with_the_first_observation():
    model = Recorder(0)
    adapter = himloco.Adapter(model, 1)
    adapter.act(senses(pose_of(himloco), 1))
    history = model.seen[0][0].reshape(6, 45)
    np.testing.assert_array_equal(history, np.tile(history[0], (6, 1)))
    adapter.act(senses(pose_of(himloco), 1))
    newest, before = model.seen[1][0].reshape(6, 45)[:2]
    # Only the newest has an action before it.
    assert newest[33:].any()
    assert not before[33:].any()


def test_modules_with_memory_are_told_to_forget():
    model = Recorder(0)
    robogauge.Adapter(model, 3).reset(np.array([True, False, True]))
    assert model.resets == [0, 2]


def test_renets_own_shape_has_renets_own_units():
    model = Recorder(0)
    adapter = evaluator.find_adapter("onnx-depth")(model, 1)
    robot = read_manifest(pretrained("go1-parkour")).robot
    pose = robot.arrays["default_position"]
    target = adapter.act(senses(pose, 1))
    observation, depth = model.seen[0]
    assert observation.shape == (1, 45)
    assert observation[0, 0] == pytest.approx(0.1)
    assert depth.max() == 1.0
    assert target[0, 0] - pose[0] == pytest.approx(robot.action_scale)
