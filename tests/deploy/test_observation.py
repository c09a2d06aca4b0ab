"""o_t against numbers worked out by hand, and against scipy's rotations."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from renet.deploy.observation import observe
from renet.deploy.robots.base import heading, projected_gravity
from renet.training.export import robot_spec

from .fakes import state, turned


def test_every_block_by_hand():
    joints = np.array(robot_spec().default_position)
    joints[4] += 0.2  # FL thigh.
    reading = state(
        joint_position=joints,
        joint_velocity=np.arange(12.0),
        angular_velocity=np.array([1.0, -2.0, 4.0]),
        quaternion=turned("z", 90),
    )
    action = np.linspace(-1, 1, 12)
    o = observe(reading, robot_spec(), command=(0.6, -1.0, 0.0), last_action=action)
    rates, gravity, command = (0.25, -0.5, 1.0), (0, 0, -1), (0.6, -1.0, 0.0)
    position, velocity = 0.2 * np.eye(12)[4], 0.05 * np.arange(12)
    expected = np.concatenate([rates, gravity, command, position, velocity, action])
    np.testing.assert_allclose(o, expected.astype(np.float32), rtol=1e-6, atol=1e-6, strict=True)


def test_zeros_are_no_rotation_and_no_error():
    assert np.isnan(projected_gravity(np.zeros(4))).all()


@given(st.lists(st.floats(-3, 3), min_size=3, max_size=3))
def test_against_scipys_rotations(angles):
    yaw, pitch, roll = angles
    # Pitch within a quarter turn, where yaw is unique.
    turn = Rotation.from_euler("ZYX", (yaw, pitch / 2.1, roll))
    q = turn.as_quat(scalar_first=True)
    for same in (q, -q):  # One rotation has two quaternions.
        down = turn.inv().apply([0, 0, -1])
        np.testing.assert_allclose(projected_gravity(same), down, atol=1e-9)
        assert heading(same) == pytest.approx(yaw, abs=1e-6)
