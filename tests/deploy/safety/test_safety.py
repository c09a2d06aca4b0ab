"""Every failure the safety layer promises to catch, injected one by one; limits as properties."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from renet.deploy.safety.checks import (
    clean_state,
    pre_arm_problem,
    stand_up_problem,
    state_problem,
    teleop_problem,
)
from renet.deploy.safety.limits import (
    SafetyCfg,
    limited_command,
    limited_velocity,
    rate_after,
)
from renet.deploy.safety.machine import Mode, SafetyMachine, damping_command, stand_up_target
from renet.deploy.teleop.base import TeleopCommand
from renet.errors import RenetError
from renet.interface import CONTROL_DT
from renet.training.export import robot_spec

from ..fakes import ARM, QUICK, STANDING, command, frame, state, time_of, turned

GO1, CFG = robot_spec(), SafetyCfg()
IDLE = TeleopCommand()


def moved(joint: int, value: float) -> np.ndarray:
    joints = STANDING.copy()
    joints[joint] = value
    return joints


@pytest.mark.parametrize(
    ("changes", "now", "problem"),
    [
        ({}, CFG.max_state_age, ""),
        ({}, 0.06, "the state is 60 ms old"),
        ({}, -0.06, "the state is -60 ms old"),  # The clock jumped back.
        ({"quaternion": turned("x", 79)}, 0.0, ""),
        ({"quaternion": turned("x", 81)}, 0.0, "tilted by more than 80 degrees"),
        ({"quaternion": turned("x", 180)}, 0.0, "tilted by more than 80 degrees"),
        ({"joint_position": moved(0, GO1.lower[0] - CFG.joint_margin)}, 0.0, ""),
        ({"joint_position": moved(1, GO1.upper[1] + CFG.joint_margin)}, 0.0, ""),
        ({"joint_velocity": np.full(12, CFG.max_joint_speed)}, 0.0, ""),
        ({"angular_velocity": np.full(3, -CFG.max_turn_rate)}, 0.0, ""),
        ({"joint_position": moved(0, -1.1)}, 0.0, "FR_hip_joint is out of its range"),
        ({"joint_position": moved(11, 0.0)}, 0.0, "RL_calf_joint is out of its range"),
        ({"joint_velocity": -61.0 * np.eye(12)[4]}, 0.0, "FL_thigh_joint is too fast"),
        ({"angular_velocity": np.array([0, 0, 31.0])}, 0.0, "the base turns too fast"),
    ],
)
def test_what_a_reading_forbids(changes, now, problem):
    result = state_problem(state(**changes), GO1, CFG, now)
    assert result == problem


def test_a_level_robot_keeps_within_the_smallest_tilt():
    assert state_problem(state(), GO1, SafetyCfg(max_tilt=1e-9), 0.0) == ""


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"joint_position": np.zeros(11)}, r"joint_position has shape \(11,\)"),
        ({"joint_velocity": np.full(12, np.nan)}, "joint_velocity is not finite"),
        ({"joint_torque": np.full(12, np.inf)}, "joint_torque is not finite"),
        ({"quaternion": np.zeros(4)}, "the quaternion's length is not 1"),
        ({"quaternion": np.array([1.11, 0, 0, 0])}, "the quaternion's length is not 1"),
        ({"angular_velocity": "fast"}, "angular_velocity is not made of numbers"),
        ({"joint_position": None}, "joint_position has shape"),
        ({"time": math.nan}, "the state's time is not finite"),
        ({"time": 0.011}, "the state's time lies in the future"),
    ],
)
def test_malformed_readings_are_named(changes, message):
    with pytest.raises(RenetError, match="^" + message):
        clean_state(state(**changes), 0.0)
    assert clean_state(state(0.01), 0.0).time == 0.01, "clocks are read one by one"


def test_a_reading_outlives_its_drivers_buffer():
    buffer = STANDING.copy()
    kept = clean_state(state(joint_position=buffer), 0.0)
    buffer += 1.0
    np.testing.assert_array_equal(kept.joint_position, STANDING)


def test_requests():
    assert teleop_problem(TeleopCommand(forward=9.0)) == ""
    assert teleop_problem(TeleopCommand(arm=True, stop=True)) == "operator stop"
    for wrong in ({"turn_rate": math.nan}, {"forward": math.inf}, {"left": -math.inf}):
        assert teleop_problem(TeleopCommand(**wrong)) == "the operator's command is not finite"


@pytest.mark.parametrize(
    ("asked", "given"),
    [
        ((9.0, 9.0, 9.0), (1.0, 0.5, 1.0)),
        ((-9.0, -9.0, -9.0), (-0.6, -0.5, -1.0)),
        ((-0.2, 0.1, 0.3), (-0.2, 0.1, 0.3)),
    ],
)
def test_velocity_limits(asked, given):
    assert limited_velocity(TeleopCommand(*asked)) == given


@pytest.mark.parametrize(
    ("change", "refusal"),
    [
        ({}, ""),
        ({"teleop": TeleopCommand(forward=1.0, arm=True)}, "already asks for 1.00 m/s"),
        ({"teleop": TeleopCommand(left=-0.2, arm=True)}, "already asks for -0.20 m/s"),
        ({"teleop": TeleopCommand(turn_rate=0.5, arm=True)}, "already asks for 0.50 rad/s"),
        ({"state": state(battery=0.19)}, "the battery has less than 20% left"),
        ({"state": state(battery=0.21)}, ""),
        ({"state": state(battery=math.nan, temperature=math.nan)}, ""),
        ({"state": state(battery=0.0)}, "the battery has less than 20% left"),
        ({"state": state(battery=0.0), "cfg": SafetyCfg(min_battery=0.0)}, ""),
        ({"state": state(temperature=66.0)}, "a motor has more than 65 °C"),
        ({"state": state(fault="a motor has left its mode")}, "a motor has left its mode"),
        ({"recorder": "the recording x ends early: no space"}, "the recording x ends early"),
        ({"frame": None}, "the camera has sent no image"),
        ({"frame": frame(1, 9.4)}, "newest image is older than 0.5 s"),
        ({"teleop": SimpleNamespace(arm=True)}, ""),
        ({"frame": SimpleNamespace()}, "newest image is older than 0.5 s"),
        ({"frame": frame(1, math.nan)}, "newest image is older than 0.5 s"),
        ({"frame": None, "camera": False}, ""),
    ],
)
def test_what_keeps_a_robot_lying(change, refusal):
    healthy = {"state": state(10.0), "teleop": ARM, "frame": frame(1, 9.9), "camera": True}
    given = healthy | {"recorder": "", "cfg": CFG, "now": 10.0} | change
    result = pre_arm_problem(**given)
    assert refusal in result
    assert bool(result) == bool(refusal)


@pytest.fixture
def machine() -> SafetyMachine:
    """One that was armed at step 1 and has walked since step 7."""
    machine = SafetyMachine(QUICK)
    for step in range(10):
        machine.update("", ARM if step == 1 else IDLE, time_of(step))
    return machine


def test_arming_waits_for_health_and_must_be_pressed_anew():
    machine = SafetyMachine(CFG)
    assert (machine.reason, machine.refused, machine.since) == ("start", "", -math.inf)
    for step in range(50):
        assert machine.update("", IDLE, time_of(step)) is Mode.DAMPING, "nobody armed it"
    machine.update("tilted", ARM, time_of(50))
    assert (machine.mode, machine.refused) == (Mode.DAMPING, "tilted")
    machine.update("tilted", ARM, time_of(51))
    assert machine.refused == "", "a button held down asks once"
    machine.update("", ARM, time_of(52))
    assert machine.mode is Mode.DAMPING, "and is not pressed again"
    machine.update("", IDLE, time_of(53))
    machine.update("", ARM, time_of(54))
    assert (machine.mode, machine.reason) == (Mode.STANDING_UP, "armed")


def test_joints_that_did_not_follow():
    blocked = state(joint_position=moved(8, -2.6))
    problem = stand_up_problem(blocked, GO1, CFG)
    assert problem == "RR_calf_joint did not follow: 0.80 rad are missing"
    assert stand_up_problem(state(joint_position=STANDING + 0.2), GO1, CFG) == "", "its own weight"
    assert stand_up_problem(state(joint_position=moved(0, 0.6)), GO1, CFG) == "", "just so"


def test_it_walks_until_the_first_reason_which_stays_until_the_next_arming(machine):
    assert (machine.mode, machine.reason, machine.refused) == (Mode.WALKING, "stood up", "")
    assert machine.since == time_of(7)
    for step in range(10, 100):
        machine.update({10: "tilted", 11: "stale"}.get(step, ""), IDLE, time_of(step))
    assert (machine.mode, machine.reason) == (Mode.DAMPING, "tilted")
    assert machine.since == time_of(10)


@pytest.mark.parametrize(
    ("now", "reason"),
    [
        (time_of(9) + 0.9, "no control tick for 900 ms"),
        (time_of(9) - 0.01, "the clock went backwards"),
        (time_of(9), "the clock stands"),
        (math.nan, "the clock is not finite"),
    ],
)
def test_clocks(machine, now, reason):
    machine.update("", IDLE, now)
    assert (machine.mode, machine.reason) == (Mode.DAMPING, reason)


def test_one_late_tick_is_forgiven_and_six_in_a_row_are_not(machine):
    now = time_of(9)
    for periods in (*5 * [1.6], 1.0, 1.0, *5 * [1.6], 1.0, *6 * [1.6]):
        assert machine.mode is Mode.WALKING
        now += periods * CONTROL_DT
        machine.update("", IDLE, now)
    assert machine.reason == "6 late control ticks in a row"


def test_late_ticks_are_counted_anew_from_the_start_and_in_each_mode():
    machine = SafetyMachine(CFG)
    for tick in range(11):  # Five before it is armed, and five after.
        machine.update("", ARM if tick == 5 else IDLE, 1.6 * CONTROL_DT * tick)
    assert (machine.mode, machine.refused) == (Mode.STANDING_UP, "")


def test_rising_starts_at_the_measured_pose_and_ends_at_the_default():
    start = STANDING - 0.5
    for share, left in ((-0.1, 0.5), (0.0, 0.5), (0.25, 0.5 * 0.84375), (0.5, 0.25), (1.7, 0.0)):
        np.testing.assert_allclose(stand_up_target(start, GO1, share), STANDING - left)


def test_damping_only_brakes():
    brakes = vars(damping_command(GO1, CFG))
    np.testing.assert_equal(brakes, vars(command(GO1.default_position, 0.0, CFG.damping)))


def test_a_small_step_passes_unchanged():
    passed = limited_command(STANDING + 0.1, STANDING, state(), GO1, CFG.target_rate)
    np.testing.assert_equal(vars(passed), vars(command(STANDING + 0.1)))


@pytest.mark.parametrize(
    ("walked", "rate"), [(-1.0, 10.0), (0.0, 10.0), (0.5, 25.0), (1.0, 40.0), (99.0, 40.0)]
)
def test_targets_are_slow_as_a_walk_begins(walked, rate):
    assert rate_after(walked, CFG) == rate
    assert rate_after(walked, SafetyCfg(target_rate=5.0)) == 5.0


twelve = st.lists(st.floats(-1e6, 1e6), min_size=12, max_size=12).map(np.array)
ranges = st.tuples(*map(st.floats, GO1.lower, GO1.upper)).map(np.array)


@given(twelve, ranges, ranges, st.lists(st.floats(-60, 60), min_size=12, max_size=12))
def test_no_command_leaves_its_limits(target, previous, position, velocity):
    reading = state(joint_position=position, joint_velocity=np.array(velocity))
    limited = limited_command(target, previous, reading, GO1, CFG.target_rate)
    assert ((limited.position >= GO1.lower) & (limited.position <= GO1.upper)).all()
    assert (np.abs(limited.position - previous) <= CFG.target_rate * CONTROL_DT + 1e-9).all()
    assert (limited.stiffness <= 40.0).all()
    assert ((limited.damping >= 0.0) & (limited.damping <= 1.0)).all()
    torque = limited.stiffness * (limited.position - position) - limited.damping * velocity
    assert (np.abs(torque) <= np.array(GO1.torque_limit) + 1e-6).all()


def test_a_target_that_is_not_finite_is_no_command():
    with pytest.raises(RenetError, match=r"^the joint target is not finite"):
        limited_command(np.full(12, np.nan), STANDING, state(), GO1, CFG.target_rate)


@pytest.mark.parametrize("value", [0.0, -1.0, math.inf, math.nan])
def test_limits_must_be_positive(value):
    with pytest.raises(RenetError, match=f"the safety limit max_gap must be positive, got {value}"):
        SafetyCfg(max_gap=value)
    with pytest.raises(RenetError, match="max_tilt is in rad, got 70"):
        SafetyCfg(max_tilt=70.0)
    SafetyCfg(max_tilt=math.pi, min_battery=0.0)
