"""Motors that are not ideal: torque, delay and friction of a robot that hangs in the air."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from renet.deploy.robots.base import JointCommand
from renet.deploy.robots.sim.mujoco import MujocoRobot
from renet.deploy.robots.sim.scene import build_scene
from renet.deploy.robots.sim.servos import NetworkServos
from renet.errors import RenetError
from renet.interface import JOINTS, PHYSICS_DT
from renet.motor_models import find_motors
from renet.motor_models.network import read_network
from renet.motors import MotorFit, MotorParameters
from renet.training.export import robot_spec

ROBOT = robot_spec()
DEFAULT = np.array(ROBOT.default_position)
NETWORK = read_network()


def told(position: np.ndarray, stiffness: float = 40.0, damping: float = 1.0) -> JointCommand:
    return JointCommand(position, np.full(12, stiffness), np.full(12, damping))


def floating(motors=None) -> MujocoRobot:
    """A robot 5 m above the ground."""
    model, _ = build_scene()
    return MujocoRobot(model, ROBOT, 5.0, motors=motors)


def samples(robot: MujocoRobot) -> tuple[np.ndarray, np.ndarray]:
    state = robot.read()
    return np.array(state.joint_position), np.array(state.joint_velocity)


def test_a_network_sees_the_last_three_physics_steps():
    robot, target = floating(find_motors("go1", ROBOT.name)), DEFAULT + 0.1
    robot.write(told(target))
    errors, velocities = np.zeros((12, 3)), np.zeros((12, 3))
    for step in range(1, 6):
        position, velocity = samples(robot)
        # Kp 40 and Kd 1 are twice what the motors were told when they were measured.
        errors = np.column_stack([2.0 * (position - target), errors[:, :2]])
        velocities = np.column_stack([2.0 * velocity, velocities[:, :2]])
        robot.wait(step * PHYSICS_DT)
        torque = NETWORK.torque(errors, velocities)
        np.testing.assert_allclose(robot.read().joint_torque, torque, rtol=1e-9)
    assert np.abs(velocities).max() > 0.5


def test_a_network_obeys_the_motors_limits_and_new_gains():
    robot = floating(find_motors("go1", ROBOT.name))
    robot.write(told(DEFAULT + 50.0))
    robot.wait(PHYSICS_DT)
    assert np.abs(robot.read().joint_torque).max() <= max(ROBOT.torque_limit)
    robot.write(told(DEFAULT, stiffness=0.0, damping=0.0))
    robot.wait(4 * PHYSICS_DT)
    # All samples of before are gone: of nothing the network makes its bias alone.
    np.testing.assert_allclose(robot.read().joint_torque, -0.0040675, atol=1e-6)


def test_a_network_needs_its_own_rate():
    model, _ = build_scene()
    model.opt.timestep = 0.001
    with pytest.raises(RenetError, match=r"steps of 0\.005 s, not 0\.001 s"):
        NetworkServos(model, mujoco.MjData(model), NETWORK)


MOTOR = MotorParameters(armature=0.02, damping=0.3, friction=0.4, delay=0.0)


def fit(**joints: float) -> MotorFit:
    """Measured motors with delays of some joints, s."""
    kinds = dict.fromkeys(("hip", "thigh", "calf"), MOTOR)
    late = {name: replace(MOTOR, delay=delay) for name, delay in joints.items()}
    return MotorFit(ROBOT.name, kinds | late)


def test_measured_motors_change_the_joints():
    model = floating(fit()).model
    for name in JOINTS:
        joint = model.joint(name)
        assert (joint.armature, joint.damping, joint.frictionloss) == (0.02, 0.3, 0.4)
    # MuJoCo's own constants follow: more inertia is less motion for the same torque.
    assert model.joint(JOINTS[0]).dofadr[0] == 6
    assert model.dof_invweight0[6] < build_scene()[0].dof_invweight0[6]


def test_each_joint_is_as_late_as_it_was_measured():
    robot = floating(fit(FR_hip_joint=0.01, RL_calf_joint=0.02))
    ids = robot._servos.ids
    for _ in range(3):  # Three control steps of 20 ms.
        robot.write(told(DEFAULT))
        robot.wait(robot.now() + 0.02)
    robot.write(told(DEFAULT + 0.2, stiffness=30.0))
    arrived = []
    for _ in range(6):
        robot.wait(robot.now() + PHYSICS_DT)
        arrived.append(robot.data.ctrl[ids] > DEFAULT + 0.1)
        stiff = robot.model.actuator_gainprm[ids, 0] == 30.0
        np.testing.assert_array_equal(stiff, arrived[-1], "gains come with their target")
    first = np.argmax(arrived, axis=0)
    late = {JOINTS[joint]: int(step) for joint, step in enumerate(first) if step}
    assert late == {"FR_hip_joint": 2, "RL_calf_joint": 4}


def test_the_first_command_holds_at_once():
    robot = floating(fit(FR_hip_joint=0.02))
    robot.write(told(DEFAULT + 0.2))
    robot.wait(PHYSICS_DT)
    np.testing.assert_allclose(robot.data.ctrl[robot._servos.ids], DEFAULT + 0.2)
