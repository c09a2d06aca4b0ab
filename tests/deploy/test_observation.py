"""o_t against numbers worked out by hand, and against rotation matrices."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from renet.deploy.observation import heading, observe, projected_gravity
from renet.interface import proprioception_slices
from renet.training.bundle import robot_spec

from .fakes import state

AT = proprioception_slices()
HALF = math.sqrt(0.5)
LEFT_90 = (HALF, 0.0, 0.0, HALF)


def test_every_block_by_hand():
    joints = np.array(robot_spec().default_position)
    joints[4] += 0.2  # FL thigh.
    reading = state(
        joint_position=joints,
        joint_velocity=np.arange(12.0),
        angular_velocity=np.array([1.0, -2.0, 4.0]),
        quaternion=np.array(LEFT_90),
    )
    action = np.linspace(-1, 1, 12)
    o = observe(reading, robot_spec(), speed=0.6, yaw=0.0, last_action=action)
    assert o.shape == (45,)
    assert o.dtype == np.float32
    np.testing.assert_allclose(o[AT["base_angular_velocity"]], [0.25, -0.5, 1.0])
    np.testing.assert_allclose(o[AT["projected_gravity"]], [0, 0, -1], atol=1e-6)
    # The robot looks left by 90 degrees and should look ahead: the error is -90 degrees.
    np.testing.assert_allclose(o[AT["command"]], [0.6, -1.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(o[AT["joint_position"]][4], 0.2, atol=1e-6)
    assert np.abs(np.delete(o[AT["joint_position"]], 4)).max() < 1e-6
    np.testing.assert_allclose(o[AT["joint_velocity"]], 0.05 * np.arange(12.0), rtol=1e-6)
    np.testing.assert_allclose(o[AT["last_action"]], action, rtol=1e-6)


def test_a_quaternion_and_its_negative_are_one_rotation():
    q = np.array([0.8, 0.1, -0.3, 0.5])
    np.testing.assert_allclose(projected_gravity(q), projected_gravity(-q))
    assert heading(q) == pytest.approx(heading(-q))


def test_zeros_are_no_rotation_and_no_error():
    assert np.isnan(projected_gravity(np.zeros(4))).all()


@given(st.lists(st.floats(-3, 3), min_size=3, max_size=3))
def test_against_a_product_of_elementary_rotations(angles):
    roll, pitch, yaw = angles
    pitch /= 2.1  # Within a quarter turn, where yaw is unique.

    def rotation(axis: int, angle: float) -> np.ndarray:
        i, j = (axis + 1) % 3, (axis + 2) % 3
        matrix = np.eye(3)
        matrix[i, i] = matrix[j, j] = math.cos(angle)
        matrix[i, j], matrix[j, i] = -math.sin(angle), math.sin(angle)
        return matrix

    def times(p, q):
        w, v = p[0] * q[0] - p[1:] @ q[1:], p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:])
        return np.array([w, *v])

    def quaternion(axis: int, angle: float) -> np.ndarray:
        q = np.zeros(4)
        q[0], q[1 + axis] = math.cos(angle / 2), math.sin(angle / 2)
        return q

    turn = rotation(2, yaw) @ rotation(1, pitch) @ rotation(0, roll)
    q = times(times(quaternion(2, yaw), quaternion(1, pitch)), quaternion(0, roll))
    np.testing.assert_allclose(projected_gravity(q), turn.T @ [0, 0, -1], atol=1e-9)
    assert heading(q) == pytest.approx(math.atan2(turn[1, 0], turn[0, 0]), abs=1e-6)
