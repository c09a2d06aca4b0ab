from collections.abc import Sequence
from math import inf, nan
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import torch
from tests.evaluation.fakes import FakeEvaluator

from course import CourseStudy, _run
from course_env import (
    AHEAD,
    CourseEnv,
    PlaceInjector,
    course_env_cfg,
    time_limit,
)
from course_terrain import LAP, SET_DOWN, passage
from renet.errors import RenetError
from renet.evaluation.env import SimEnv, study_env_cfg
from renet.evaluation.trace import Trace
from renet.faults import Frames
from renet.sim.depth.rasterizer import scanner
from renet.tasks.config.go1 import GO1
from renet.tasks.mdp.commands import goal
from renet.terrain.tiles import TILE

KINDS = ("flat", "stairs", "slope", "platform", "gap")


@pytest.fixture(scope="module")
def world() -> CourseEnv:
    """Four robots on passages of the highest level, stuck after 0.3 s."""
    cfg = study_env_cfg(course_env_cfg(KINDS, 10, 0.3, 1, GO1), 0.6)
    return CourseEnv(SimEnv(cfg, range(4), 1, "auto"), KINDS)


def ground(world: CourseEnv, metres: Sequence[float], aside: float = 0.0) -> np.ndarray:
    """Height of the ground that many metres along the course."""
    y = torch.tensor(metres, dtype=torch.float32) - len(world.lap) * TILE / 2
    points = torch.stack((torch.full_like(y, aside), y), dim=-1)
    return scanner(world._env.sim.mj_model, "cpu").height(points).numpy()


def put(world: CourseEnv, metres: Sequence[float], height: float) -> None:
    """Move the robots to a place along the course."""
    position = world._env.sim.data.qpos
    position[:, 0] = 0.0
    position[:, 1] = torch.tensor(metres) - len(world.lap) * TILE / 2
    position[:, 2] = height
    world._env.sim.forward()


def test_passages_are_what_they_are_called(world: CourseEnv) -> None:
    # Six steps of 23 cm to a summit, from the second tile's middle line.
    stairs = ground(world, [8 + 4 - 2.45, 8 + 4 - 1.0, 8 + 4, 8 + 4 + 2.45])
    np.testing.assert_allclose(stairs, [0.23, 6 * 0.23, 6 * 0.23, 0.23], atol=1e-3)
    # A metre over two, up and down.
    slope = ground(world, [16 + 1.41, 16 + 2.4, 16 + 4, 16 + 5.6, 16 + 6.59])
    np.testing.assert_allclose(slope, [0.005, 0.5, 1.0, 0.5, 0.005], atol=1e-2)
    height = 0.5
    platform = ground(world, [24 + 2.5, 24 + 4, 24 + 6.0])
    np.testing.assert_allclose(platform, [height, 0, height], atol=1e-3)
    width = 0.7
    gap = ground(world, [32 + 3 - width - 0.02, 32 + 3 - width + 0.02, 32 + 4, 32 + 5 + width / 2])
    np.testing.assert_allclose(gap, [0, -1, 0, -1], atol=1e-3)
    # Wall to wall: none can be walked around.
    for aside in (-3.9, 3.9):
        across = ground(world, [8 + 4, 24 + 2.5, 32 + 2.9], aside)
        np.testing.assert_allclose(across, [6 * 0.23, height, -1], atol=1e-3)
    # Tiles meet at ground level, and robots are set down there.
    edges = [tile * TILE + offset for tile in range(5) for offset in (0.02, SET_DOWN, 7.98)]
    np.testing.assert_allclose(ground(world, edges), 0, atol=1e-3)


def test_a_robot_that_falls_is_set_down_after_the_passage(world: CourseEnv) -> None:
    result = world.reset()
    assert ((result.height > 0.2) & (result.height < 0.4)).all()
    still = np.zeros((4, 12), np.float32)
    # On the flat; in the gap; past the end; on the stairs.
    put(world, [1.0, 34.9, 40.05, 9.0], height=0.3)
    world._env.sim.data.qpos[1, 2] = -0.5
    world.passage[:] = [0, 4, 4, 1]
    result = world.step(still)
    assert result.fell.tolist() == [False, True, False, False]
    assert result.ended.tolist() == [False, True, True, False]
    assert world.finished.tolist() == [False, True, True, False]
    assert world.passage.tolist() == [0, 4, 4, 1]
    assert world.logged()["fell"].tolist() == [[False, True, False, False]]
    # Robot 0 stands where it is until it counts as stuck, then goes on after the passage.
    for _ in range(17):
        result = world.step(still)
    log = world.logged()
    assert log["stuck"][:, 0].sum() == 1
    assert world.passage[0] == 1
    assert abs(world._metres()[0] - (TILE + SET_DOWN)) < 0.4
    assert not log["stuck"][:, 1:3].any()
    assert not log["fell"][1:].any()
    assert log["metres"][:, 0].sum() == pytest.approx(0, abs=0.1)


def test_robots_are_steered_towards_the_middle_line(world: CourseEnv) -> None:
    world.reset()
    position = world._env.sim.data.qpos
    position[:, 0] = torch.tensor([0.0, 1.0, -1.0, 3.0])
    world.step(np.zeros((4, 12), np.float32))
    turn = goal(world._env).yaw.numpy() - AHEAD
    np.testing.assert_allclose(turn, [0, 0.32, -0.32, 0.785], atol=0.02)


def test_cameras_fail_where_the_grass_is() -> None:
    track = SimpleNamespace(lap=("flat", "grass", "occlusion"), passage=np.array([0, 1, 2, 1]))
    injector = PlaceInjector(track, [0, 0, 0, 0], severity=5, seed=1)  # type: ignore[arg-type]
    healthy = np.full((4, 48, 64), 0.5, np.float32)
    frames = injector.apply(Frames.healthy(healthy), 0)
    assert injector.at_work(0).tolist() == [False, True, True, True]
    np.testing.assert_array_equal(frames.image[0], healthy[0])
    assert 0.3 < (frames.image[1] < 0.5).mean() < 0.9
    np.testing.assert_allclose(frames.image[2], 0.02)
    np.testing.assert_array_equal(frames.image[1], frames.image[3])
    track.passage[:] = 0
    np.testing.assert_array_equal(injector.apply(Frames.healthy(healthy), 5).image, healthy)


class StillEvaluator(FakeEvaluator):
    """Real physics, and robots that stand still."""

    def make_env(self, task, robots, speed, seed):
        return SimEnv(study_env_cfg(task, speed), robots, seed, "auto")

    def make_policy(self, num_robots):
        policy = super().make_policy(num_robots)
        policy.step = lambda o, depth, op: np.zeros((num_robots, 12), np.float32)
        return policy


def test_a_course_is_reported_robot_by_robot(tmp_path: Path) -> None:
    lap = ("flat", "grass")
    study = CourseStudy(
        tmp_path, lap=lap, laps=2, robots=1, modes=("memory", "blind"), stuck_after=0.3
    )
    summary = study.run(StillEvaluator())
    rows = [("memory", 1), ("blind", 1), ("memory", 2), ("blind", 2)]
    assert [(run["mode"], run["lap"]) for run in summary["runs"]] == rows
    for run in summary["runs"]:
        assert run["ends"] == ["stuck", "stuck"]
        assert run["seconds"] == pytest.approx(0.64, abs=0.05)
        assert abs(run["distance_m"]) < 0.3
        assert run["falls"] == 0
    assert [total["stuck"] for total in summary["totals"]] == [4, 4]
    assert [row["robot"] for row in summary["robots"]] == [0, 0]
    counts = {"tries": 2, "crossed": 0, "fell": 0, "stuck": 2}
    assert summary["passages"][1] == {"mode": "memory", "kind": "grass"} | counts
    assert summary["lap_m"] == 16
    for name in ("course.png", "passages.png", "summary.csv"):
        assert (tmp_path / name).stat().st_size > 100


@pytest.mark.parametrize(
    "wrong",
    [
        {"lap": ()},
        {"lap": ("lava",)},
        {"level": 11},
        {"severity": 0},
        {"laps": 0},
        *({"stuck_after": seconds} for seconds in (0.0, nan, inf)),
    ],
)
def test_bad_settings_are_refused(wrong: dict) -> None:
    with pytest.raises(RenetError):
        CourseStudy(**wrong)


def test_switches_are_those_of_the_estimator_in_use() -> None:
    trace, nothing = Trace.empty(6, 1), np.zeros(6, bool)
    trace.vision[:3] = True
    trace.trusted[::2] = False
    log = {name: nothing for name in ("fell", "stuck", "metres")} | {"passage": nothing.astype(int)}
    assert _run(log, trace.robots(slice(0, 1)), 1)["switches"] == 1


def test_quick_is_short_and_the_whole_is_a_kilometre() -> None:
    assert CourseStudy(quick=True).effective()[1] == 1
    lap, laps, _ = CourseStudy().effective()
    assert laps * len(lap) * TILE == pytest.approx(1040)
    assert set(LAP) >= {"grass", "stairs", "slope", "platform", "gap", "occlusion"}
    assert time_limit(lap, 25.0) >= len(lap) * 1250


@pytest.mark.parametrize("level", [1, 10])
def test_every_passage_can_be_built(level: int) -> None:
    spec = mujoco.MjSpec()
    spec.worldbody.add_body(name="terrain")
    built = [passage(kind, level).function(0.0, spec, np.random.default_rng(0)) for kind in LAP]
    assert spec.compile().ngeom == sum(len(tile.geometries) for tile in built)
    assert {tuple(tile.origin) for tile in built} == {(TILE / 2, SET_DOWN, 0.0)}
