"""Training's conditions in evaluation: its ranges, drawn alike for twins."""

import shutil
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import torch

from renet.bundle import pretrained, read_manifest, write_manifest
from renet.errors import RenetError
from renet.evaluation.conditions import Disturbances, use_training_conditions
from renet.evaluation.demo import DemoStudy
from renet.evaluation.env import SimEnv, study_env_cfg, terrain_env_cfg
from renet.evaluation.evaluator import Evaluator
from renet.evaluation.settings import FLAT_GROUND
from renet.evaluation.studies.commands import CommandStudy
from renet.evaluation.trace import StepResult
from renet.interface import PROPRIOCEPTION, proprioception_slices
from renet.tasks import VISUAL_GO1, env_cfg
from renet.tasks.parkour_env_cfg import NOISE, randomize
from renet.tasks.sensors import depth_camera

from .tiny import STUDIES

NUMBERS = [*range(8), *reversed(range(8))]
"""Robots of two modes, in another order."""
TWIN = [NUMBERS.index(number) for number in NUMBERS]
SLICES = proprioception_slices()


def config(trained=None):
    """Flat ground under the conditions of the Go1's training."""
    cfg = terrain_env_cfg("flat", VISUAL_GO1)
    use_training_conditions(cfg, trained or env_cfg("Renet-Go1-Parkour"))
    return study_env_cfg(cfg, 0.6)


@pytest.fixture(scope="module")
def world() -> SimEnv:
    cfg = config()
    cfg.events["push"].interval_range_s = (0.1, 0.3)
    return SimEnv(cfg, NUMBERS, 5, "native")


def walk(world: SimEnv, steps: int) -> Iterator[StepResult]:
    """Readings of a reset and of so many steps towards the default pose."""
    yield world.reset()
    for _ in range(steps):
        yield world.step(np.zeros((world.num_robots, 12), np.float32))


def test_motors_joints_mounts_and_delays_have_trainings_ranges_and_are_the_twins(world):
    world.reset()
    limits = world.env.sim.model.actuator_forcerange[:, :, 1]
    strength = limits / world.env.sim.get_default_field("actuator_forcerange")[..., 1]
    zeros = world._robot.encoder_bias
    camera = world._camera
    delays, position = camera._delay, camera._position - camera._nominal
    for drawn, most in ((strength - 1, 0.2), (zeros, 0.03), (position, 0.03), (delays, 5)):
        assert 0.5 * most < drawn.abs().max() <= most + 1e-6
        assert torch.equal(drawn, drawn[TWIN])
        assert len(drawn.unique(dim=0)) > 1, "robots differ"
    assert torch.equal(camera._rotation, camera._rotation[TWIN])


def test_motors_lose_torque_with_speed_as_in_training():
    trained = env_cfg("Renet-Go1-Parkour")
    randomize(trained, no_load_speed=(1.0, 1.5))
    motors = SimEnv(config(trained), NUMBERS, 5, "native").env.motors
    assert motors is not None
    # Each robot has one multiple of the velocities of its motors.
    multiple = motors.no_load_speed / motors.no_load_speed.amin(0, keepdim=True)
    assert 1.0 < multiple.max() <= 1.5
    assert torch.equal(motors.no_load_speed, motors.no_load_speed[TWIN])
    assert len(motors.no_load_speed.unique(dim=0)) == len(set(NUMBERS))


def test_twins_are_noisy_late_and_pushed_alike_in_every_run(world):
    runs = []
    for _ in range(2):
        rows = [(r.proprioception.copy(), r.depth.copy()) for r in walk(world, 40)]
        runs.append([np.stack(kind).astype(np.float32) for kind in zip(*rows, strict=True)])
    for first, again in zip(*runs, strict=True):
        np.testing.assert_array_equal(first, again)
        # Twins stand at other places of the world, whose coordinates are rounded.
        np.testing.assert_allclose(first, first[:, TWIN], atol=0.01)
        assert (np.abs(first[:, 0] - first[:, 1]) > 0.05).any(axis=1).mean() > 0.9


@pytest.mark.parametrize("term", ["base_angular_velocity", "projected_gravity", "joint_velocity"])
def test_sensors_have_trainings_noise(world, term):
    place = SLICES[term]
    scale = next(one.scale for one in PROPRIOCEPTION if one.name == term)
    errors = []
    for result in walk(world, 60):
        truth = world.env.observation_manager.compute_group("proprioception").numpy()
        errors.append((result.proprioception - truth)[:, place] / scale)
    assert 0.9 * NOISE[term] < np.abs(errors).max() <= NOISE[term] + 1e-5
    assert np.mean(errors) == pytest.approx(0.0, abs=0.1 * NOISE[term])
    assert np.std(errors) == pytest.approx(NOISE[term] / np.sqrt(3), rel=0.1)


def test_a_push_changes_the_velocity_of_twins_by_what_was_drawn(world, monkeypatch):
    _ = [*walk(world, 3)]
    pushed, change = torch.arange(8) == 1, torch.zeros(8, 6)
    change[:, 0] = 0.5
    monkeypatch.setattr(world._disturbances, "draw_pushes", lambda: (pushed, change))
    before = world._robot.root_link_vel_w.clone()
    world._push()
    world.env.sim.forward()
    moved = (world._robot.root_link_vel_w - before)[:, 0]
    np.testing.assert_allclose(moved, 0.5 * np.isin(NUMBERS, 1), atol=1e-5)


def test_pushes_come_at_trainings_intervals_and_speeds():
    cfg = config()
    disturbances = Disturbances.extract(cfg)
    assert "push" not in cfg.events
    disturbances.restart(50, 1)
    times, changes = [[] for _ in range(50)], []
    for step in range(3000):
        pushed, change = disturbances.draw_pushes()
        for robot in pushed.nonzero().flatten().tolist():
            times[robot].append(0.02 * step)
            changes.append(change[robot])
    gaps = np.concatenate([np.diff([0.0, *robot]) for robot in times])
    assert 5.97 <= gaps.min() < 6.3 < 9.7 < gaps.max() <= 10.03
    drawn = torch.stack(changes)
    assert 0.45 < drawn[:, :2].abs().max() <= 0.5
    assert not drawn[:, 2:].any()


def test_nominal_conditions_neither_push_nor_add_noise_to_sensors():
    world = SimEnv(study_env_cfg(terrain_env_cfg("flat", VISUAL_GO1), 0.6), [0, 1], 5, "native")
    for result in walk(world, 5):
        truth = world.env.observation_manager.compute_group("proprioception")
        np.testing.assert_array_equal(result.proprioception, truth)
    assert world._camera._max_delay == 0
    assert not world._disturbances.draw_pushes()[0].any()


def test_bodies_and_starts_are_those_of_nominal_conditions():
    nominal = SimEnv(study_env_cfg(terrain_env_cfg("flat", VISUAL_GO1), 0.6), [0, 1], 5, "native")
    trained = SimEnv(config(), [0, 1], 5, "native")
    for world in (nominal, trained):
        world.reset()
    for field in ("body_mass", "body_ipos", "actuator_gainprm", "geom_friction"):
        assert torch.equal(*(getattr(w.env.sim.model, field)[:] for w in (nominal, trained))), field
    assert torch.equal(nominal.env.sim.data.qpos, trained.env.sim.data.qpos)


def test_late_joint_targets_are_refused():
    trained = env_cfg("Renet-Go1-Parkour")
    randomize(trained, action_delay=0.02)
    with pytest.raises(RenetError, match=r"delays joint targets.*give --conditions nominal$"):
        config(trained)


def test_an_evaluator_under_training_conditions_makes_every_ground_so():
    evaluator = Evaluator(conditions="training")
    for terrain in ("flat", {"gap": 3}):
        cfg = evaluator.terrain_env_cfg(terrain)
        assert depth_camera(cfg).delay == (0.0, 0.1)
        assert {"motor_strength", "joint_offset", "push"} <= set(cfg.events)
    env = evaluator.make_env({"gap": 3}, [0, 0], 0.6, 1)
    assert env._camera._max_delay == 5
    nominal = Evaluator(conditions="nominal").terrain_env_cfg("flat")
    assert nominal.events.keys().isdisjoint({"push", "motor_strength"})


@pytest.mark.parametrize("study", [*STUDIES.values(), DemoStudy, CommandStudy])
def test_robots_of_a_study_differ_and_are_pushed_by_default(study, tmp_path):
    cfg = study(tmp_path).make_evaluator().terrain_env_cfg({"gap": 3})
    assert {"motor_strength", "damping", "joint_offset", "push"} <= set(cfg.events)
    cfg = study(tmp_path, conditions="nominal").make_evaluator().terrain_env_cfg({"gap": 3})
    assert cfg.events.keys().isdisjoint({"motor_strength", "damping", "joint_offset", "push"})


def test_robots_of_a_default_study_walk_with_motors_delays_noise_and_pushes_of_training(tmp_path):
    env = CommandStudy(tmp_path).make_evaluator().make_env(FLAT_GROUND, NUMBERS, 0.6, 1)
    limits = env.env.sim.model.actuator_forcerange[:, :, 1]
    assert len(limits.unique(dim=0)) == 8
    assert torch.equal(limits, limits[TWIN])
    assert env._camera._max_delay == 5
    assert env._disturbances.noise is not None
    env.reset()
    pushed = [env._disturbances.draw_pushes()[0] for _ in range(510)]
    assert torch.stack(pushed).any(dim=0).all(), "after 10 s everybody has been pushed"


def test_a_bundle_without_a_task_is_judged_in_the_recipes_conditions(tmp_path):
    shutil.copytree(pretrained("go1-parkour"), tmp_path / "old")
    manifest = read_manifest(tmp_path / "old")
    origin = replace(manifest.provenance, task="")
    write_manifest(tmp_path / "old", replace(manifest, provenance=origin))
    named, unnamed = (
        Evaluator(bundle).terrain_env_cfg("flat") for bundle in (None, tmp_path / "old")
    )
    assert {*unnamed.events} == {*named.events} > {"motor_strength", "push"}
