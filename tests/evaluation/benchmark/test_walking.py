"""Courses walked: faults by place, commands by place, and what counts as crossed."""

from dataclasses import replace

import numpy as np
import pytest

from renet.evaluation.benchmark.episodes import Episode
from renet.evaluation.benchmark.walking import (
    CourseEnv,
    PlacedFaults,
    Walk,
    course_env_cfg,
    walk_episodes,
)
from renet.evaluation.evaluator import Evaluator
from renet.evaluation.trace import StepResult
from renet.faults import Frames
from renet.tasks import VISUAL_GO1
from renet.tasks.sensors import depth_camera
from renet.terrain.course import Gap, Plain, Platform

EPISODE = Episode(
    number=0,
    obstacles=(Gap(0.5), Platform(0.3, 1.0)),
    spaces=(2.0, 1.0),
    speed=0.5,
    headings=(0.3, -0.2),
    turn_at=3.0,
    stop_at=1.0,
    stop_seconds=0.1,
    family="dark",
    lie=False,
    fault="blackout",
    level=0.0,
    onset=1.5,
    duration=1.0,
    stranger=False,
)


class Camera:
    """Where robots are is all that faults ask."""

    def __init__(self, count=1):
        self.farthest = np.zeros(count)


def shown(faults, step, count=1):
    """Mean depth after the faults of a step, of an image at half its range."""
    images = np.full((count, 48, 64), 0.5, np.float32)
    return faults.apply(Frames.healthy(images), step).image.mean(axis=(1, 2))


def test_a_camera_fails_at_its_place_for_its_time():
    camera = Camera()
    faults = PlacedFaults(camera, [EPISODE], seed=1)
    assert shown(faults, 0) == 0.5
    camera.farthest[:] = 1.5
    assert shown(faults, 5) == 0.0
    # It goes on by time, wherever the robot is.
    camera.farthest[:] = 1.4
    assert shown(faults, 50) == 0.0
    assert faults.at_work(54).all()
    assert not faults.at_work(55).any()
    assert shown(faults, 55) == 0.5


def test_healthy_cameras_stay_healthy_beside_others():
    camera = Camera(2)
    camera.farthest[:] = 9.0
    faults = PlacedFaults(camera, [EPISODE, None], seed=1)
    np.testing.assert_array_equal(shown(faults, 5, 2), (0.0, 0.5))


def test_twins_draw_the_same_noise():
    noisy = replace(EPISODE, fault="gaussian", level=0.3)
    camera = Camera(2)
    camera.farthest[:] = 9.0
    faults = PlacedFaults(camera, [noisy, noisy], seed=1)
    images = np.full((2, 48, 64), 0.5, np.float32)
    one, other = faults.apply(Frames.healthy(images), 5).image
    np.testing.assert_array_equal(one, other)
    assert one.std() > 0.1


def test_physical_faults_turn_the_view():
    camera = Camera()
    faults = PlacedFaults(camera, [replace(EPISODE, fault="mount_knocked", level=10.0)], seed=1)
    assert not faults.perturbation(3).turn.any()
    camera.farthest[:] = 2.0
    assert np.linalg.norm(faults.perturbation(4).turn) == pytest.approx(np.radians(10.0))


class Robot:
    """Stands in for the simulation: walks where it is put."""

    num_robots = 1
    perturb_cameras = retire = poses = None

    def __init__(self):
        self.where = (0.0, 0.0, 0.3)
        self.fell = False

    def place_on(self, names):
        assert names == ["episode_0"]

    def reset(self):
        return self.result()

    def step(self, action):
        return self.result()

    def result(self):
        one = np.ones(1)
        return StepResult(
            proprioception=np.zeros((1, 45)),
            depth=np.zeros((1, 48, 64)),
            angular_velocity=np.zeros((1, 3)),
            forward_velocity=0.4 * one,
            travelled=one,
            collisions=0 * one,
            power=100.0 * one,
            fell=np.array([self.fell]),
            ended=np.array([self.fell]),
        )


class Told(CourseEnv):
    """Keeps the commands, without a simulation."""

    def _place(self):
        return tuple(np.array([value]) for value in self._inner.where)

    def _torque(self):
        return np.array([12.0])

    def _command(self, speed, heading):
        self.told = float(speed[0]), float(heading[0])


@pytest.fixture
def course():
    env = Told(Robot(), [EPISODE])
    env.reset()
    return env


def go(env, x, z=0.3, y=0.0, fell=False):
    env._inner.where, env._inner.fell = (x, y, z), fell
    return env.step(np.zeros((1, 12)))


def test_robots_stop_and_turn_at_their_places(course):
    assert course.told == (0.5, 0.3)
    go(course, 1.0)
    assert course.told == (0.0, 0.3)
    for _ in range(5):
        go(course, 1.0)
    assert course.told == (0.5, 0.3)
    # Who is pushed back does not stop again.
    go(course, 0.8)
    go(course, 3.0)
    assert course.told == (0.5, -0.2)


def test_obstacles_count_once_they_are_well_behind(course):
    go(course, 2.9)
    assert course.walk.crossed == [0]
    go(course, 3.0)
    assert course.walk.crossed == [1]
    assert not go(course, 4.9).ended.any()
    result = go(course, 5.0)
    assert result.ended.all()
    assert course.walk.arrived.all()
    assert course.walk.crossed == [2]


def test_a_body_in_the_gap_has_fallen(course):
    result = go(course, 2.2, z=-0.3)
    assert result.fell.all()
    assert result.ended.all()
    # Nothing that follows counts.
    go(course, 9.0)
    assert course.walk.crossed == [0]
    assert course.walk.metres == [2.2]


def test_a_fall_in_the_step_of_a_crossing_is_no_crossing(course):
    go(course, 2.9)
    go(course, 3.0, fell=True)
    assert course.walk.crossed == [0]
    assert course.walk.fell.all()


def test_time_and_sides_end_an_episode(course):
    assert go(course, 1.0, y=8.6).ended.all()
    assert not course.walk.fell.any()
    late = Told(Robot(), [EPISODE])
    late.reset()
    steps = round(EPISODE.seconds / 0.02)
    ended = [bool(go(late, 0.1).ended.all()) for _ in range(steps)]
    assert ended[-1]
    assert not any(ended[:-1])


def test_measures_are_sums_and_means(course):
    for _ in range(10):
        go(course, 0.5)
    assert course.walk.joules == pytest.approx(20.0)
    assert course.walk.peak_torque == [12.0]
    assert course.walk.speed_error == pytest.approx(0.1)


def test_walks_are_joined_in_the_episodes_order():
    first, second = Walk.at_start(2), Walk.at_start(1)
    first.crossed[:], second.crossed[:] = (1, 3), 2
    joined = Walk.concatenate([first, second], np.array([0, 2, 1]))
    np.testing.assert_array_equal(joined.crossed, (1, 2, 3))


def test_robots_meet_the_conditions_of_version_3():
    cfg = course_env_cfg({"one": EPISODE.course}, VISUAL_GO1)
    ranges = {
        name: {key: value for key, value in event.params.items() if "cfg" not in key}
        for name, event in cfg.events.items()
    }
    # Whoever changes one of these, also in training's tasks, makes version 4.
    assert ranges == {
        "spawn": {
            "pose_range": {
                "x": (-0.2, 0.2),
                "y": (-0.2, 0.2),
                "z": (0.02, 0.04),
                "yaw": (-0.1, 0.1),
            }
        },
        "spawn_joints": {"position_range": (-0.1, 0.1), "velocity_range": (0.0, 0.0)},
        "foot_friction": {"operation": "abs", "ranges": (0.6, 2.0), "shared_random": True},
        "payload": {"operation": "add", "ranges": (0.0, 3.0)},
        "centre_of_mass": {
            "operation": "add",
            "ranges": dict.fromkeys(range(3), (-0.05, 0.05)),
        },
        "servo_gains": {"kp_range": (0.8, 1.2), "kd_range": (0.8, 1.2)},
        "push": {"velocity_range": {"x": (-0.5, 0.5), "y": (-0.5, 0.5)}},
        "motor_strength": {"effort_limit_range": (0.8, 1.2)},
        "damping": {"multiples": (0.7, 1.6)},
        "joint_friction": {"operation": "add", "ranges": (0.0, 0.1)},
        "joint_offset": {"bias_range": (-0.03, 0.03)},
    }
    assert cfg.events["push"].interval_range_s == (6.0, 10.0)
    assert cfg.motors.no_load_speed == (1.0, 1.5)
    assert cfg.observations["proprioception"].enable_corruption
    noise = cfg.observations["proprioception"].terms["value"].noise
    assert set(noise.n_max) == {0.2, 0.05, 0.0, 0.01, 1.5}
    camera = depth_camera(cfg)
    assert camera.delay == (0.0, 0.1)
    assert (camera.mount.position_error, camera.mount.angle_error) == (0.03, 0.14)
    assert "left_tile" not in cfg.terminations


def test_the_shipped_policy_walks_a_course():
    easy = replace(
        EPISODE,
        obstacles=(Gap(0.3), Plain(0.3)),
        spaces=(1.2, 0.5),
        stop_at=0.6,
        turn_at=1.7,
        speed=1.0,
        onset=0.8,
        duration=float("inf"),
    )
    modes = {"memory": "memory", "healthy": "camera"}
    episodes = [replace(easy, number=number) for number in range(4)]
    walks = walk_episodes(Evaluator(), episodes, modes, 5, "test")
    # Under training's conditions a robot may fall where the others cross.
    assert (walks["healthy"].crossed == 2).sum() >= 3
    assert (walks["memory"].crossed == 2).sum() >= 3
    assert (walks["memory"].joules[walks["memory"].crossed == 2] > 100.0).all()
    # The camera of one of the twins has failed.
    assert (walks["memory"].joules != walks["healthy"].joules).any()
