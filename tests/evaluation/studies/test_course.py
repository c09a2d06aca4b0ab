import json
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from renet.evaluation.env import SimEnv, study_env_cfg
from renet.evaluation.studies.course import CourseStudy
from renet.evaluation.studies.course_env import CourseEnv, PlaceInjector, time_limit
from renet.evaluation.studies.course_terrain import AHEAD, LAP, SET_DOWN, course_env_cfg, passage
from renet.faults import Frames
from renet.sim.depth.rasterizer import scanner
from renet.tasks.config.go1 import GO1
from renet.tasks.mdp.commands import goal
from renet.terrain.tiles import TILE

KINDS = ("flat", "stairs", "slope", "platform", "gap")


def sim(lap: Sequence[str], levels: Sequence[int], robots: int, stuck_after: float) -> SimEnv:
    cfg = study_env_cfg(course_env_cfg(lap, levels, stuck_after, 1, GO1), 0.6)
    return SimEnv(cfg, range(robots), 1, "auto")


@pytest.fixture(scope="module")
def world() -> CourseEnv:
    return CourseEnv(sim(KINDS, [1, 10, 10, 5, 5], 4, 0.3), KINDS)


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
    height = 0.05 + 4 / 9 * 0.45
    platform = ground(world, [24 + 2.5, 24 + 4, 24 + 6.0])
    np.testing.assert_allclose(platform, [height, 0, height], atol=1e-3)
    width = 0.1 + 4 / 9 * 0.6
    gap = ground(world, [32 + 3 - width - 0.02, 32 + 3 - width + 0.02, 32 + 4, 32 + 5 + width / 2])
    np.testing.assert_allclose(gap, [0, -1, 0, -1], atol=1e-3)
    # Wall to wall: none can be walked around.
    for aside in (-3.9, 3.9):
        assert ground(world, [8 + 4, 24 + 2.5, 32 + 2.9], aside) == pytest.approx(
            [6 * 0.23, height, -1], abs=1e-3
        )


def test_tiles_meet_at_ground_level_where_robots_are_set_down(world: CourseEnv) -> None:
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
    assert world.logged("fell")[0].tolist() == [False, True, False, False]
    # Robot 0 stands where it is until it counts as stuck, then goes on after the passage.
    for _ in range(17):
        result = world.step(still)
    stuck = world.logged("stuck")
    assert stuck[:, 0].sum() == 1
    assert world.passage[0] == 1
    assert abs(world._metres()[0] - (TILE + SET_DOWN)) < 0.4
    assert not stuck[:, 1:3].any()
    assert not world.logged("fell")[1:].any()
    assert world.logged("metres")[:, 0].sum() == pytest.approx(0, abs=0.1)


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


def test_a_course_is_reported_robot_by_robot(run_study) -> None:
    folder: Path = run_study("course")
    summary = json.loads((folder / "summary.json").read_text())
    assert len(summary["runs"]) == 4
    for run in summary["runs"]:
        assert run["ends"] == ["stuck", "stuck"]
        assert run["seconds"] == pytest.approx(0.64, abs=0.05)
        assert abs(run["distance_m"]) < 0.3
        assert run["falls"] == 0
    assert [total["stuck"] for total in summary["totals"]] == [4, 4]
    assert [row["robot"] for row in summary["robots"]] == [0, 0]
    assert summary["passages"][1] == {
        "mode": "renet",
        "kind": "grass",
        "tries": 2,
        "crossed": 0,
        "fell": 0,
        "stuck": 2,
    }
    assert summary["lap_m"] == 16
    for name in ("course.png", "passages.png", "summary.csv"):
        assert (folder / name).stat().st_size > 100


def test_quick_is_short_and_the_whole_is_a_kilometre() -> None:
    assert CourseStudy(quick=True).effective()[1] == 1
    lap, laps, _ = CourseStudy().effective()
    assert laps * len(lap) * TILE == pytest.approx(1040)
    assert set(LAP) >= {"grass", "stairs", "slope", "platform", "gap", "occlusion"}
    assert time_limit(lap, 25.0) >= len(lap) * 1250


def test_every_passage_of_every_level_can_be_built() -> None:
    assert {type(passage(kind, 3)).__name__ for kind in set(LAP)} == {
        "Passage",
        "Relief",
        "Stairs",
        "Slope",
        "Platforms",
        "Gaps",
        "Blocks",
    }
