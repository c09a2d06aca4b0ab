"""Readings that cannot be true brake the robot; none of one that walks, is pushed or falls does."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from renet.bundle import Bundle
from renet.deploy.controller import Controller
from renet.deploy.loop import run_control_loop
from renet.deploy.robots.sim.mujoco import MujocoRobot
from renet.deploy.robots.sim.scene import build_scene
from renet.deploy.safety import plausibility
from renet.deploy.safety.limits import SafetyCfg
from renet.deploy.safety.machine import Mode
from renet.deploy.safety.plausibility import MAX_DRIFT, MOST_ALIKE, Readings, rotation_vector
from renet.deploy.teleop import TeleopCommand
from renet.interface import CONTROL_DT

from ..fakes import STANDING, Run, state, time_of, turned

FIRST = 40
"""Control step of the first reading that is wrong: the robot walks."""
SWAY = np.tile([0.0, 1.0, 0.0], 4)


DISAGREE = "gyroscope and attitude disagree"
JUMPED = "FR_thigh_joint jumped by 0.50 rad at another speed"


@pytest.mark.parametrize(
    ("name", "even", "odd", "reason", "steps"),
    [
        ("quaternion", turned("z", 0), turned("z", 180), f"{DISAGREE} by 3.14 rad", 2),
        ("angular_velocity", [0, 0, 29.0], [0, 0, 29.0], DISAGREE, 2),
        ("angular_velocity", [0, 2.0, 0], [0, 2.0, 0], f"{DISAGREE} by 0.3", 15),
        ("joint_position", STANDING, STANDING + 0.5 * SWAY, JUMPED, 2),
        ("joint_torque", np.zeros(12), np.zeros(12), "the readings are frozen: 6 are the same", 6),
    ],
)
def test_a_reading_that_cannot_be_true_brakes(bundle, name, even, odd, reason, steps):
    run = Run(bundle)
    run.ticks(FIRST)
    assert run.controller.machine.mode is Mode.WALKING
    for step in range(FIRST, FIRST + steps):
        command = run.tick(**{name: np.array(odd if step % 2 else even)})
    assert run.controller.machine.mode is Mode.DAMPING
    assert reason in run.events[-1].why
    assert not command.stiffness.any()


def test_a_body_that_turns_and_moves_as_its_sensors_say_is_believed():
    """Fast, about a changing axis, past the ends of angles: far quicker than any walk."""
    readings, dt = Readings(), 0.01
    attitude, angle = Rotation.identity(), np.zeros(12)
    for step in range(500):
        now = dt * step
        rate = 8.0 * np.array([math.sin(now), math.cos(2 * now), math.sin(3 * now)])
        speed = np.full(12, 20.0 * math.cos(5 * now))
        angle = np.full(12, 4.0 * math.sin(5 * now))
        attitude = attitude * Rotation.from_rotvec(rate * dt)
        told = {
            "quaternion": (-1) ** step * attitude.as_quat(scalar_first=True),
            "angular_velocity": rate,
            "joint_position": angle,
            "joint_velocity": speed,
        }
        assert readings.problem(state(now, **told)) == ""


def test_readings_with_a_gap_between_are_not_compared():
    readings = Readings()
    for n, time in enumerate((0.0, 0.06, 0.12)):
        assert readings.problem(state(time, quaternion=turned("z", 90.0 * n))) == ""


@pytest.mark.parametrize("seed", range(5))
def test_a_turn_between_two_attitudes_is_scipys(seed):
    random = np.random.default_rng(seed)
    before, turn = Rotation.random(rng=random), Rotation.from_rotvec(random.uniform(-1, 1, 3))
    ends = [r.as_quat(scalar_first=True) for r in (before, before * turn)]
    np.testing.assert_allclose(rotation_vector(*ends), turn.as_rotvec(), atol=1e-12)
    np.testing.assert_allclose(rotation_vector(ends[0], -ends[1]), turn.as_rotvec(), atol=1e-12)


def pushy(now: float) -> TeleopCommand:
    """Arms again and again, and walks fast."""
    arm = round(now / CONTROL_DT) % 150 == 0
    return TeleopCommand(arm=arm, forward=0.0 if arm else 1.0)


@pytest.mark.parametrize(("terrain", "push"), [("rough", 0.0), ("stairs_up", 1.0), ("gap", 2.0)])
def test_no_reading_of_a_robot_that_walks_is_pushed_or_falls_comes_near_the_limits(
    terrain, push, monkeypatch
):
    bundle, random = Bundle.load(), np.random.default_rng(1)
    model, ground = build_scene(terrain, 6)
    robot = MujocoRobot(model, bundle.manifest.robot, ground)
    controller = Controller(bundle, SafetyCfg(stand_up_seconds=0.5))
    wait, most = robot.wait, []

    def pushed(until: float) -> None:
        if random.random() < 0.01 * push:
            robot.data.qvel[:6] += push * random.uniform(-1, 1, 6)
        wait(until)

    def note(command, state) -> None:
        most.append((controller._readings._drift, controller._implausible))

    robot.wait = pushed
    for name in ("MAX_JUMP", "MAX_DRIFT"):
        monkeypatch.setattr(plausibility, name, getattr(plausibility, name) / 2)
    monkeypatch.setattr(plausibility, "MOST_ALIKE", 1)
    hand, done = SimpleNamespace(command=pushy), lambda: robot.now() > 8
    run_control_loop(robot, None, hand, controller, on_step=note, done=done)
    drifts, problems = zip(*most, strict=True)
    assert set(problems) == {""}
    assert len(problems) > 8 / CONTROL_DT
    assert 0.0 < np.linalg.norm(drifts, axis=1).max() < MAX_DRIFT / 2


def test_alike_readings_are_counted_in_a_row():
    readings, torque = Readings(), np.zeros(12)
    for step in range(3 * MOST_ALIKE):
        changed = torque + (step % MOST_ALIKE == 0) * step
        assert readings.problem(state(time_of(step), joint_torque=changed)) == ""
