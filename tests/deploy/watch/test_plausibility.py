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
from renet.deploy.safety.limits import SafetyCfg
from renet.deploy.teleop.base import TeleopCommand
from renet.deploy.watch import freezing, plausibility
from renet.deploy.watch.plausibility import (
    MAX_DRIFT,
    Disagreement,
    break_problem,
    comparable,
    rotation_vector,
)
from renet.interface import CONTROL_DT

from ..fakes import state


def test_a_body_that_turns_and_moves_as_its_sensors_say_is_believed():
    """Fast, about a changing axis, past the ends of angles: far quicker than any walk."""
    disagreement, dt, last = Disagreement(), 0.01, None
    attitude = Rotation.identity()
    for step in range(500):
        now = dt * step
        rate = 8.0 * np.array([math.sin(now), math.cos(2 * now), math.sin(3 * now)])
        attitude = attitude * Rotation.from_rotvec(rate * dt)
        told = state(
            now,
            quaternion=(-1) ** step * attitude.as_quat(scalar_first=True),
            angular_velocity=rate,
            joint_position=np.full(12, 4.0 * math.sin(5 * now)),
            joint_velocity=np.full(12, 20.0 * math.cos(5 * now)),
        )
        if last is not None:
            assert comparable(last, told)
            assert break_problem(last, told) == ""
            assert disagreement.problem(last, told) == ""
        last = told


def test_readings_with_a_gap_between_are_not_compared():
    assert not comparable(None, state(0.0))
    assert not comparable(state(0.0), state(0.06))
    assert not comparable(state(0.02), state(0.02))
    assert comparable(state(0.0), state(0.05))


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
        intake = controller._watch._intake
        odd = intake._broken or intake._drifts or controller._watch._problem
        most.append((intake._disagreement._drift, odd))

    robot.wait = pushed
    for name in ("MAX_JUMP", "MAX_TWIST", "MAX_DRIFT", "MAX_SKIP", "MAX_SLIP"):
        monkeypatch.setattr(plausibility, name, getattr(plausibility, name) / 2)
    monkeypatch.setattr(freezing, "MAX_ALIKE", 2)
    hand, done = SimpleNamespace(command=pushy), lambda: robot.now() > 8
    run_control_loop(robot, None, hand, controller, on_step=note, done=done)
    drifts, problems = zip(*most, strict=True)
    assert set(problems) == {""}
    assert len(problems) > 8 / CONTROL_DT
    assert 0.0 < np.linalg.norm(drifts, axis=1).max() < MAX_DRIFT / 2
