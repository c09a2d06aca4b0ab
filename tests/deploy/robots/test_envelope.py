"""The robot's own limits, which no bundle and no command can widen."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from renet.deploy.robots.base import JointCommand
from renet.deploy.robots.envelope import clamp, demand_within
from renet.errors import RenetError
from renet.robots import GO1

from .. import fakes


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("stiffness", 1000.0, r"stiffness 1000 N m/rad of FL_hip_joint; a Unitree Go1 takes 0 to"),
        ("damping", 11.0, "damping 11 N m s/rad of FL_hip_joint"),
        ("torque_limit", 30.0, "torque_limit 30 N m of FL_hip_joint"),
        ("lower", -0.864, "lower -0.864 rad of FL_hip_joint; a Unitree Go1 takes -0.863 to inf"),
        ("upper", 100.0, "upper 100 rad of FL_hip_joint; a Unitree Go1 takes -inf to 0.863"),
    ],
)
def test_a_bundle_beyond_the_robots_envelope_is_refused(manifest, field, value, message):
    values = list(getattr(manifest.robot, field))
    values[3] = value
    with pytest.raises(RenetError, match=message):
        demand_within(GO1, replace(manifest.robot, **{field: tuple(values)}))
    weak = {name: (0.1,) * 12 for name in ("stiffness", "damping", "torque_limit")}
    for robot in (manifest.robot, replace(manifest.robot, **weak)):
        demand_within(GO1, robot)


def test_a_command_within_the_envelope_passes_and_a_joint_too_fast_is_only_braked():
    gains = np.full(12, 20.0), np.ones(12)
    target = fakes.STANDING + 0.1
    slow, unknown = {"joint_velocity": np.ones(12)}, {"joint_position": np.full(12, np.nan)}
    for state in (None, fakes.state(), fakes.state(**slow), fakes.state(**unknown)):
        for weaker in (1.0, 0.01, 0.0):
            given = (target, weaker * gains[0], weaker * gains[1])
            command = clamp(GO1, JointCommand(*given), state)
            np.testing.assert_array_equal(given, [*vars(command).values()])
    fast = np.where(np.arange(12) < 6, 31.0, 0.0)
    for sign, driven in ((1.0, True), (-1.0, False)):
        ahead = fakes.STANDING + 3.0 * np.sign(fast)
        reading = fakes.state(joint_position=fakes.STANDING, joint_velocity=sign * fast)
        command = clamp(GO1, JointCommand(ahead, gains[0], 0.01 * gains[1]), reading)
        assert ((command.stiffness == 0) == (driven & (fast > 0))).all()
        assert (command.damping > 0).all()


@given(
    position=arrays(float, 12, elements=st.floats(-1e6, 1e6)),
    gains=arrays(float, (2, 12), elements=st.floats(-1e6, 1e6)),
    joints=arrays(float, 12, elements=st.floats(-3, 3)),
    speed=arrays(float, 12, elements=st.floats(-60, 60)),
)
def test_every_command_is_clamped_into_the_envelope(position, gains, joints, speed):
    state = fakes.state(joint_position=joints, joint_velocity=speed)
    command = clamp(GO1, JointCommand(position, *gains), state)
    assert ((command.position >= GO1.lower) & (command.position <= GO1.upper)).all()
    assert ((command.stiffness >= 0) & (command.stiffness <= 100)).all()
    assert ((command.damping >= 0) & (command.damping <= 10)).all()
    spring = command.stiffness * (command.position - joints)
    driven = (np.abs(speed) > GO1.velocity) & (spring * speed > 0)
    torque = spring - command.damping * speed
    slow = ~driven & (np.abs(speed) <= GO1.velocity)
    if (gains[0] > 0).any():  # A command that only brakes is never weakened.
        assert (np.abs(torque[slow]) <= GO1.torque[slow] + 1e-6).all()
    again = clamp(GO1, command, state)
    np.testing.assert_allclose(again.position, command.position)


@pytest.mark.parametrize("name", ["joint_position", "joint_velocity"])
@pytest.mark.parametrize("damaged", [np.inf, -np.inf, np.nan, 1e300])
@pytest.mark.parametrize("damping", [0.0, 1.0])
def test_no_damaged_reading_makes_a_command_that_is_not_finite(name, damaged, damping):
    """A warning of NumPy fails this test, too."""
    values = fakes.STANDING.copy()
    values[3] = damaged
    given = fakes.command(fakes.STANDING + 0.1, damping=damping)
    command = clamp(GO1, given, fakes.state(**{name: values}))
    assert all(np.isfinite(part).all() for part in vars(command).values())
    others = np.arange(12) != 3
    np.testing.assert_array_equal(command.position, given.position)
    assert (command.stiffness[others] > 0.0).all()
